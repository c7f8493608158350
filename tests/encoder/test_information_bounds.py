"""Lemmas 1 and 2 and Theorem 1: identities, directions and equality cases on random models."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.encoder import information_bounds as module
from ovibjax.encoder.information_bounds import Bounds, Decoder, LinearGaussian
from ovibjax.encoder.rate import gaussian_kl
from tests.oracles import bounds as oracle

bounds, exact_decoder = jax.jit(module.bounds), jax.jit(module.exact_decoder)

many_bounds, many_exact = jax.jit(jax.vmap(module.bounds)), jax.jit(jax.vmap(module.exact_decoder))

slopes = jax.jit(jax.vmap(jax.grad(lambda decoder, model: module.bounds(model, decoder, 0.5).bound)))

COUNT = 500

SHAPES = [(1, 1), (6, 3), (4, 9)]

KINDS = ["plain", "noiseless", "zero", "repeated"]


@functools.partial(jax.jit, static_argnums=(1, 2))
def random_models(keys, n, latent):
    return jax.vmap(lambda key: module.random_model(key, n, latent))(keys)


def degenerate(model, kind):
    """The models (a batch) with a nearly noiseless coordinate, no encoder, or two equal rows of it."""
    if kind == "noiseless":
        return model._replace(noise_var=model.noise_var.at[:, 0].set(1e-6))
    if kind == "zero":
        return model._replace(encoder=jnp.zeros_like(model.encoder))
    if kind == "repeated":
        return model._replace(encoder=model.encoder.at[:, -1].set(model.encoder[:, 0]))
    return model


def random_decoders(seed, count, latent):
    """Decoders that have nothing to do with any posterior."""
    rng = np.random.default_rng(seed)
    half = rng.normal(size=(count, 3, 3))
    decoder = Decoder(
        map=0.3 * rng.normal(size=(count, 3, latent)),
        offset=0.3 * rng.normal(size=(count, 3)),
        cov=half @ half.transpose(0, 2, 1) + 0.2 * np.eye(3),
    )
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), decoder)


@functools.cache
def batch(n, latent, kind):
    """500 models, their exact and arbitrary decoders, weights, and the bounds of each decoder."""
    keys = jax.random.split(jax.random.key(100 * n + latent), COUNT)
    model = degenerate(random_models(keys, n, latent), kind)
    exact, other = many_exact(model), random_decoders(1, COUNT, latent)
    beta = jnp.geomspace(1e-4, 3.0, COUNT, dtype=jnp.float32).at[0].set(0.0)
    results = [many_bounds(model, decoder, beta) for decoder in (exact, other)]
    return jax.tree.map(np.asarray, (model, exact, other, beta, *results))


def take(tree, index):
    return jax.tree.map(lambda leaf: leaf[index], tree)


def close(actual, expected, scale, rtol):
    """Errors relative to the largest term that enters."""
    assert np.all(np.isfinite(actual))
    worst = np.max(np.abs(np.asarray(actual, np.float64) - expected) / (1.0 + np.abs(scale)))
    assert worst < rtol, worst


every_batch = pytest.mark.parametrize(("n", "latent", "kind"), [(*shape, kind) for shape in SHAPES for kind in KINDS])


@every_batch
def test_every_term_equals_the_oracle(n, latent, kind):
    model, exact, other, beta, at_exact, at_other = batch(n, latent, kind)
    for i in range(0, COUNT, 25):
        for decoder, result in ((exact, at_exact), (other, at_other)):
            theirs = oracle.bounds(take(model, i), take(decoder, i), float(beta[i]))
            assert set(theirs) == set(Bounds._fields)
            for name, value in theirs.items():
                close(getattr(result, name)[i], value, value, 3e-5)


@every_batch
def test_lemma_1_is_an_identity_and_an_inequality(n, latent, kind):
    result = batch(n, latent, kind)[4]
    close(result.rate - result.marginal_kl, result.information_xz, result.rate, 1e-5)
    np.testing.assert_allclose(result.rate - result.marginal_kl, result.information_xz, rtol=1e-4, atol=5e-5)
    tolerance = 1e-5 * (1 + result.rate)
    assert np.all(result.information_xz >= -1e-5) and np.all(result.marginal_kl >= -tolerance)
    assert np.all(result.information_xz <= result.rate + tolerance)


@every_batch
def test_lemma_2_is_an_identity_and_an_inequality(n, latent, kind):
    for result in batch(n, latent, kind)[4:]:
        lower = result.log_likelihood + result.entropy_y
        close(result.information_zy - lower, result.decoder_kl, result.log_likelihood, 2e-5)
        assert np.all(result.decoder_kl >= -1e-5)
        assert np.all(lower <= result.information_zy + 1e-5 * (1 + np.abs(result.log_likelihood)))


@every_batch
def test_lemma_2_is_an_equality_for_the_exact_decoder(n, latent, kind):
    *_, result, other = batch(n, latent, kind)
    close(result.decoder_kl, 0.0, 0.0, 1e-5)
    close(result.log_likelihood + result.entropy_y, result.information_zy, result.entropy_y, 2e-5)
    # An arbitrary decoder leaves a gap that tolerances do not hide.
    assert np.min(other.decoder_kl) > 1e-2


@every_batch
def test_theorem_1_bounds_the_objective_by_the_sum_of_both_gaps(n, latent, kind):
    _, _, _, beta, *results = batch(n, latent, kind)
    for result in results:
        scale = beta * result.rate + np.abs(result.log_likelihood)
        close(result.bound - result.objective, result.gap, scale, 2e-5)
        assert np.all(result.objective <= result.bound + 1e-5 * (1 + scale))
        close(result.objective, beta * result.information_xz - result.information_zy, scale, 1e-6)
        # The right-hand side is the trained objective less h(y).
        trained = beta * result.rate - result.log_likelihood
        close(trained - result.bound, result.entropy_y, scale, 1e-6)


@every_batch
def test_informations_obey_data_processing(n, latent, kind):
    result = batch(n, latent, kind)[4]
    assert np.all(result.information_zy >= -1e-5)
    assert np.all(result.information_zy <= np.minimum(result.information_xy, result.information_xz) + 1e-5)


@pytest.mark.parametrize(("n", "latent"), SHAPES)
def test_an_encoder_that_ignores_the_features_carries_no_information(n, latent):
    model, exact, _, _, result, _ = batch(n, latent, "zero")
    assert np.all(np.abs(result.information_xz) < 1e-6) and np.all(np.abs(result.information_zy) < 1e-5)
    assert np.max(np.abs(exact.map)) < 1e-6
    # The rate is then all marginal divergence; with the prior for a posterior there is none either.
    close(result.rate, result.marginal_kl, result.rate, 1e-5)
    prior = model._replace(bias=jnp.zeros_like(model.bias), noise_var=jnp.ones_like(model.noise_var))
    empty = many_bounds(prior, exact, jnp.ones(COUNT))
    assert np.all(np.abs(empty.rate) < 1e-6) and np.all(np.abs(empty.marginal_kl) < 1e-6)


def test_the_rate_is_tight_where_the_marginal_is_the_prior():
    # x standard normal, mean scaled so that signal and noise add to one.
    noise = jnp.array([0.9, 0.01, 1e-4], jnp.float32)
    model = take(batch(6, 3, "plain")[0], 0)._replace(x_cov=jnp.eye(6), bias=jnp.zeros(3), noise_var=noise)
    model = model._replace(encoder=jnp.sqrt(1 - noise)[:, None] * jnp.eye(3, 6))
    result = bounds(model, exact_decoder(model), 1.0)
    expected = -0.5 * np.log(np.asarray(noise, np.float64)).sum()
    np.testing.assert_allclose([result.information_xz, result.rate], expected, rtol=1e-6)
    assert abs(float(result.marginal_kl)) < 1e-5
    np.testing.assert_allclose(result.bound, result.objective, rtol=1e-5)


@pytest.mark.parametrize(("n", "latent", "kind"), [(6, 3, "plain"), (4, 9, "plain"), (4, 9, "noiseless")])
def test_exact_decoder_is_the_conditional_of_the_joint(n, latent, kind):
    model, exact, *_ = batch(n, latent, kind)
    for i in range(0, COUNT, 20):
        gain, offset, cov = oracle.posterior(take(model, i))
        ours = take(exact, i)
        np.testing.assert_allclose(ours.map, gain, rtol=1e-4, atol=1e-5 * (1 + np.abs(gain).max()))
        np.testing.assert_allclose(ours.offset, offset, rtol=1e-4, atol=1e-4 * (1 + np.abs(gain).max()))
        np.testing.assert_allclose(ours.cov, cov, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("size", [1e-4, 1e-2, 0.3, 3.0])
@pytest.mark.parametrize(("n", "latent"), SHAPES)
def test_no_perturbed_decoder_has_a_lower_bound(n, latent, size):
    model, exact, _, beta, result, _ = batch(n, latent, "plain")
    rng = np.random.default_rng(9)
    # (I + H) cov (I + H)^T, larger and smaller alike.
    change = np.eye(3) + size * rng.normal(size=exact.cov.shape)
    perturbed = Decoder(
        (exact.map + size * rng.normal(size=exact.map.shape)).astype(np.float32),
        (exact.offset + size * rng.normal(size=exact.offset.shape)).astype(np.float32),
        (change @ exact.cov @ change.transpose(0, 2, 1) + 1e-4 * np.eye(3)).astype(np.float32),
    )
    worse = many_bounds(model, perturbed, beta)
    scale = 1 + beta * result.rate + np.abs(result.log_likelihood)
    assert np.all(np.asarray(worse.bound) >= result.bound - 1e-5 * scale)
    assert size < 0.1 or np.all(np.asarray(worse.bound) > result.bound)
    np.testing.assert_array_equal(worse.information_zy, result.information_zy)


@pytest.mark.parametrize(("n", "latent"), SHAPES)
def test_the_bound_is_stationary_at_the_exact_decoder(n, latent):
    model, exact, other, _, *_ = batch(n, latent, "plain")
    at_exact, elsewhere = slopes(exact, model), slopes(other, model)
    for flat, steep in zip(at_exact, elsewhere, strict=True):
        assert np.max(np.abs(flat)) < 1e-3 and np.max(np.abs(steep)) > 0.1


def test_entropy_of_the_position_is_constant_in_encoder_and_decoder():
    model, _, other, _, result, at_other = batch(6, 3, "plain")
    np.testing.assert_array_equal(result.entropy_y, at_other.entropy_y)
    changed = model._replace(encoder=-2 * model.encoder, bias=model.bias + 1, noise_var=0.5 * model.noise_var)
    np.testing.assert_allclose(many_bounds(changed, other, jnp.ones(COUNT)).entropy_y, result.entropy_y, rtol=1e-6)


def test_the_rate_is_the_mean_of_the_loss_term():
    count = 50_000
    for n, latent in [(6, 3), (4, 9)]:
        model, _, _, _, result, _ = batch(n, latent, "plain")
        for i in range(5):
            one = take(model, i)
            x = oracle.sample(one, count, seed=i)[0]
            mu = (x @ one.encoder.T + one.bias).astype(np.float32)
            terms = np.asarray(gaussian_kl(mu, np.broadcast_to(np.log(one.noise_var), mu.shape)), np.float64)
            assert abs(terms.mean() - result.rate[i]) < 5 * terms.std() / math.sqrt(count)


@pytest.mark.parametrize(("n", "latent"), [(6, 3), (4, 9)])
def test_expectations_agree_with_monte_carlo(n, latent):
    model, _, other, _, _, result = batch(n, latent, "plain")
    count = 50_000
    for i in range(2):
        terms = oracle.samples_of_terms(take(model, i), take(other, i), count, seed=i)
        assert set(terms) == set(Bounds._fields) - {"information_xy", "objective", "bound", "gap"}
        for name, values in terms.items():
            error = abs(values.mean() - getattr(result, name)[i])
            assert error < 5 * values.std() / math.sqrt(count), name


def test_a_fixed_isotropic_decoder_is_a_squared_error():
    model, exact, *_ = batch(6, 3, "plain")
    one, variance = take(model, 4), 0.3
    _, z, y = oracle.sample(one, 100_000, seed=2)
    for scale in (0.0, 0.5, 1.0):
        decoder = Decoder(scale * exact.map[4], exact.offset[4], variance * jnp.eye(3))
        errors = ((y - z @ np.asarray(decoder.map).T - np.asarray(decoder.offset)) ** 2).sum(axis=1)
        constant = 1.5 * math.log(2 * math.pi * variance)
        squared = -2 * variance * (float(bounds(one, decoder, 1.0).log_likelihood) + constant)
        assert abs(errors.mean() - squared) < 5 * errors.std() / math.sqrt(len(errors))


def test_jit_and_vmap_equal_a_plain_loop():
    model, exact, other, beta, *results = batch(4, 9, "plain")
    for decoder, result in zip((exact, other), results, strict=True):
        for i in range(5):
            single = bounds(take(model, i), take(decoder, i), float(beta[i]))
            for name in Bounds._fields:
                value = getattr(single, name)
                assert value.shape == () and value.dtype == jnp.float32
                np.testing.assert_allclose(value, getattr(result, name)[i], rtol=1e-5, atol=3e-5)


def test_random_models_are_well_formed_and_conditioned():
    for n, latent in SHAPES:
        model = batch(n, latent, "plain")[0]
        assert isinstance(model, LinearGaussian)
        shapes = [(n, n), (3, n), (3, 3), (latent, n), (latent,), (latent,)]
        assert [leaf.shape[1:] for leaf in model] == shapes and all(leaf.dtype == np.float32 for leaf in model)
        for cov in (model.x_cov, model.y_cov):
            spectrum = np.linalg.eigvalsh(np.asarray(cov, np.float64))
            assert spectrum.min() > 0.04 and (spectrum[:, -1] / spectrum[:, 0]).max() < 200
        variance = np.asarray(model.noise_var)
        assert variance.min() >= math.exp(-4) * 0.999 and variance.max() <= 1
        assert len(np.unique(np.asarray(model.bias[:, 0]))) == COUNT

"""Training for bits: the cost of a coordinate against float64, what counts, and that in use codes are rounded."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.encoder.bits import STEP, code_bits, code_of, steps_of, with_bits
from ovibjax.encoder.loss import composite_loss, make_hypers
from ovibjax.encoder.model import encode
from ovibjax.encoder.train import TrainConfig, for_bits, sample_batch
from tests.encoder.cases import QUICK, TERMS, UAV, make_data, make_params, random_batch, train
from tests.encoder.test_loss import network_parts, numpy_parts
from tests.oracles import encoder as oracle

COMPLETING = dataclasses.replace(UAV, kind="completing", rank=11)
STATIC = TrainConfig(arch=COMPLETING, prefixes=(2, 4, 8), prior="bits", steps=60, batch=16, warmup=5)
bits_of = jax.jit(code_bits, compiler_options=QUICK)
loss_of = jax.jit(composite_loss, static_argnums=(3, 4, 5), compiler_options=QUICK)
differentiate = jax.jit(jax.value_and_grad(composite_loss, has_aux=True), static_argnums=(3, 4), compiler_options=QUICK)


def prior_of(step, mean, width):
    """Parameters that hold nothing but steps and a prior."""
    logs = {"log_step": np.log(step), "mean": mean, "log_width": np.log(width)}
    return {"params": {"bits": {name: jnp.asarray(part, jnp.float32) for name, part in logs.items()}}}


def network(arch=UAV, seed=0):
    """A network without structure, with steps and priors of all sizes."""
    rng = np.random.default_rng(seed)
    bits = prior_of(np.exp(rng.normal(size=8) - 1), rng.normal(size=8), np.exp(rng.normal(size=8)))["params"]
    return {"params": make_params(arch)["params"] | bits}


def batch_of(arch=UAV):
    batch = random_batch(arch)
    noise = np.random.default_rng(1).uniform(-0.5, 0.5, batch.noise.shape).astype(np.float32)
    return batch._replace(noise=noise)


def test_a_coordinate_costs_the_gaussians_share_of_a_step():
    rng = np.random.default_rng(0)
    step, width, mean = (10 ** rng.uniform(-2, 2, 400), 10 ** rng.uniform(-2, 2, 400), rng.normal(size=400))
    z = (mean + width * rng.normal(size=(30, 400)) * 3).astype(np.float32)
    parts = (part.astype(np.float32) for part in (step, mean, width))
    found = np.asarray(bits_of(prior_of(step, mean, width), z))
    expected = oracle.code_bits(z, *parts)
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=2e-3)
    assert expected.max() > 12 and expected.min() < 1e-6


def test_far_away_the_cost_is_that_of_the_tail_and_then_a_straight_line():
    away = np.float32([[20.0], [60.0], [99.0], [-99.0]])
    found = bits_of(prior_of([1.0], [0.0], [1.0]), away)
    np.testing.assert_allclose(found, oracle.code_bits(away, 1.0, 0.0, 1.0), rtol=1e-3)
    line = np.asarray(bits_of(prior_of([1.0], [0.0], [1.0]), np.float32([[200.0], [1e3], [1e6]])))
    np.testing.assert_allclose(np.diff(line, axis=0)[:, 0], 100 / math.log(2) * np.array([800, 999e3]), rtol=1e-5)


def test_of_a_prior_that_fits_the_cost_is_the_entropy_of_what_is_rounded():
    z = np.random.default_rng(0).normal(size=(200_000, 1)).astype(np.float32) * 3
    numbers = np.rint(z / 0.5)
    share = np.unique(numbers, return_counts=True)[1] / len(z)
    spent = float(bits_of(prior_of([0.5], [0.0], [3.0]), numbers * np.float32(0.5)).mean())
    assert spent == pytest.approx(-(share * np.log2(share)).sum(), abs=0.01)
    assert spent == pytest.approx(0.5 * math.log2(2 * math.pi * math.e * 9) + 1, abs=0.02)


def test_the_shares_of_all_places_add_up_to_one():
    places = np.arange(-400, 401, dtype=np.float32)[:, None] * np.float32([0.3, 0.5])
    shares = 2.0 ** -np.asarray(bits_of(prior_of([0.3, 0.5], [0.4, -7.0], [0.1, 9.0]), places), np.float64)
    np.testing.assert_allclose(shares.sum(axis=0), 1.0, rtol=1e-5)


@pytest.mark.parametrize("arch", [UAV, COMPLETING])
def test_the_objective_equals_the_oracle_and_only_what_is_sent_counts(arch):
    params, batch = network(arch), batch_of(arch)
    bits = {name: np.asarray(part, np.float64) for name, part in params["params"]["bits"].items()}
    step, width = np.exp(bits["log_step"]), np.exp(bits["log_width"])
    layers = {"params": {name: layer for name, layer in params["params"].items() if name != "bits"}}
    w = np.asarray(layers["params"]["mean"]["kernel"]).T
    for parts in (network_parts(arch, layers), numpy_parts(layers)):

        def encode_one(row, encode=parts[0]):
            return encode(row)[0], 2 * np.log(step)

        weights = {"alpha": 0.7, "beta": 0.2, "gamma": 0.3}
        _, by_term = oracle.composite_loss(batch._asdict(), weights, "gaussian", w, encode_one, *parts[1:])
        rate = 0.0
        for n, mask in enumerate(batch.view_mask):
            x = batch.x[n].reshape(-1) * np.repeat(mask, 6)
            cost = oracle.code_bits(parts[0](x)[0] + step * batch.noise[n], step, bits["mean"], width)
            rate += cost[: int(batch.prefix_mask[n].sum())].sum() / len(batch.x)
        loss, terms = loss_of(params, batch, make_hypers(**weights), arch, "bits")
        for name, expected in (by_term | {"rate": rate}).items():
            np.testing.assert_allclose(terms[name], expected, rtol=2e-4, err_msg=name)
        expected = by_term["reconstruction"] + 0.7 * by_term["localization"] + 0.2 * rate
        np.testing.assert_allclose(loss, expected + 0.3 * by_term["orthogonality"], rtol=2e-4)


def test_a_longer_prefix_pays_for_itself_alone():
    """No gradient of the rate reaches a coordinate, step or width that nobody sent."""
    params, batch = network(), batch_of()
    mask = np.zeros_like(batch.prefix_mask)
    mask[:, :3] = 1
    hypers = make_hypers(alpha=0.0, beta=1.0, gamma=0.0)
    (_, terms), grads = differentiate(params, batch._replace(prefix_mask=mask), hypers, UAV, "bits")
    assert set(terms) == set(TERMS)
    for name, grad in grads["params"]["bits"].items():
        assert np.all(grad[3:] == 0) and np.all(grad[:3] != 0), name
    assert np.all(grads["params"]["mean"]["kernel"][:, 3:] == 0)


def test_gradients_are_finite_at_the_edges_of_what_may_be_learned():
    batch = batch_of()
    for step, width in ((1e-9, 1e9), (1e9, 1e-9), (1e-9, 1e-9), (1e3, 1e3)):
        params = network()
        params["params"]["bits"] = prior_of(np.full(8, step), np.full(8, 30.0), np.full(8, width))["params"]["bits"]
        (loss, _), grads = differentiate(params, batch, make_hypers(), UAV, "bits")
        assert np.isfinite(loss), (step, width)
        assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(grads)), (step, width)


def test_noise_is_that_of_rounding():
    index = jnp.arange(64)
    noise = np.concatenate([sample_batch(jax.random.key(s), index, make_data(), STATIC).noise for s in range(20)])
    assert noise.min() >= -0.5 and noise.max() <= 0.5
    np.testing.assert_allclose([noise.mean(), noise.var()], [0, 1 / 12], atol=3e-3)


def test_training_learns_steps_and_priors_and_lowers_the_bits_that_are_dear():
    cheap, dear = (
        train(jax.random.key(0), make_hypers(beta=beta, lr=0.02), make_data(), STATIC) for beta in (1e-5, 0.1)
    )
    assert dear[1]["rate"][-1] < 0.7 * cheap[1]["rate"][-1]
    assert cheap[1]["reconstruction"][-1] < dear[1]["reconstruction"][-1]
    begun = {"log_step": math.log(STEP)}
    for name, leaf in dear[0]["params"]["bits"].items():
        assert np.all(np.isfinite(leaf)) and np.all(np.abs(leaf - begun.get(name, 0)) > 1e-3), name
    assert np.mean(steps_of(dear[0])) > np.mean(steps_of(cheap[0]))


def test_what_is_sent_in_use_is_rounded_to_the_learned_steps():
    params, x = network(), np.random.default_rng(3).normal(size=(50, 30)).astype(np.float32)
    mu = np.asarray(encode(params, x, UAV)[0])
    step = np.exp(np.asarray(params["params"]["bits"]["log_step"], np.float64))
    received = np.asarray(code_of(params, x, UAV))
    np.testing.assert_allclose(received / step, np.rint(received / step), atol=1e-4)
    assert np.all(np.abs(received - mu) <= 0.5001 * step) and np.any(received != mu)
    plain = {"params": {name: layer for name, layer in params["params"].items() if name != "bits"}}
    np.testing.assert_array_equal(code_of(plain, x, UAV), mu)


def test_training_begins_with_the_prior_of_its_codes():
    params, x = make_params(UAV), make_data().x
    bits = with_bits(params, x, UAV)["params"]["bits"]
    z = np.asarray(encode(params, x.reshape(64, -1), UAV)[0], np.float64)
    np.testing.assert_allclose(bits["mean"], z.mean(axis=0), rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(np.exp(bits["log_width"]), z.std(axis=0) + 0.1 * STEP, rtol=1e-4)
    np.testing.assert_allclose(np.exp(bits["log_step"]), STEP, rtol=1e-6)


def test_the_recipe_changes_lengths_prior_and_linear_paths_alone():
    static = TrainConfig(steps=77)
    changed = for_bits(static)
    assert min(changed.prefixes) == 8 and set(changed.prefixes) == set(static.prefixes) - {4}
    assert dataclasses.replace(static, prefixes=changed.prefixes, prior="bits", linear_lr=1.0) == changed
    short = TrainConfig(arch=dataclasses.replace(static.arch, latent=4), prefixes=(4, 4))
    assert for_bits(short).prefixes == (4, 4)

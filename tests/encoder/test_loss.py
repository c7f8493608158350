"""The composite objective term by term against float64 NumPy, and what must not influence it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.encoder.loss import Batch, composite_loss, make_hypers, orthogonality_penalty, prefix_mask
from ovibjax.encoder.model import decode, encode, locate
from tests.encoder.test_model import UAV, UGV, make_params
from tests.oracles import encoder as oracle

TERMS = ["reconstruction", "localization", "rate", "orthogonality"]
loss_of = jax.jit(composite_loss, static_argnums=(3, 4))
penalty = jax.jit(orthogonality_penalty)
penalty_grad = jax.jit(jax.grad(orthogonality_penalty))


# ---- prefix mask ----


@pytest.mark.parametrize("size", [1, 8, 35, 128])
def test_prefix_mask_equals_the_oracle_for_every_k_static_and_traced(size):
    table = np.stack([oracle.prefix_mask(k, size) for k in range(size + 1)])
    traced = jax.jit(jax.vmap(lambda k: prefix_mask(k, size)))(jnp.arange(size + 1))
    assert traced.dtype == jnp.float32 and traced.shape == (size + 1, size)
    np.testing.assert_array_equal(traced, table)
    for k in range(size + 1):
        np.testing.assert_array_equal(prefix_mask(k, size), table[k])


def test_one_program_serves_all_prefix_lengths():
    traces = []

    @jax.jit
    def masked(k):
        traces.append(k)
        return prefix_mask(k, 16)

    for k in range(17):
        assert float(masked(jnp.int32(k)).sum()) == k
    assert len(traces) == 1


# ---- orthogonality ----


def orthonormal_rows(size, width, seed=0):
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(width, size)))
    return q.T


@pytest.mark.parametrize(("size", "width"), [(1, 1), (3, 3), (8, 12), (64, 256)])
def test_the_penalty_is_zero_for_orthonormal_rows(size, width):
    w = jnp.array(orthonormal_rows(size, width), jnp.float32)
    assert abs(float(penalty(w))) < 1e-12 * width
    # For rows of length c it is (c^2 - 1)^2 / K.
    np.testing.assert_allclose(penalty(1.5 * w), 1.25**2 / size, rtol=1e-5)


@pytest.mark.parametrize(("size", "width"), [(1, 5), (6, 4), (8, 12), (40, 64)])
@pytest.mark.parametrize("scale", [1e-2, 1.0, 30.0])
def test_the_penalty_equals_the_oracle(size, width, scale):
    w = (np.random.default_rng(size).normal(size=(size, width)) * scale).astype(np.float32)
    value = penalty(jnp.array(w))
    assert value.shape == () and value.dtype == jnp.float32
    np.testing.assert_allclose(value, oracle.orthogonality(w), rtol=2e-5)


def test_the_penalty_is_normalised_by_the_square_of_k():
    for size in (2, 8):
        # ||0 - I||_F^2 = K; all rows equal and of unit length: ||1 1^T - I||_F^2 = K^2 - K.
        np.testing.assert_allclose(penalty(np.zeros((size, 12), np.float32)), 1 / size, rtol=1e-6)
        row = np.eye(12, dtype=np.float32)[[5] * size]
        np.testing.assert_allclose(penalty(row), (size**2 - size) / size**2, rtol=1e-6)


def test_the_gradient_of_the_penalty_is_its_closed_form():
    w = np.random.default_rng(1).normal(size=(6, 9)).astype(np.float32)
    exact = w.astype(np.float64)
    expected = 4 * (exact @ exact.T - np.eye(6)) @ exact / 36
    np.testing.assert_allclose(penalty_grad(jnp.array(w)), expected, rtol=1e-4, atol=1e-5)
    for w in (np.zeros((6, 9)), orthonormal_rows(6, 9)):
        grad = penalty_grad(jnp.array(w, jnp.float32))
        np.testing.assert_allclose(grad, 0.0, atol=1e-6)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10_000), st.floats(1e-4, 0.05))
def test_proposition_1_bounds_the_singular_values(seed, spread):
    rng = np.random.default_rng(seed)
    w = (orthonormal_rows(12, 20, seed) + spread * rng.normal(size=(12, 20))).astype(np.float32)
    singular = np.linalg.svd(w.astype(np.float64), compute_uv=False)
    # ||Delta||_2 <= ||Delta||_F = K sqrt(penalty).
    spectral = np.linalg.norm(w.astype(np.float64) @ w.T - np.eye(12), 2)
    epsilon = 12 * float(penalty(jnp.array(w))) ** 0.5 * (1 + 1e-4) + 1e-6
    assert spectral <= epsilon
    for bound in [b for b in (spectral + 1e-9, epsilon) if b < 1]:
        assert np.all(singular >= np.sqrt(1 - bound)) and np.all(singular <= np.sqrt(1 + bound))


def test_a_penalty_below_k_to_the_minus_two_excludes_rank_collapse():
    rng = np.random.default_rng(5)
    for _ in range(20):
        w = orthonormal_rows(5, 9, int(rng.integers(1000)))
        w[4] = rng.normal(size=4) @ w[:4]
        assert float(penalty(jnp.array(w, jnp.float32))) >= (1 - 1e-5) / 25


# ---- the whole objective ----


def random_batch(arch, size=7, seed=0):
    """Every mode and every prefix length of the platform side by side."""
    rng = np.random.default_rng(seed)
    modes = ["A5", "F", "H4", "FS"] if arch.n_views == 5 else ["H4", "F", "FS"]
    return Batch(
        x=rng.normal(size=(size, arch.n_views, arch.view_dim)).astype(np.float32),
        y=rng.normal(size=(size, 3)).astype(np.float32),
        view_mask=np.float32([oracle.view_mask(modes[n % len(modes)], arch.n_views) for n in range(size)]),
        prefix_mask=np.float32([oracle.prefix_mask(1 + (3 * n) % arch.latent, arch.latent) for n in range(size)]),
        noise=rng.normal(size=(size, arch.latent)).astype(np.float32),
    )


def network_parts(arch, params):
    """encode, decode and locate of one float64 vector through the product's network."""

    def one(part):
        part = jax.jit(part, static_argnums=2)

        def apply(row):
            out = part(params, jnp.array(row[None], jnp.float32), arch)
            return jax.tree.map(lambda leaf: np.asarray(leaf[0], np.float64), out)

        return apply

    return one(encode), one(decode), one(locate)


def numpy_parts(params):
    return tuple(lambda row, part=part: part(params, row) for part in (oracle.encode, oracle.decode, oracle.locate))


WEIGHTS = [
    {"alpha": 1.0, "beta": 1e-3, "gamma": 0.1},
    {"alpha": 0.3, "beta": 2.0, "gamma": 7.0},
    {"alpha": 0.0, "beta": 0.0, "gamma": 0.0},
]


@pytest.mark.parametrize("prior", ["gaussian", "ard"])
@pytest.mark.parametrize("arch", [UAV, UGV])
def test_every_term_and_the_weighted_sum_equal_the_oracle(arch, prior):
    params, batch = make_params(arch), random_batch(arch)
    w = np.asarray(params["params"]["mean"]["kernel"]).T
    for parts in (network_parts(arch, params), numpy_parts(params)):
        for weights in WEIGHTS:
            loss, terms = loss_of(params, batch, make_hypers(**weights), arch, prior)
            expected, by_term = oracle.composite_loss(batch._asdict(), weights, prior, w, *parts)
            assert sorted(terms) == sorted(by_term) == sorted(TERMS)
            for name in TERMS:
                assert terms[name].shape == () and by_term[name] > 1e-3
                np.testing.assert_allclose(terms[name], by_term[name], rtol=1e-4, err_msg=name)
            np.testing.assert_allclose(loss, expected, rtol=1e-4)


def test_the_default_weights_are_the_papers():
    hypers = make_hypers()
    assert all(leaf.dtype == jnp.float32 and leaf.shape == () for leaf in hypers)
    np.testing.assert_allclose([hypers.alpha, hypers.beta, hypers.gamma], [1.0, 1e-3, 0.1], rtol=1e-6)


@pytest.mark.parametrize("prior", ["gaussian", "ard"])
def test_each_weight_scales_its_own_term(prior):
    params, batch = make_params(UAV), random_batch(UAV)
    _, terms = loss_of(params, batch, make_hypers(), UAV, prior)
    base = {"alpha": 0.0, "beta": 0.0, "gamma": 0.0}
    for name, term in [("alpha", "localization"), ("beta", "rate"), ("gamma", "orthogonality")]:
        loss, _ = loss_of(params, batch, make_hypers(**{**base, name: 3.0}), UAV, prior)
        np.testing.assert_allclose(loss, terms["reconstruction"] + 3 * terms[term], rtol=1e-5)


@pytest.mark.parametrize("prior", ["", "Gaussian", "laplace", None])
def test_an_unknown_prior_is_an_error(prior):
    with pytest.raises(ValueError, match=r"gaussian.*ard"):
        composite_loss(make_params(UAV), random_batch(UAV), make_hypers(), UAV, prior)


def assert_same_to_the_bit(a, b, names=TERMS):
    for name in names:
        assert float(a[1][name]) == float(b[1][name]), name
    if list(names) == TERMS:
        assert float(a[0]) == float(b[0])


@pytest.mark.parametrize("prior", ["gaussian", "ard"])
@pytest.mark.parametrize("arch", [UAV, UGV])
def test_masked_views_of_the_input_have_no_influence(arch, prior):
    params, batch = make_params(arch), random_batch(arch)
    hidden = batch.view_mask[:, :, None] == 0
    assert hidden.sum() > 0
    other = np.where(hidden, np.float32(1e4) * batch.x[::-1] - 7, batch.x)
    before = loss_of(params, batch, make_hypers(), arch, prior)
    assert_same_to_the_bit(before, loss_of(params, batch._replace(x=other), make_hypers(), arch, prior))
    # The test sees a change where a view is sent.
    moved = loss_of(params, batch._replace(x=batch.x + ~hidden), make_hypers(), arch, prior)
    assert all(float(moved[1][name]) != float(before[1][name]) for name in TERMS[:3])


def test_masked_views_of_the_decoded_descriptor_have_no_influence():
    params = make_params(UAV)
    mask = np.tile(np.float32(oracle.view_mask("FS", 5)), (7, 1))
    batch = random_batch(UAV)._replace(view_mask=mask)
    before = loss_of(params, batch, make_hypers(), UAV, "gaussian")

    def with_descriptor_bias(views):
        bias = params["params"]["descriptor"]["bias"].reshape(5, 6) + 1e3 * np.float32(views)[:, None]
        layer = {**params["params"]["descriptor"], "bias": bias.reshape(-1)}
        return loss_of({"params": {**params["params"], "descriptor": layer}}, batch, make_hypers(), UAV, "gaussian")

    assert_same_to_the_bit(before, with_descriptor_bias([0, 1, 0, 0, 1]))
    moved = with_descriptor_bias([0, 0, 1, 0, 0])
    assert moved[1]["reconstruction"] > 1e3 and moved[1]["localization"] != before[1]["localization"]


@pytest.mark.parametrize("prior", ["gaussian", "ard"])
def test_latent_coordinates_beyond_the_prefix_have_no_influence(prior):
    params, batch = make_params(UAV), random_batch(UAV)
    beyond = batch.prefix_mask == 0
    assert beyond.sum() > 0
    before = loss_of(params, batch, make_hypers(), UAV, prior)
    noise = np.where(beyond, np.float32(1e3) * batch.noise + 5, batch.noise)
    assert_same_to_the_bit(before, loss_of(params, batch._replace(noise=noise), make_hypers(), UAV, prior))
    moved = loss_of(params, batch._replace(noise=batch.noise + ~beyond), make_hypers(), UAV, prior)
    assert all(float(moved[1][name]) != float(before[1][name]) for name in TERMS[:2])


def test_a_mean_beyond_the_prefix_moves_rate_and_orthogonality_only():
    params = make_params(UAV)
    batch = random_batch(UAV)._replace(prefix_mask=np.tile(np.float32(oracle.prefix_mask(3, 8)), (7, 1)))

    def terms_of(kernel):
        layer = {**params["params"]["mean"], "kernel": kernel}
        return loss_of({"params": {**params["params"], "mean": layer}}, batch, make_hypers(), UAV, "gaussian")

    kernel = params["params"]["mean"]["kernel"]
    before, after = terms_of(kernel), terms_of(kernel.at[:, 3:].multiply(5.0))
    assert_same_to_the_bit(before, after, ["reconstruction", "localization"])
    assert after[1]["rate"] > before[1]["rate"] and after[1]["orthogonality"] != before[1]["orthogonality"]

    def task(kernel):
        _, terms = terms_of(kernel)
        return terms["reconstruction"] + terms["localization"]

    grad = np.asarray(jax.grad(task)(kernel))
    assert np.all(grad[:, 3:] == 0.0) and np.all(np.abs(grad[:, :3]).max(axis=0) > 0.0)


def test_the_rate_counts_every_coordinate_whatever_the_prefix():
    params, batch = make_params(UAV), random_batch(UAV)
    short = batch._replace(prefix_mask=np.tile(np.float32(oracle.prefix_mask(1, 8)), (7, 1)))
    before = loss_of(params, batch, make_hypers(), UAV, "gaussian")[1]
    after = loss_of(params, short, make_hypers(), UAV, "gaussian")[1]
    assert float(before["rate"]) == float(after["rate"])
    assert float(before["reconstruction"]) != float(after["reconstruction"])


def test_the_loss_is_a_mean_over_examples():
    params, batch = make_params(UAV), random_batch(UAV)
    twice = Batch(*(np.concatenate([leaf, leaf[::-1]]) for leaf in batch))
    once, again = (loss_of(params, b, make_hypers(), UAV, "gaussian") for b in (batch, twice))
    np.testing.assert_allclose(once[0], again[0], rtol=1e-5)


@pytest.mark.parametrize("prior", ["gaussian", "ard"])
def test_gradients_are_finite_where_a_mean_is_exactly_zero(prior):
    params, batch = make_params(UAV), random_batch(UAV)
    params["params"]["mean"] = jax.tree.map(jnp.zeros_like, params["params"]["mean"])
    grads = jax.jit(jax.grad(lambda p: composite_loss(p, batch, make_hypers(), UAV, prior)[0]))(params)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(grads))

"""The composite objective term by term against float64 NumPy, and what must not influence it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.encoder.loss import Batch, composite_loss, make_hypers, orthogonality_penalty, prefix_mask
from ovibjax.encoder.model import decode, encode, locate
from ovibjax.encoder.train import TrainConfig, view_rows
from tests.encoder.test_model import QUICK, UAV, UGV, make_params
from tests.oracles import encoder as oracle

TERMS = ["reconstruction", "localization", "rate", "orthogonality"]
loss_of = jax.jit(composite_loss, static_argnums=(3, 4, 5), compiler_options=QUICK)
penalty = jax.jit(orthogonality_penalty)
penalty_grad = jax.jit(jax.grad(orthogonality_penalty))


def value_and_grad(params, batch, hypers, arch, prior, rows=None, precision="float32"):
    return jax.value_and_grad(composite_loss, has_aux=True)(params, batch, hypers, arch, prior, rows, precision)


differentiate = jax.jit(value_and_grad, static_argnums=(3, 4, 5, 6), compiler_options=QUICK)


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


def plain_penalty(w):
    """The formula, for automatic differentiation."""
    return jnp.sum((w @ w.T - jnp.eye(w.shape[0], dtype=w.dtype)) ** 2) / w.shape[0] ** 2


@pytest.mark.parametrize(("size", "width"), [(1, 5), (6, 4), (8, 12), (40, 64)])
@pytest.mark.parametrize("scale", [1e-2, 1.0, 30.0])
def test_the_gradient_of_the_penalty_equals_automatic_and_numerical_differentiation(size, width, scale):
    rng = np.random.default_rng(size)
    w = (rng.normal(size=(size, width)) * scale).astype(np.float32)
    grad = np.asarray(penalty_grad(jnp.array(w)), np.float64)
    automatic = jax.jit(jax.grad(plain_penalty))(jnp.array(w))
    np.testing.assert_allclose(grad, automatic, rtol=1e-4, atol=1e-5 * np.abs(grad).max())
    for _ in range(5):
        direction = rng.normal(size=w.shape)
        direction *= 1e-5 * scale / np.linalg.norm(direction)
        rise = oracle.orthogonality(w + direction) - oracle.orthogonality(w - direction)
        np.testing.assert_allclose((grad * 2 * direction).sum(), rise, rtol=1e-3, atol=1e-5 * abs(grad).max() * scale)


def test_the_gradient_of_the_penalty_follows_vmap_transposes_and_scale():
    kernels = jnp.array(np.random.default_rng(2).normal(size=(3, 12, 8)), jnp.float32)
    weights = jnp.array([2.0, -0.5, 0.0])

    def total(penalty):
        # As in training: the matrix is a transposed kernel, the penalty has a weight, members are mapped.
        members = jax.vmap(jax.value_and_grad(lambda kernel, weight: weight * penalty(kernel.T)))
        return jax.jit(members)(kernels, weights)

    ours, theirs = total(orthogonality_penalty), total(plain_penalty)
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-5)
    assert ours[1].shape == (3, 12, 8) and np.abs(ours[1][:2]).max() > 0.1 and np.all(ours[1][2] == 0.0)
    for kernel, weight, grad in zip(kernels, weights, ours[1], strict=True):
        np.testing.assert_allclose(grad, weight * penalty_grad(kernel.T).T, rtol=1e-4, atol=1e-5)


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
        tree = dict(params["params"])
        for view in views:
            layer = tree[f"descriptor_{view}"]
            tree[f"descriptor_{view}"] = {**layer, "bias": layer["bias"] + 1e3}
        return loss_of({"params": tree}, batch, make_hypers(), UAV, "gaussian")

    assert_same_to_the_bit(before, with_descriptor_bias([1, 4]))
    moved = with_descriptor_bias([2])
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
        layer = {**params["params"]["mean"], "kernel": kernel}
        tree = {"params": {**params["params"], "mean": layer}}
        _, terms = composite_loss(tree, batch, make_hypers(), UAV, "gaussian")
        return terms["reconstruction"] + terms["localization"]

    grad = np.asarray(jax.jit(jax.grad(task), compiler_options=QUICK)(kernel))
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
    _, grads = differentiate(params, batch, make_hypers(), UAV, prior)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(grads))


# ---- rows ----


def stratified_batch(static, size, seed=0):
    """A batch whose view masks are those of training, with every prefix length."""
    batch = random_batch(static.arch, size, seed)
    return batch._replace(view_mask=view_rows(static, size)[0])


def assert_same_loss_and_gradients(ours, theirs, rtol):
    for a, b in zip(jax.tree.leaves(ours[0]), jax.tree.leaves(theirs[0]), strict=True):
        np.testing.assert_allclose(a, b, rtol=rtol)
    for (path, a), b in zip(jax.tree_util.tree_leaves_with_path(ours[1]), jax.tree.leaves(theirs[1]), strict=True):
        np.testing.assert_allclose(a, b, rtol=rtol, atol=rtol * np.abs(b).max(), err_msg=str(path))
        assert np.all(np.isfinite(a)) and a.dtype == jnp.float32


CUT = [
    (UAV, None, 8),
    (UAV, None, 11),
    (UAV, None, 3),
    (UAV, ("F", "FS"), 11),
    (UAV, ("F",), 11),
    (UGV, None, 9),
    (UGV, None, 10),
]


@pytest.mark.parametrize(("arch", "modes", "size"), CUT)
def test_leaving_out_the_rows_a_view_lacks_changes_nothing(arch, modes, size):
    static = TrainConfig(arch=arch, modes=modes)
    params, batch = make_params(arch), stratified_batch(static, size)
    rows = view_rows(static, size)[1]
    assert sum(rows) < size * arch.n_views
    whole = differentiate(params, batch, make_hypers(), arch, "gaussian")
    cut = differentiate(params, batch, make_hypers(), arch, "gaussian", rows)
    assert_same_loss_and_gradients(cut, whole, rtol=1e-5)


def test_more_rows_than_needed_change_nothing():
    params, batch = make_params(UAV), stratified_batch(TrainConfig(arch=UAV), 11)
    rows = view_rows(TrainConfig(arch=UAV), 11)[1]
    more = tuple(min(11, count + 1 + view) for view, count in enumerate(rows))
    assert sum(more) > sum(rows) + 4
    whole, cut = (differentiate(params, batch, make_hypers(), UAV, "gaussian", counts) for counts in (None, more))
    assert_same_loss_and_gradients(cut, whole, rtol=1e-5)


def test_fewer_rows_than_needed_would_be_noticed():
    static = TrainConfig(arch=UAV)
    params, batch = make_params(UAV), stratified_batch(static, 8)
    rows = view_rows(static, 8)[1]
    whole = differentiate(params, batch, make_hypers(), UAV, "gaussian")
    for view in range(1, 5):
        fewer = tuple(count - (i == view) for i, count in enumerate(rows))
        loss, _ = loss_of(params, batch, make_hypers(), UAV, "gaussian", fewer)
        assert abs(float(loss) / float(whole[0][0]) - 1) > 1e-4, view


# ---- precision ----


@pytest.mark.parametrize("prior", ["gaussian", "ard"])
def test_the_objective_in_bfloat16_is_close_to_the_one_in_float32(prior):
    static = TrainConfig(arch=UAV)
    params, batch, hypers = make_params(UAV), stratified_batch(static, 64), make_hypers()
    # Noise of moderate size.
    params["params"]["logvar"] = jax.tree.map(lambda leaf: 0.3 * leaf, params["params"]["logvar"])
    rows = view_rows(static, 64)[1]
    exact, rounded = (
        differentiate(params, batch, hypers, UAV, prior, rows, precision) for precision in ("float32", "bfloat16")
    )
    for name in TERMS[:3]:
        ratio = float(rounded[0][1][name] / exact[0][1][name])
        assert abs(ratio - 1) < 0.02 and ratio != 1.0, name
    # The penalty is no product of the network.
    assert float(rounded[0][1]["orthogonality"]) == float(exact[0][1]["orthogonality"])
    for (path, a), b in zip(jax.tree_util.tree_leaves_with_path(rounded[1]), jax.tree.leaves(exact[1]), strict=True):
        assert a.dtype == jnp.float32
        assert np.linalg.norm(a - b) < 0.05 * np.linalg.norm(b), path


@pytest.mark.parametrize("precision", ["", "float16", "bf16", None])
def test_an_unknown_precision_is_an_error(precision):
    with pytest.raises(ValueError, match=r"float32.*bfloat16"):
        composite_loss(make_params(UAV), random_batch(UAV), make_hypers(), UAV, "gaussian", None, precision)

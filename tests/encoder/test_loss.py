"""The composite objective term by term against float64 NumPy, and what must not influence it."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.encoder.loss import Batch, composite_loss, make_hypers, prefix_mask
from ovibjax.encoder.model import decode, encode, locate
from ovibjax.encoder.train import TrainConfig, view_rows
from tests.encoder.cases import QUICK, TERMS, UAV, UGV, differentiate, make_params, random_batch, stratified_batch
from tests.oracles import encoder as oracle

loss_of = jax.jit(composite_loss, static_argnums=(3, 4, 5), compiler_options=QUICK)


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


def network_parts(arch, params):
    """encode, decode and locate of one float64 vector through the product's network."""

    def one(part):
        part = jax.jit(part, static_argnames="arch")

        def apply(row, *kept):
            out = part(params, jnp.array(row[None], jnp.float32), *kept, arch=arch)
            return jax.tree.map(lambda leaf: np.asarray(leaf[0], np.float64), out)

        return apply

    return one(encode), one(decode), one(locate)


def numpy_parts(params):
    def decode_sent(row, kept):
        return oracle.decode(params, row, sent=int(kept.sum()))

    return functools.partial(oracle.encode, params), decode_sent, functools.partial(oracle.locate, params)


WEIGHTS = [
    {"alpha": 1.0, "beta": 1e-3, "gamma": 0.1},
    {"alpha": 0.3, "beta": 2.0, "gamma": 7.0},
    {"alpha": 0.0, "beta": 0.0, "gamma": 0.0},
]


@pytest.mark.parametrize("prior", ["gaussian", "ard"])
@pytest.mark.parametrize("arch", [UAV, UGV, dataclasses.replace(UAV, kind="completing", rank=11)])
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


@pytest.mark.parametrize("prior", ["", "Gaussian", "laplace", "bit", None])
def test_an_unknown_prior_is_an_error(prior):
    with pytest.raises(ValueError, match=r"gaussian.*ard.*bits"):
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

"""Training as a pure function: sampling, optimizer, and one program for a grid."""

import dataclasses
import functools
import logging
import math

import chex
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from scipy import stats

from ovibjax.encoder.loss import Hypers, make_hypers
from ovibjax.encoder.model import decode, locate
from ovibjax.encoder.train import (
    PAPER_PREFIXES,
    TrainConfig,
    TrainData,
    fit,
    make_optimizer,
    sample_batch,
    view_rows,
    without_nesting,
)
from ovibjax.views import modes_for
from tests.encoder.test_model import QUICK, UAV, UGV
from tests.oracles import encoder as oracle

TERMS = ["loss", "reconstruction", "localization", "rate", "orthogonality"]
# As many rows in a batch as there are: one step an epoch, so that the metrics show every step.
RUN = TrainConfig(arch=UAV, prefixes=(2, 5, 8), steps=300, batch=64, warmup=10)


@functools.cache
def make_data(n_views=5, n=64, seed=0):
    """A plane curve seen through every view: position and features share three factors."""
    rng = np.random.default_rng(seed)
    y = rng.normal(size=(n, 3)).astype(np.float32)
    x = np.tanh(np.einsum("nk,kmr->nmr", y, rng.normal(size=(3, n_views, 6))))
    x = (x - x.mean(axis=0)) / x.std()
    return TrainData(jnp.array(x, jnp.float32), jnp.array(y))


def stack(*hypers):
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *hypers)


def lane(tree, *index):
    return jax.tree.map(lambda leaf: leaf[index], tree)


def assert_trees_equal(a, b):
    chex.assert_trees_all_equal(jax.device_get(a), jax.device_get(b))


def assert_trees_close(a, b, rtol, atol):
    chex.assert_trees_all_close(jax.device_get(a), jax.device_get(b), rtol=rtol, atol=atol)


quick_jit = functools.partial(jax.jit, static_argnums=3, compiler_options=QUICK)


def fit_grid(keys, hypers, data, static):
    """[seeds, members]."""
    over_hypers = jax.vmap(fit, in_axes=(None, 0, None, None))
    return jax.vmap(over_hypers, in_axes=(0, None, None, None))(keys, hypers, data, static)


train, train_grid, sample = quick_jit(fit), quick_jit(fit_grid), quick_jit(sample_batch)


GRID = [
    make_hypers(lr=1e-2),
    make_hypers(lr=1e-2),
    make_hypers(lr=1e-2, beta=0.5, gamma=3.0),
    make_hypers(alpha=5.0, lr=1e-2, weight_decay=0.1),
    make_hypers(lr=0.0),
    make_hypers(lr=0.0, beta=0.7, gamma=9.0, weight_decay=0.5),
    make_hypers(lr=1e-2, nesting=0.3),
]


@functools.cache
def grid_run():
    """Two seeds by seven members."""
    return jax.device_get(train_grid(jax.random.split(jax.random.key(3), 2), stack(*GRID), make_data(), RUN))


# ---- sampling ----


def draw(key, static, data, size):
    return sample(jax.random.key(key), jnp.arange(size) % data.x.shape[0], data, static)


NESTED = ("A5", "H4", "FS", "F")


@pytest.mark.parametrize("modes", [None, ("A5",), ("F",), ("F", "A5"), ("H4", "F", "FS"), ("FS", "H4")])
@pytest.mark.parametrize("n_views", [5, 4])
@pytest.mark.parametrize("size", [1, 3, 12, 50, 128])
def test_a_batch_is_shared_out_equally_with_most_views_first(n_views, modes, size):
    if n_views == 4 and modes and "A5" in modes:
        pytest.skip("a UGV has no such mode")
    static = TrainConfig(arch=UAV if n_views == 5 else UGV, modes=modes)
    masks, rows = view_rows(static, size)
    names = modes or modes_for(n_views)
    assert masks.shape == (size, n_views) and masks.dtype == np.float32
    np.testing.assert_array_equal(masks, oracle.equal_shares(size, names, n_views))
    table = np.stack([oracle.view_mask(mode, n_views) for mode in NESTED if mode in names])
    shares = (masks[:, None] == table[None]).all(axis=2).sum(axis=0)
    assert shares.sum() == size and np.ptp(shares) <= (size % len(names) > 0)
    assert np.all(np.diff(masks.sum(axis=1)) <= 0)
    # Every view is in the first rows, and in no other.
    assert isinstance(rows, tuple) and all(type(count) is int for count in rows)
    np.testing.assert_array_equal(masks, np.arange(size)[:, None] < np.array(rows)[None])
    assert rows[0] == size


def test_the_order_in_which_modes_are_named_is_immaterial():
    for names in (("F", "H4", "A5"), ("A5", "F", "H4")):
        np.testing.assert_array_equal(
            view_rows(TrainConfig(modes=names), 9)[0].sum(axis=1), [5, 5, 5, 4, 4, 4, 1, 1, 1]
        )
    assert view_rows(TrainConfig(modes=("A5",)), 7)[1] == (7,) * 5
    assert view_rows(TrainConfig(modes=("F",)), 7)[1] == (7, 0, 0, 0, 0)


@pytest.mark.parametrize(("n_views", "prefixes"), [(5, (1, 3, 4, 8)), (4, (2, 8)), (5, (8,))])
def test_modes_have_equal_shares_and_prefixes_are_uniform_in_each(n_views, prefixes):
    data = make_data(n_views)
    static = TrainConfig(arch=UAV if n_views == 5 else UGV, prefixes=prefixes)
    batch = draw(7, static, data, 36_000)
    np.testing.assert_array_equal(batch.view_mask, oracle.equal_shares(36_000, modes_for(n_views), n_views))
    masks = np.stack([oracle.prefix_mask(k, 8) for k in prefixes])
    drawn_prefix = (np.asarray(batch.prefix_mask)[:, None] == masks[None]).all(axis=2)
    np.testing.assert_array_equal(drawn_prefix.sum(axis=1), 1)
    modes = len(modes_for(n_views))
    table = drawn_prefix.reshape(modes, -1, len(prefixes)).sum(axis=1)
    if len(prefixes) > 1:
        # The shares of the modes are fixed, which takes degrees of freedom.
        assert stats.chisquare(table.ravel(), ddof=modes - 1).pvalue > 1e-3


def test_a_biased_sampler_would_be_noticed():
    counts = np.full(16, 2500.0)
    counts[3] *= 1.15
    assert stats.chisquare(counts, np.full(16, counts.mean())).pvalue < 1e-3


def test_noise_is_standard_normal_and_fresh_for_each_coordinate():
    batch = draw(1, RUN, make_data(), 10_000)
    noise = np.asarray(batch.noise, np.float64)
    assert noise.shape == (10_000, 8) and batch.noise.dtype == jnp.float32
    assert stats.kstest(noise.ravel(), "norm").pvalue > 1e-3
    np.testing.assert_allclose(np.corrcoef(noise.T), np.eye(8), atol=0.05)
    lengths = np.asarray(batch.prefix_mask).sum(axis=1)
    assert abs(np.corrcoef(lengths, noise[:, 0])[0, 1]) < 0.05


def test_rows_and_masks_belong_to_the_index():
    data, index = make_data(), jnp.array([5, 5, 0, 63, 17])
    batch = sample(jax.random.key(0), index, data, RUN)
    np.testing.assert_array_equal(batch.x, np.asarray(data.x)[np.asarray(index)])
    np.testing.assert_array_equal(batch.y, np.asarray(data.y)[np.asarray(index)])
    shapes = [(5, 5, 6), (5, 3), (5, 5), (5, 8), (5, 8)]
    assert [leaf.shape for leaf in batch] == shapes
    assert all(leaf.dtype == jnp.float32 for leaf in batch)


def test_a_batch_is_a_function_of_its_key_and_row_numbers():
    data = make_data()
    batch = draw(4, RUN, data, 64)
    assert_trees_equal(batch, draw(4, RUN, data, 64))
    other = draw(5, RUN, data, 64)
    np.testing.assert_array_equal(batch.view_mask, other.view_mask)
    for name in ("prefix_mask", "noise"):
        assert not np.array_equal(getattr(batch, name), getattr(other, name))
    # Masks and noise ignore what the rows hold.
    blank = draw(4, RUN, data._replace(x=data.x * 0, y=data.y * 0), 64)
    for name in ("view_mask", "prefix_mask", "noise"):
        np.testing.assert_array_equal(getattr(batch, name), getattr(blank, name))


@pytest.mark.parametrize("nesting", [0.0, 0.3, 0.5, 1.0])
def test_the_share_without_nesting_sees_all_coordinates(nesting):
    mask = np.tile(np.stack([oracle.prefix_mask(k, 8) for k in (1, 3, 4, 8)]), (2500, 1)).astype(np.float32)
    out = np.asarray(jax.jit(without_nesting)(jax.random.key(3), mask, jnp.float32(nesting)))
    assert out.shape == mask.shape and out.dtype == np.float32
    whole = out.min(axis=1) == 1.0
    np.testing.assert_array_equal(out[~whole], mask[~whole])
    partial = mask.min(axis=1) == 0.0
    if nesting in (0.0, 1.0):
        assert np.all(whole[partial] == (nesting == 0.0))
    count = int(whole[partial].sum())
    assert stats.binomtest(count, int(partial.sum()), 1 - nesting).pvalue > 1e-3
    # Whatever the prefix.
    for k in (1, 3, 4):
        assert abs(whole[mask.sum(axis=1) == k].mean() - (1 - nesting)) < 0.04


def test_a_higher_share_of_nesting_masks_more_examples_and_no_others():
    mask = jnp.zeros((1000, 8), jnp.float32)
    whole = [np.asarray(without_nesting(jax.random.key(0), mask, jnp.float32(share))) for share in (0.2, 0.6)]
    assert np.all(whole[0] >= whole[1]) and 300 < (whole[0] - whole[1])[:, 0].sum() < 500


def visited_rows(metrics, per_epoch, term="localization"):
    """Rows each epoch visited: row i has |y|^2 = 2^i and, with no latent coordinate, the position is zero.

    The same for the reconstruction: the row has 2^i r in its view Down and nothing in others.
    """
    sums = np.asarray(metrics[term], np.float64) * per_epoch
    return [frozenset(i for i in range(64) if (round(total) >> i) & 1) for total in sums]


def blind_data(n):
    y = np.array([[2.0 ** (i // 2), 2.0 ** (i // 2) if i % 2 else 0.0, 0.0] for i in range(n)], np.float32)
    x = np.zeros((n, 5, 6), np.float32)
    x[:, 4] = np.sqrt(2.0 ** np.arange(n))[:, None]
    return TrainData(jnp.array(x), jnp.array(y))


def blind_epochs(seed, static):
    hypers = stack(make_hypers(lr=0.0), make_hypers(lr=0.0, beta=3.0, gamma=2.0, weight_decay=1.0))
    params, metrics = train_grid(jax.random.key(seed)[None], hypers, blind_data(10), static)
    position = locate(lane(params, 0, 0), decode(lane(params, 0, 0), jnp.zeros((1, 8), jnp.float32), UAV), UAV)
    np.testing.assert_array_equal(position, 0.0)
    return lane(metrics, 0, 0), lane(metrics, 0, 1)


@pytest.mark.slow
def test_an_epoch_visits_every_row_at_most_once_in_a_fresh_order():
    static = TrainConfig(arch=UAV, prefixes=(0,), steps=24, batch=4, warmup=1)
    metrics = blind_epochs(0, static)
    ours, other = (visited_rows(series, 8) for series in metrics)
    # 10 rows in batches of 4: 8 distinct rows in each of 24 / 2 epochs.
    assert len(ours) == 12 and all(len(rows) == 8 for rows in ours)
    assert len(set(ours)) > 6
    assert frozenset.union(*ours) == frozenset(range(10))
    # One row of each batch of four is seen with all views, and not always the same.
    down = visited_rows(metrics[0], 8, "reconstruction")
    assert all(len(rows) == 2 and rows < visited for rows, visited in zip(down, ours, strict=True))
    assert len(frozenset.union(*down)) > 6
    # The order follows the seed alone.
    assert ours == other
    again, _ = (visited_rows(metrics, 8) for metrics in blind_epochs(1, static))
    assert again != ours


ONE_STEP = TrainConfig(arch=UAV, prefixes=(2, 5, 8), modes=("A5",), steps=1, batch=128, warmup=1)


@pytest.mark.slow
def test_fewer_rows_than_a_batch_are_one_batch():
    for metrics in blind_epochs(0, dataclasses.replace(ONE_STEP, prefixes=(0,))):
        assert visited_rows(metrics, 10, "reconstruction") == [frozenset(range(10))]
        assert visited_rows(metrics, 10) == [frozenset(range(10))]
        assert all(np.all(np.isfinite(metrics[name])) for name in TERMS)


# ---- optimizer ----


def optimizer_of(hypers, static, total):
    """init and update; optax itself raises a float to an int32 power, which strict promotion forbids."""
    optimizer = make_optimizer(hypers, static, total)

    @jax.jit
    def update(grads, state, params):
        with jax.numpy_dtype_promotion("standard"):
            return optimizer.update(grads, state, params)

    return optimizer.init, update


@pytest.mark.parametrize("weight_decay", [0.0, 0.3])
def test_the_optimizer_is_adamw_with_warm_up_and_cosine(weight_decay):
    total, warmup, peak = 20, 3, 0.05
    rng = np.random.default_rng(0)
    params = {"a": rng.normal(size=(3, 4)).astype(np.float32), "b": rng.normal(size=5).astype(np.float32)}
    grads = {k: (rng.normal(size=(total, *v.shape)) * 10 ** rng.uniform(-3, 2)).astype("f") for k, v in params.items()}
    static = TrainConfig(arch=UAV, warmup=warmup)
    hypers = make_hypers(lr=peak, weight_decay=weight_decay)
    start, update = optimizer_of(hypers, static, total)
    current, path = jax.tree.map(jnp.array, params), []
    state = start(current)
    for step in range(total):
        updates, state = update(jax.tree.map(lambda g, step=step: jnp.array(g[step]), grads), state, current)
        current = optax.apply_updates(current, updates)
        path.append(current)
    rates = [oracle.learning_rate(step, peak, warmup, total) for step in range(total)]
    np.testing.assert_allclose([max(rates), rates[0], rates[2], rates[3]], [peak, peak / 3, peak, peak])
    assert rates[-1] < peak / 50
    for name in params:
        for step, theirs in enumerate(oracle.adamw(params[name], grads[name], rates, weight_decay)):
            np.testing.assert_allclose(path[step][name], theirs, rtol=2e-4, atol=2e-6, err_msg=f"step {step}")


def test_warm_up_never_takes_more_than_a_fifth_of_a_short_run():
    hypers, params = make_hypers(lr=1.0, weight_decay=0.0), jnp.zeros(1)
    sizes = []
    start, update = optimizer_of(hypers, TrainConfig(arch=UAV, warmup=200), 10)
    state = start(params)
    for _ in range(10):
        # With a constant gradient an Adam step has the length of the learning rate.
        updates, state = update(jnp.ones(1), state, params)
        sizes.append(-float(updates[0]))
    np.testing.assert_allclose(sizes, [oracle.learning_rate(i, 1.0, 2, 10) for i in range(10)], rtol=1e-4, atol=1e-5)


def test_the_first_step_moves_each_parameter_by_the_learning_rate():
    data = make_data(n=10)

    def run(*hypers):
        params, _ = train_grid(jax.random.key(0)[None], stack(*hypers), data, ONE_STEP)
        return lane(params, 0, 0), lane(params, 0, 1)

    start, plain = run(make_hypers(lr=0.0), make_hypers(lr=1e-3, weight_decay=0.0))
    moved = [np.ravel(b - a) for a, b in zip(*map(jax.tree.leaves, (start, plain)), strict=True)]
    moved = np.abs(np.concatenate(moved))
    assert moved.max() < 1.01e-3 and np.mean(moved > 0.98e-3) > 0.95
    decayed, half = run(make_hypers(lr=1e-3, weight_decay=2.0), make_hypers(lr=5e-4, weight_decay=0.0))
    shrunk = jax.tree.map(lambda a, b: b - np.float32(2e-3) * a, start, plain)
    assert_trees_close(decayed, shrunk, rtol=1e-4, atol=1e-6)
    assert_trees_close(half, jax.tree.map(lambda a, b: (a + b) / 2, start, plain), rtol=1e-4, atol=1e-6)


# ---- fit ----


def assert_learned(metrics):
    assert sorted(metrics) == sorted(TERMS)
    for name in TERMS:
        assert metrics[name].shape == (300,) and metrics[name].dtype == jnp.float32
        assert np.all(np.isfinite(metrics[name]))
    for name in ("loss", "reconstruction", "localization"):
        assert np.mean(metrics[name][-20:]) < 0.6 * metrics[name][0], name


def test_training_lowers_the_loss():
    params, metrics = train(jax.random.key(0), make_hypers(lr=1e-2), make_data(), RUN)
    assert_learned(metrics)
    total = metrics["reconstruction"] + metrics["localization"]
    total = total + 1e-3 * metrics["rate"] + 0.1 * metrics["orthogonality"]
    np.testing.assert_allclose(metrics["loss"], total, rtol=1e-4)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(params))


@pytest.mark.parametrize(("n", "batch", "steps", "epochs"), [(10, 128, 5, 5), (10, 4, 5, 3), (10, 10, 1, 1)])
def test_steps_are_rounded_up_to_whole_epochs_and_few_rows_make_a_small_batch(n, batch, steps, epochs):
    static = TrainConfig(arch=UAV, prefixes=(8,), steps=steps, batch=batch)
    shapes = jax.eval_shape(functools.partial(fit, static=static), jax.random.key(0), make_hypers(), make_data(n=n))
    assert {name: leaf.shape for name, leaf in shapes[1].items()} == dict.fromkeys(TERMS, (epochs,))


def test_a_run_is_a_function_of_its_key():
    data = make_data()
    first = train(jax.random.key(11), make_hypers(), data, RUN)
    assert_trees_equal(first, train(jax.random.key(11), make_hypers(), data, RUN))
    other = train(jax.random.key(12), make_hypers(), data, RUN)
    assert np.all(first[1]["loss"] != other[1]["loss"])
    for a, b in zip(jax.tree.leaves(first[0]), jax.tree.leaves(other[0]), strict=True):
        assert not np.array_equal(a, b)


@pytest.mark.parametrize(("seed", "member"), [(0, 0), (0, 2), (1, 3), (1, 5), (0, 6)])
def test_a_member_alone_equals_its_lane_of_the_grid(seed, member):
    _, metrics = grid_run()
    key = jax.random.split(jax.random.key(3), 2)[seed]
    _, alone = train(key, GRID[member], make_data(), RUN)
    for name in TERMS:
        assert metrics[name].shape == (2, 7, 300)
        # Later steps drift: Adam divides a gradient by its size, so one of rounding noise may turn a step around.
        ours, theirs = metrics[name][seed, member, :6], alone[name][:6]
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, err_msg=name)
    if GRID[member].lr > 0:
        assert np.ptp(alone["orthogonality"][:6]) > 1e-4 * alone["orthogonality"][0]


def test_lanes_differ():
    _, metrics = grid_run()
    last = metrics["loss"][:, :, -1]
    # Members 0 and 1 have equal hyperparameters; all others and both seeds are apart.
    assert len({round(float(value), 5) for value in last[:, 1:].ravel()}) == 12
    assert np.all(metrics["loss"][0, 0] != metrics["loss"][1, 0])


def test_equal_hyperparameters_and_key_are_equal_to_the_bit():
    params, metrics = grid_run()
    for seed in range(2):
        assert_trees_equal(lane(params, seed, 0), lane(params, seed, 1))
        assert_trees_equal(lane(metrics, seed, 0), lane(metrics, seed, 1))


def test_members_of_a_seed_see_the_same_rows_masks_and_noise():
    params, metrics = grid_run()
    for seed in range(2):
        # A learning rate of zero stops the parameters, whatever the other weights.
        assert_trees_equal(lane(params, seed, 4), lane(params, seed, 5))
        for name in ("reconstruction", "localization", "rate", "orthogonality"):
            np.testing.assert_array_equal(metrics[name][seed, 4], metrics[name][seed, 5])
            # All members start from the same parameters and the same first batch, but for the share of nesting.
            np.testing.assert_allclose(metrics[name][seed, :6, 0], metrics[name][seed, 0, 0], rtol=1e-5)
            same = name in ("rate", "orthogonality")
            assert np.isclose(metrics[name][seed, 6, 0], metrics[name][seed, 0, 0], rtol=1e-5) == same
        assert np.all(metrics["loss"][seed, 4] != metrics["loss"][seed, 5])
        # The draws do change from step to step, also for parameters that stand still.
        assert len(set(metrics["reconstruction"][seed, 4].tolist())) > 290
    assert np.all(metrics["reconstruction"][0, 4] != metrics["reconstruction"][1, 4])


def test_masks_and_noise_are_fresh_at_every_step():
    # With equal rows the order of rows has no part in what the metrics see; the learning rate is zero in lane 4.
    data = make_data()
    data = data._replace(x=data.x[:1].repeat(64, axis=0), y=data.y[:1].repeat(64, axis=0))
    _, metrics = train_grid(jax.random.split(jax.random.key(3), 2), stack(*GRID), data, RUN)
    # View modes have fixed shares and the rate ignores noise and prefix: it stands still.
    for seed in range(2):
        np.testing.assert_allclose(metrics["rate"][seed, 4], metrics["rate"][seed, 4, 0], rtol=1e-6)
    for name in ("reconstruction", "localization"):
        for seed in range(2):
            assert len(set(np.asarray(metrics[name])[seed, 4].tolist())) > 250, name


def test_members_may_differ_in_every_hyperparameter():
    assert set(Hypers._fields) == {"alpha", "beta", "gamma", "lr", "weight_decay", "nesting"}
    base = GRID[0]
    _, reference = grid_run()
    keys = jax.random.split(jax.random.key(3), 2)
    changed = [base._replace(**{name: jnp.float32(0.9)}) for name in Hypers._fields]
    _, metrics = train_grid(keys, stack(base, *changed), make_data(), RUN)
    np.testing.assert_array_equal(metrics["loss"][:, 0], reference["loss"][:, 0])
    for member, name in enumerate(Hypers._fields, start=1):
        assert np.all(metrics["loss"][:, member, 5] != metrics["loss"][:, 0, 5]), name


def test_without_nesting_a_member_equals_one_of_full_length():
    hypers = make_hypers(lr=1e-2, nesting=0.0)
    _, ours = train(jax.random.key(4), hypers, make_data(), RUN)
    # Row order, initial parameters and noise do not depend on how prefixes are drawn.
    _, theirs = train(jax.random.key(4), hypers, make_data(), dataclasses.replace(RUN, prefixes=(8,)))
    for name in TERMS:
        np.testing.assert_allclose(ours[name][:6], theirs[name][:6], rtol=1e-4, err_msg=name)


@pytest.mark.parametrize("n_views", [pytest.param(5, marks=pytest.mark.long), 4])
def test_a_grid_in_bfloat16_learns_as_one_in_float32(n_views):
    static = TrainConfig(arch=UAV if n_views == 5 else UGV, prefixes=(2, 5, 8), steps=150, batch=32, warmup=10)
    hypers, series = stack(make_hypers(lr=1e-2), make_hypers(lr=1e-2, alpha=2.0)), {}
    for precision in ("float32", "bfloat16"):
        config = dataclasses.replace(static, precision=precision)
        members = quick_jit(jax.vmap(fit, in_axes=(None, 0, None, None)))
        params, metrics = members(jax.random.key(5), hypers, make_data(n_views, n=160), config)
        assert all(leaf.dtype == jnp.float32 for leaf in jax.tree.leaves((params, metrics)))
        series[precision] = np.asarray(metrics["loss"])
        assert series[precision].shape == (2, 30)
        assert np.all(series[precision][:, -3:].mean(axis=1) < 0.6 * series[precision][:, 0])
    first = series["bfloat16"][:, 0] / series["float32"][:, 0] - 1
    assert np.all(np.abs(first) < 0.01) and np.all(first != 0.0)


# ---- compilation ----


class Compilations(logging.Handler):
    """Names of the programs XLA compiled while the context was open."""

    def __enter__(self):
        self.names = []
        self.logging = jax.log_compiles()
        self.logging.__enter__()
        logging.getLogger("jax").addHandler(self)
        return self

    def __exit__(self, *exception):
        logging.getLogger("jax").removeHandler(self)
        self.logging.__exit__(*exception)

    def emit(self, record):
        message = record.getMessage()
        if message.startswith("Finished XLA compilation of "):
            self.names.append(message.removeprefix("Finished XLA compilation of ").split(" in ")[0])


@functools.cache
def two_grids():
    """Programs compiled by a first grid, by a second of other values, by the first again; traces; metrics."""
    traces = []

    @quick_jit
    def grid(keys, hypers, data, static):
        traces.append(static)
        return fit_grid(keys, hypers, data, static)

    def inputs(seed):
        rng = np.random.default_rng(seed)
        ranges = {
            "alpha": (0.5, 2),
            "beta": (1e-4, 1e-2),
            "gamma": (0.01, 1),
            "lr": (5e-3, 2e-2),
            "weight_decay": (0, 0.1),
            "nesting": (0, 1),
        }
        hypers = Hypers(**{name: jnp.array(rng.uniform(*ends, 3), jnp.float32) for name, ends in ranges.items()})
        # Equal settings written anew are the same static argument.
        static = TrainConfig(arch=UGV, prefixes=(2, 5, 8), prior="ard", steps=300, batch=20, warmup=10)
        return jax.random.split(jax.random.key(seed), 2), hypers, make_data(4, n=40, seed=seed), static

    # Inputs are made before the count starts.
    first, second, again = inputs(0), inputs(1), inputs(0)
    jax.block_until_ready((first[:3], second[:3], again[:3]))
    counts, outputs = [], []
    for arguments in (first, second, again):
        with Compilations() as compiled:
            outputs.append(jax.block_until_ready(grid(*arguments)))
        counts.append(compiled.names)
    return counts, traces, jax.device_get(outputs)


def test_a_grid_compiles_once_and_a_second_grid_of_other_values_never():
    (first, second, again), traces, outputs = two_grids()
    assert len(first) == 1 and "grid" in first[0]
    assert second == [] and again == [] and len(traces) == 1
    assert np.all(outputs[0][1]["loss"] != outputs[1][1]["loss"])
    assert_trees_equal(outputs[0], outputs[2])


def test_the_fixed_rate_model_of_a_ugv_learns_in_every_lane():
    _, _, outputs = two_grids()
    for _, metrics in outputs[:2]:
        for seed, member in np.ndindex(2, 3):
            # 40 rows in batches of 20: two steps an epoch.
            series = lane(metrics, seed, member)
            assert series["rate"].shape == (150,) and np.all(series["rate"] > 0)
            assert np.mean(series["localization"][-20:]) < 0.6 * series["localization"][0]
            assert np.mean(series["reconstruction"][-20:]) < 0.6 * series["reconstruction"][0]


def test_the_counter_sees_a_new_program():
    with Compilations() as compiled:
        jax.jit(lambda x: x * 3 + 1)(np.float32(2.0))
    assert len(compiled.names) >= 1


# ---- settings ----


def test_the_default_prefixes_are_the_papers():
    assert PAPER_PREFIXES == (4, 8, 16, 32, 64, 96, 128)
    static = TrainConfig()
    assert static.prefixes == PAPER_PREFIXES and max(static.prefixes) == static.arch.latent
    assert hash(static) == hash(TrainConfig()) and static != TrainConfig(steps=1)
    assert math.isclose(float(make_hypers().beta), 1e-3, rel_tol=1e-6)

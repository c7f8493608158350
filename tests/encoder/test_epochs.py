"""The training loop: the order of rows, and the optimizer with its schedule."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from ovibjax.encoder.epochs import make_optimizer
from ovibjax.encoder.loss import make_hypers
from ovibjax.encoder.model import decode, locate
from ovibjax.encoder.train import TrainConfig, TrainData
from tests.encoder.cases import TERMS, UAV, assert_trees_close, make_data, member_of, stack, train, train_grid
from tests.oracles import encoder as oracle

METRICS = ["loss", *TERMS]


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
    zeros, one = jnp.zeros((1, 8), jnp.float32), member_of(params, 0, 0)
    position = locate(one, decode(one, zeros, jnp.ones(8), UAV), UAV)
    np.testing.assert_array_equal(position, 0.0)
    return member_of(metrics, 0, 0), member_of(metrics, 0, 1)


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
        assert all(np.all(np.isfinite(metrics[name])) for name in METRICS)


def optimizer_of(hypers, warmup, total):
    """init and update; optax itself raises a float to an int32 power, which strict promotion forbids."""
    optimizer = make_optimizer(hypers, warmup, total)

    @jax.jit
    def update(grads, state, params):
        with jax.numpy_dtype_promotion("standard"):
            return optimizer.update(grads, state, params)

    return optimizer.init, update


@pytest.mark.parametrize("weight_decay", [0.0, 0.3])
def test_the_optimizer_is_adamw_with_warm_up_and_linear_decay(weight_decay):
    total, warmup, peak = 20, 3, 0.05
    rng = np.random.default_rng(0)
    params = {"a": rng.normal(size=(3, 4)).astype(np.float32), "b": rng.normal(size=5).astype(np.float32)}
    grads = {k: (rng.normal(size=(total, *v.shape)) * 10 ** rng.uniform(-3, 2)).astype("f") for k, v in params.items()}
    hypers = make_hypers(lr=peak, weight_decay=weight_decay)
    start, update = optimizer_of(hypers, warmup, total)
    current, path = jax.tree.map(jnp.array, params), []
    state = start(current)
    for step in range(total):
        updates, state = update(jax.tree.map(lambda g, step=step: jnp.array(g[step]), grads), state, current)
        current = optax.apply_updates(current, updates)
        path.append(current)
    rates = [oracle.learning_rate(step, peak, warmup, total) for step in range(total)]
    np.testing.assert_allclose([max(rates), rates[0], rates[2], rates[3]], [peak, peak / 3, peak, peak])
    assert rates[-1] == pytest.approx(peak / 17)
    for name in params:
        for step, theirs in enumerate(oracle.adamw(params[name], grads[name], rates, weight_decay)):
            np.testing.assert_allclose(path[step][name], theirs, rtol=2e-4, atol=2e-6, err_msg=f"step {step}")


def test_warm_up_never_takes_more_than_a_fifth_of_a_short_run():
    hypers, params = make_hypers(lr=1.0, weight_decay=0.0), jnp.zeros(1)
    sizes = []
    start, update = optimizer_of(hypers, 200, 10)
    state = start(params)
    for _ in range(10):
        # With a constant gradient an Adam step has the length of the learning rate.
        updates, state = update(jnp.ones(1), state, params)
        sizes.append(-float(updates[0]))
    np.testing.assert_allclose(sizes, [oracle.learning_rate(i, 1.0, 2, 10) for i in range(10)], rtol=1e-4, atol=1e-5)


def test_the_first_step_moves_each_parameter_by_the_learning_rate():
    data = make_data(n=10)

    def run(**hypers):
        return train(jax.random.key(0), make_hypers(**hypers), data, ONE_STEP)[0]

    start, plain = run(lr=0.0), run(lr=1e-3, weight_decay=0.0)
    moved = [np.ravel(b - a) for a, b in zip(*map(jax.tree.leaves, (start, plain)), strict=True)]
    moved = np.abs(np.concatenate(moved))
    assert moved.max() < 1.01e-3 and np.mean(moved > 0.98e-3) > 0.95
    decayed, half = run(lr=1e-3, weight_decay=2.0), run(lr=5e-4, weight_decay=0.0)
    shrunk = jax.tree.map(lambda a, b: b - np.float32(2e-3) * a, start, plain)
    assert_trees_close(decayed, shrunk, rtol=1e-4, atol=1e-6)
    assert_trees_close(half, jax.tree.map(lambda a, b: (a + b) / 2, start, plain), rtol=1e-4, atol=1e-6)

"""Lanes of one trace against the event loop and the plain replay; what is compiled, and when."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.scheduling import lanes
from ovibjax.scheduling.queue_replay import waits
from ovibjax.scheduling.replay_grid import run_grid
from ovibjax.scheduling.rules import SchedulerParams, ValueCoefficients, Weights, default_params
from ovibjax.scheduling.ties import TIES
from tests.oracles import scheduling as oracle
from tests.scheduling.random_requests import KINDS, expected_waits, random_trace, stack, take

N, LANES = 40, 20

pytestmark = pytest.mark.long  # every grid with many lanes compiles a dozen list sizes


def random_params(seed, values=False):
    """Twenty settings around the paper's, ties of all kinds in turn; its own is the first."""
    rng = np.random.default_rng(seed)

    def around(number):
        factors = np.exp(rng.uniform(-1, 1, LANES))
        factors[0] = 1.0
        return jnp.asarray(float(number) * factors, jnp.float32)

    params = default_params()._replace(ties=jnp.arange(LANES, dtype=jnp.int32) % len(TIES))
    swept = params._replace(V=around(params.V), weights=Weights(*map(around, params.weights)))
    return swept._replace(value=ValueCoefficients(*map(around, params.value))) if values else swept


def lane(params, number) -> SchedulerParams:
    return jax.tree.map(lambda leaf: leaf[number] if leaf.ndim else leaf, params)


def numbers(params):
    return {
        "V": float(params.V),
        "weights": tuple(map(float, params.weights)),
        "value": tuple(map(float, params.value)),
        "ties": TIES[int(params.ties)],
    }


@pytest.mark.parametrize(("policy", "values"), [("base_dpp", False), ("voi_lyapunov", False), ("voi_lyapunov", True)])
def test_lanes_equal_the_event_loop(policy, values):
    traces = [random_trace(seed, N, KINDS[seed % len(KINDS)]) for seed in range(40)]
    params = random_params(1, values)
    grid = np.asarray(run_grid(stack(traces), policy, params))
    assert grid.shape == (40, LANES, N)
    for row, trace in enumerate(traces):
        for number in (0, 1 + row % (LANES - 1)):
            expected = expected_waits(trace, policy, **numbers(lane(params, number)))
            np.testing.assert_array_equal(grid[row, number], expected)
    assert np.any(grid[:, 0] != grid[:, 1])


@pytest.mark.parametrize(("policy", "values"), [("base_dpp", False), ("voi_lyapunov", False), ("voi_lyapunov", True)])
def test_stretches_that_outgrow_the_list_are_replayed_exactly(policy, values):
    # 55 requests at once do not fit 32 slots; those before and after them do, as does the other trace.
    traces = []
    for seed in range(6):
        crowded = random_trace(seed, 110, ("ties", "twins", "burst")[seed % 3])
        ready = np.concatenate([crowded.ready_ms[:25], np.zeros(55) + 1e5, 2e5 + crowded.ready_ms[80:]])
        traces.append(crowded._replace(ready_ms=ready, valid=np.ones(110, bool)))
    traces.append(random_trace(8, 110, "spread"))
    params = random_params(2, values)
    grid = np.asarray(run_grid(stack(traces), policy, params))
    for row, trace in enumerate(traces):
        for number in (0, 9, 1 + row):
            expected = expected_waits(trace, policy, **numbers(lane(params, number)))
            np.testing.assert_array_equal(grid[row, number], expected)


def test_one_way_to_break_ties_for_all_lanes():
    traces = [random_trace(seed, N, ("ties", "twins")[seed % 2]) for seed in range(8)]
    params = random_params(6)._replace(ties=jnp.int32(TIES.index("client")))
    grid = np.asarray(run_grid(stack(traces), "base_dpp", params))
    for row, trace in enumerate(traces):
        for number in (0, 1 + row):
            expected = expected_waits(trace, "base_dpp", **numbers(lane(params, number)))
            np.testing.assert_array_equal(grid[row, number], expected)


def test_chunks_of_lanes_and_policies_without_parameters():
    traces = stack([random_trace(seed, N, "burst") for seed in range(2)])
    params = random_params(3)
    whole = run_grid(traces, "voi_lyapunov", params)
    np.testing.assert_array_equal(run_grid(traces, "voi_lyapunov", params, lanes=16), whole)
    for policy in ("fifo", "edf", "maxweight"):
        grid = np.asarray(run_grid(traces, policy, params))
        assert grid.shape == whole.shape and np.array_equal(grid[:, 0], grid[:, 9], equal_nan=True)
        np.testing.assert_array_equal(grid[1, 0], waits(take(traces, 1), policy, default_params()))


def test_summary_is_applied_to_each_lane():
    def longest(scale, wait_ms, params):
        return {"longest": scale * jnp.nanmax(wait_ms), "V": params.V, "age": params.weights.age}

    traces = stack([random_trace(seed, N, "burst") for seed in range(3)])
    params = random_params(4)._replace(weights=default_params().weights)
    scale = np.array([1.0, 2.0, 4.0], np.float32)
    found = run_grid(traces, "base_dpp", params, summary=longest, context=scale)
    grid = np.asarray(run_grid(traces, "base_dpp", params))
    np.testing.assert_array_equal(found["longest"], scale[:, None] * np.nanmax(grid, axis=-1))
    np.testing.assert_array_equal(found["V"], np.broadcast_to(params.V, (3, LANES)))
    assert found["age"].shape == (3, LANES) and np.all(found["age"] == np.float32(1.4))


def test_a_second_grid_of_other_values_compiles_nothing():
    def grid(seed):
        traces = stack([random_trace(seed + row, N, "burst") for row in range(2)])
        return np.asarray(run_grid(traces, "base_dpp", random_params(seed)))

    compiled = []
    first = grid(10)
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, seconds, **kwargs: compiled.append(event) if "backend_compile" in event else None
    )
    try:
        jax.jit(lambda x: x + 1)(jnp.ones(3))
        heard = len(compiled)
        assert heard > 0
        second = grid(20)
    finally:
        jax.monitoring.clear_event_listeners()
    assert len(compiled) == heard and np.any(first != second)


def test_lists_of_every_size_are_used():
    # Sizes are rounded up: a trace with exactly that many requests at once visits each.
    for size in lanes._SIZES[:-1]:
        trace = random_trace(size, N, "spread")
        trace = trace._replace(ready_ms=np.zeros(N), valid=np.arange(N) < size)
        params = random_params(5)
        grid = run_grid(stack([trace, trace]), "voi_lyapunov", params)
        for number in (0, 7):
            expected = oracle.replay(trace, "voi_lyapunov", **numbers(lane(params, number)))[0]
            np.testing.assert_array_equal(grid[0, number][:size], [expected[i] for i in range(size)])

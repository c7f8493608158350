"""Every policy against the plain event loop, exactly; conservation laws; what a bad trace is told."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.errors import InputError
from ovibjax.scheduling.queue_replay import POLICIES, ReplayResult, default_params, replay, waits
from ovibjax.scheduling.replay_grid import run_grid
from ovibjax.scheduling.requests import RequestTrace
from ovibjax.scheduling.rules import Weights
from tests.oracles import scheduling as oracle
from tests.scheduling.random_requests import CERTAIN, KINDS, expected_waits, random_trace, stack, take

N = 40

some_traces = st.builds(random_trace, st.integers(0, 10**6), st.just(N), st.sampled_from(KINDS))


@pytest.mark.parametrize("policy", POLICIES)
def test_500_traces_equal_the_event_loop(policy):
    traces = [random_trace(seed, N, KINDS[seed % len(KINDS)]) for seed in range(500)]
    found = np.asarray(run_grid(stack(traces), policy, default_params()))[:, 0]
    expected = np.stack([expected_waits(trace, policy) for trace in traces])
    np.testing.assert_array_equal(found, expected)
    assert np.nanmax(expected) > 500.0  # some queues are long


def test_policies_do_differ():
    traces = [random_trace(seed, N, "burst") for seed in range(5)]
    found = [np.stack([waits(trace, policy, default_params()) for trace in traces]) for policy in POLICIES]
    for i in range(len(POLICIES)):
        for j in range(i):
            assert np.any(found[i] != found[j], axis=1).sum() > 3, (POLICIES[i], POLICIES[j])


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("kind", ["burst", "hour", "empty"])
def test_run_returns_starts_and_finishes(policy, kind):
    trace = random_trace(5, N, kind)
    result = replay(trace, policy, default_params())
    starts, _, _ = oracle.replay(trace, policy)
    expected = np.array([starts.get(i, np.nan) for i in range(N)])
    assert isinstance(result, ReplayResult) and result.start_ms.dtype == np.float64
    np.testing.assert_array_equal(result.start_ms, expected)
    np.testing.assert_array_equal(result.finish_ms, expected + trace.service_ms)


def test_float32_traces_give_float32_results():
    trace = random_trace(5, N, "burst")
    narrow = RequestTrace(*(jnp.asarray(leaf) for leaf in trace))
    assert narrow.ready_ms.dtype == jnp.float32
    result = replay(narrow, "voi_lyapunov", default_params())
    assert result.start_ms.dtype == jnp.float32 and result.finish_ms.shape == (N,)
    exact = replay(trace, "voi_lyapunov", default_params())
    np.testing.assert_allclose(result.start_ms, exact.start_ms, rtol=1e-6)
    np.testing.assert_allclose(result.finish_ms, exact.finish_ms, rtol=1e-6)


@pytest.mark.parametrize("policy", POLICIES)
def test_an_hour_of_arbitrary_floats_stays_within_ticks(policy):
    rng = np.random.default_rng(3)
    for seed in range(20):
        trace = random_trace(seed, N, "hour")
        trace = trace._replace(ready_ms=trace.ready_ms + rng.uniform(0, 1, N), service_ms=rng.uniform(5, 30, N))
        trace.ready_ms[-1], trace.valid[-1] = 3.6e6, True
        starts, order, gap = oracle.replay(trace, policy)
        assert gap > CERTAIN
        result = replay(trace, policy, default_params())
        assert list(np.argsort(result.start_ms)[: len(order)]) == order
        expected = np.array([starts.get(i, np.nan) for i in range(N)])
        # A tick is 2^-9 ms; each service of a busy period adds at most half of one.
        assert np.nanmax(np.abs(result.start_ms - expected)) < 4 * 2.0**-9


def test_ticks_are_fine_for_a_short_trace_and_fit_a_long_one():
    base = random_trace(1, 4, "spread")._replace(
        client=np.zeros(4, np.int32), valid=np.ones(4, bool), service_ms=np.full(4, 0.001)
    )
    near = base._replace(ready_ms=np.array([0.0, 1e-4, 2e-4, 3e-4]))
    np.testing.assert_allclose(replay(near, "fifo", default_params()).start_ms, [0, 0.001, 0.002, 0.003], atol=3e-6)
    far = base._replace(ready_ms=np.array([0.0, 8.64e7, 8.64e7, 8.64e7]))  # a day
    np.testing.assert_allclose(waits(far, "edf", default_params()), np.zeros(4), atol=0.1)


@pytest.mark.parametrize("policy", ["base_dpp", "voi_lyapunov"])
def test_more_waiting_requests_than_the_window(policy):
    trace = random_trace(2, 150, "overload")
    np.testing.assert_array_equal(waits(trace, policy, default_params()), expected_waits(trace, policy))


def test_vmap_over_traces_and_parameters_equals_the_loop():
    traces = stack([random_trace(seed, N, "burst") for seed in range(4)])
    params = default_params()
    swept = params._replace(
        V=jnp.array([0.0, 1.0, 64.0]), weights=params.weights._replace(age=jnp.array([0.0, 1.4, 20.0]))
    )
    axes = jax.tree.map(lambda leaf: 0 if leaf.ndim else None, swept)
    for policy in ("base_dpp", "voi_lyapunov"):
        over_params = jax.vmap(lambda trace, p, policy=policy: waits(trace, policy, p), (None, axes))
        grid = jax.jit(jax.vmap(over_params, (0, None)))(traces, swept)
        for r in range(4):
            for p in range(3):
                chosen = jax.tree.map(lambda leaf, p=p: leaf[p] if leaf.ndim else leaf, swept)
                np.testing.assert_array_equal(grid[r, p], waits(take(traces, r), policy, chosen))
        assert np.any(np.asarray(grid[:, 0]) != np.asarray(grid[:, 2]))


def test_parameters_reach_the_rule():
    rng = np.random.default_rng(0)
    trace = random_trace(11, N, "burst")
    for _ in range(5):
        weights, value = rng.uniform(0, 4, 6), (0.1, *rng.uniform(0, 2, 2), 0.01)
        params = default_params()._replace(
            weights=Weights(*map(jnp.float32, weights)), value=type(default_params().value)(*map(jnp.float32, value))
        )
        expected = expected_waits(trace, "voi_lyapunov", weights=tuple(weights), value=value)
        np.testing.assert_array_equal(waits(trace, "voi_lyapunov", params), expected)


def served(trace, policy):
    """Valid requests in the order of service: ready, start, finish."""
    result = replay(trace, policy, default_params())
    keep = np.asarray(trace.valid)
    columns = np.stack([trace.ready_ms, result.start_ms, result.finish_ms])[:, keep]
    assert np.isnan(result.start_ms[~keep]).all() and np.isfinite(columns).all()
    return columns[:, np.argsort(columns[1], kind="stable")]


@settings(deadline=None, max_examples=60)
@given(some_traces, st.sampled_from(POLICIES))
def test_one_server_that_never_idles_while_a_request_waits(trace, policy):
    ready, start, finish = served(trace, policy)
    assert np.all(start >= ready)
    assert np.all(start[1:] >= finish[:-1])  # never two in service
    for k in range(len(ready)):
        before = finish[k - 1] if k else -np.inf
        # Busy from the end of the last service, or else nothing unserved had arrived.
        assert start[k] == before or start[k] == np.min(ready[k:])
    # Work conservation: the same work is done at the same times whatever the order.
    busy = np.sort(served(trace, "fifo")[2])
    assert len(ready) == 0 or finish[-1] == busy[-1]


@settings(deadline=None, max_examples=40)
@given(some_traces, st.sampled_from(POLICIES), st.integers(0, 10**6), st.integers(-1000, 1000))
def test_order_and_origin_of_a_trace_do_not_matter(trace, policy, seed, shift_ms):
    # Equal arrivals go by index, so they are told apart first.
    rank = np.argsort(np.argsort(trace.ready_ms, kind="stable"))
    trace = trace._replace(ready_ms=trace.ready_ms + rank / 64)
    permutation = np.random.default_rng(seed).permutation(N)
    moved = RequestTrace(*(leaf[permutation] for leaf in trace))
    moved = moved._replace(ready_ms=moved.ready_ms + shift_ms)
    here, there = waits(trace, policy, default_params()), waits(moved, policy, default_params())
    np.testing.assert_array_equal(np.asarray(here)[permutation], there)


@settings(deadline=None, max_examples=40)
@given(some_traces)
def test_relations_between_policies(trace):
    params = default_params()
    np.testing.assert_array_equal(
        waits(trace, "maxweight", params), waits(trace, "base_dpp", params._replace(V=jnp.float32(0.0)))
    )
    equal = trace._replace(deadline_ms=np.full(N, 75.0))
    np.testing.assert_array_equal(waits(equal, "edf", params), waits(equal, "fifo", params))
    silent = params._replace(weights=jax.tree.map(jnp.zeros_like, params.weights))
    np.testing.assert_array_equal(waits(trace, "voi_lyapunov", silent), waits(trace, "fifo", params))


def test_numbers_of_padding_are_never_looked_at():
    trace = random_trace(4, N, "burst")
    keep = np.asarray(trace.valid)
    broken = RequestTrace(
        *(np.where(keep, leaf, np.nan) if leaf.dtype.kind == "f" else leaf for leaf in trace)
    )._replace(client=np.where(keep, trace.client, -7), valid=keep)
    for policy in POLICIES:
        np.testing.assert_array_equal(waits(broken, policy, default_params()), waits(trace, policy, default_params()))


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("ready_ms", np.nan, r"ready_ms\[3\] is nan"),
        ("service_ms", -1.0, r"service_ms\[3\] is -1.0; it must be at least 0"),
        ("service_est_ms", 0.0, r"service_est_ms\[3\] is 0.0; it must be positive"),
        ("deadline_ms", 0.0, r"deadline_ms\[3\] is 0.0; it must be positive"),
        ("deadline_ms", np.inf, r"deadline_ms\[3\] is inf"),
    ],
)
def test_bad_numbers_are_refused(field, value, message):
    trace = random_trace(4, N, "spread")._replace(valid=np.ones(N, bool))
    leaf = np.array(getattr(trace, field))
    leaf[3] = value
    with pytest.raises(InputError, match=message):
        replay(trace._replace(**{field: leaf}), "edf", default_params())


def test_bad_arguments_are_refused():
    trace = random_trace(4, N, "spread")
    with pytest.raises(InputError, match="policy 'lifo' is unknown"):
        replay(trace, "lifo", default_params())
    with pytest.raises(InputError, match=r"voi_m has shape \(3,\)"):
        replay(trace._replace(voi_m=np.ones(3)), "edf", default_params())
    with pytest.raises(InputError, match="stack them"):
        run_grid(trace, "edf", default_params())
    with pytest.raises(InputError, match="one common length"):
        params = default_params()
        uneven = params._replace(V=jnp.ones(3), weights=params.weights._replace(age=jnp.ones(4)))
        run_grid(stack([trace]), "base_dpp", uneven)

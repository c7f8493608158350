"""Requests of equal priority: every rule under every way to break ties, against the plain event loop."""

import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.scheduling.queue_replay import replay, waits
from ovibjax.scheduling.replay_grid import run_grid
from ovibjax.scheduling.rules import POLICIES, default_params
from ovibjax.scheduling.ties import TIES, served_first
from tests.scheduling.random_requests import expected_waits, random_trace, stack, take

N = 40
KINDS = ("ties", "twins", "deadlines", "burst", "single", "empty")


def some_trace(seed):
    """A random trace in which priorities tie; twins are of different clients."""
    kind = KINDS[seed % len(KINDS)]
    trace = random_trace(seed, N, kind)
    return (
        trace._replace(client=np.random.default_rng(seed).permutation(N).astype(np.int32)) if kind == "twins" else trace
    )


def copies(ready_ms, client, deadline_ms):
    """Requests that are alike in all but arrival, client and deadline; the first keeps the server busy."""
    n = len(ready_ms)
    plain = random_trace(0, n, "spread")
    alike = plain._replace(**{name: np.full(n, getattr(plain, name)[0]) for name in plain._fields})
    return alike._replace(
        client=np.array(client, np.int32),
        ready_ms=np.array(ready_ms, np.float64),
        service_ms=np.full(n, 100.0),
        deadline_ms=np.array(deadline_ms, np.float64),
        valid=np.ones(n, bool),
    )


@pytest.mark.parametrize("policy", POLICIES)
def test_every_rule_under_every_ties_equals_the_event_loop(policy):
    traces = [some_trace(seed) for seed in range(60)]
    grid = np.asarray(run_grid(stack(traces), policy, default_params()._replace(ties=jnp.arange(3))))
    assert grid.shape == (60, 3, N)
    for number, ties in enumerate(TIES):
        expected = np.stack([expected_waits(trace, policy, ties=ties) for trace in traces])
        np.testing.assert_array_equal(grid[:, number], expected, err_msg=ties)
        alone = np.asarray(run_grid(stack(traces), policy, default_params(ties)))
        np.testing.assert_array_equal(alone[:, 0], expected, err_msg=ties)
    for one, other in ((0, 1), (0, 2), (1, 2)):
        differ = np.any((grid[:, one] != grid[:, other]) & ~np.isnan(grid[:, one]), axis=1).sum()
        assert differ == 0 if policy == "fifo" else differ > 5, (policy, TIES[one], TIES[other])


@pytest.mark.parametrize("policy", ["maxweight", "voi_lyapunov"])
def test_more_waiting_requests_than_the_window(policy):
    trace = random_trace(2, 150, "twins")
    trace = trace._replace(ready_ms=trace.ready_ms / 16)
    for ties in TIES:
        np.testing.assert_array_equal(
            waits(trace, policy, default_params(ties)), expected_waits(trace, policy, ties=ties), err_msg=ties
        )


@pytest.mark.parametrize(
    ("ties", "order"), [("arrival", [0, 1, 2, 3, 4]), ("client", [0, 3, 2, 4, 1]), ("last", [0, 4, 3, 2, 1])]
)
def test_five_requests_by_hand(ties, order):
    # Requests 3 and 4 arrive at the same time: the earlier of the trace counts as the earlier.
    trace = copies([0, 10, 20, 30, 30], client=[9, 7, 5, 2, 6], deadline_ms=[1, 500, 490, 480, 480])
    for policy in ("edf", "maxweight", "base_dpp"):
        start_ms = replay(trace, policy, default_params(ties)).start_ms
        assert np.argsort(start_ms).tolist() == order, policy
    assert np.argsort(replay(trace, "fifo", default_params(ties)).start_ms).tolist() == [0, 1, 2, 3, 4]


def test_of_one_client_the_earliest_goes_first_under_ties_by_client():
    trace = copies([0, 10, 20, 30], client=[1, 4, 4, 3], deadline_ms=[1, 500, 490, 480])
    assert np.argsort(replay(trace, "edf", default_params("client")).start_ms).tolist() == [0, 3, 1, 2]


def test_deadlines_a_nanosecond_apart_do_not_tie():
    trace = copies([0, 10, 20], client=[0, 1, 2], deadline_ms=[1, 500 - 2.0**-20, 490])
    for ties in TIES:
        assert np.argsort(replay(trace, "edf", default_params(ties)).start_ms).tolist() == [0, 1, 2]


def test_a_priority_that_is_not_a_number_is_of_a_request_that_waits():
    priority = jnp.array([-jnp.inf, 3.0, jnp.nan, -jnp.inf], jnp.float32)
    number = jnp.arange(4, dtype=jnp.int32)
    assert [int(served_first(priority, number, number, jnp.int32(ties))) for ties in range(3)] == [2, 2, 2]


def test_order_of_clients_may_be_any_number():
    priority, arrival = jnp.zeros(3), jnp.arange(3, dtype=jnp.int32)
    client = jnp.array([5, -(2**31), 2**31 - 1], jnp.int32)
    assert int(served_first(priority, client, arrival, jnp.int32(TIES.index("client")))) == 1
    assert int(served_first(priority[2:], client[2:], arrival[2:], jnp.int32(TIES.index("client")))) == 0


def test_an_unknown_word_is_refused():
    with pytest.raises(InputError, match="ties 'random' is unknown; it must be one of arrival, client, last"):
        default_params("random")


def test_one_row_of_a_swept_grid_is_the_replay_of_it():
    traces = stack([random_trace(seed, N, "ties") for seed in range(3)])
    swept = default_params()._replace(ties=jnp.array([2, 0]), V=jnp.array([0.0, 8.0]))
    grid = run_grid(traces, "base_dpp", swept)
    first = default_params("last")._replace(V=jnp.float32(0.0))
    np.testing.assert_array_equal(grid[1, 0], waits(take(traces, 1), "base_dpp", first))
    np.testing.assert_array_equal(grid[2, 1], waits(take(traces, 2), "base_dpp", default_params()))

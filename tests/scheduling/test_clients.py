"""Traces of many clients: phases, urgencies, deadlines, jitter."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.edge.service import EDGE, estimate_ms
from ovibjax.scheduling.clients import (
    DEADLINE_MS,
    DEADLINE_SPREAD,
    PAPER_COST,
    PAPER_LATENCY_MS,
    TOP_VALUE_M,
    default_trace_params,
    make_trace,
)
from ovibjax.scheduling.events import synthetic_events

EVENTS = 12

compiled_trace = jax.jit(make_trace, static_argnames="n_clients")


@pytest.fixture(scope="module")
def events():
    return synthetic_events(jax.random.key(4), EVENTS, runs=1)


@pytest.fixture(scope="module")
def several():
    return synthetic_events(jax.random.key(4), EVENTS, runs=7)


def made(events, n_clients=5, rate=4.0, seed=0, **numbers):
    numbers = {name: jnp.asarray(value, bool if value is True else jnp.float32) for name, value in numbers.items()}
    params = default_trace_params()._replace(**numbers)
    trace = compiled_trace(jax.random.key(seed), events, n_clients, jnp.float32(rate), params)
    return jax.tree.map(np.asarray, trace)


def test_ready_times_follow_phase_encoding_and_transmission(events):
    trace = made(events, phase_spread_s=0.0)
    uplink_ms = 31.7 + 1000.0 * np.asarray(events.payload_bytes[0]) / (4.0 * 1024.0)
    ready_ms, found_ms = (leaf.reshape(5, EVENTS) for leaf in (trace.requests.ready_ms, trace.uplink_ms))
    for client in range(5):  # its own requests in their order, from one of them on and around
        shifts = [s for s in range(EVENTS) if np.allclose(np.roll(uplink_ms, -s), found_ms[client], rtol=1e-6)]
        assert shifts
    np.testing.assert_allclose(ready_ms - found_ms, np.tile(1000.0 * events.time_s, (5, 1)), rtol=1e-6)
    np.testing.assert_array_equal(trace.requests.client.reshape(5, EVENTS), np.tile(np.arange(5)[:, None], EVENTS))


def test_encoding_takes_as_long_as_the_prefix_says(events):
    longer = events._replace(
        prefix=jnp.where(jnp.arange(EVENTS) % 2, 32, 128)[None], payload_bytes=jnp.full((1, EVENTS), 100)
    )
    encode_ms = made(longer).uplink_ms - 1000.0 * 100 / (4.0 * 1024.0)
    np.testing.assert_allclose(np.unique(encode_ms.round(3)), [32.3, 35.7], rtol=1e-5)
    assert (np.abs(encode_ms - 32.3) < 0.01).sum() == 5 * EVENTS // 2


def test_requests_have_phases_and_a_client_keeps_its_urgency(events):
    trace = made(events, phase_spread_s=2.0)
    phase_ms = (trace.requests.ready_ms - trace.uplink_ms).reshape(5, EVENTS) - 1000.0 * np.asarray(events.time_s)
    assert np.all(phase_ms >= -0.1) and np.all(phase_ms <= 2000.1)
    assert np.all(np.ptp(phase_ms, axis=1) > 100) and np.all(np.ptp(phase_ms, axis=0) > 100)
    urgency = trace.requests.urgency.reshape(5, EVENTS)
    assert np.all(np.ptp(urgency, axis=1) == 0) and len(np.unique(urgency[:, 0])) == 5
    assert np.all((urgency >= 0.5) & (urgency <= 1.5))
    assert DEADLINE_MS == 1052  # the figure of its derivation
    assert np.all((trace.requests.deadline_ms >= 420) & (trace.requests.deadline_ms <= 1684))
    assert len(np.unique(trace.requests.deadline_ms)) == 5 * EVENTS


def test_services_jitter_around_their_estimate(events):
    trace = made(events, n_clients=300)
    estimates_ms = np.unique(np.asarray(estimate_ms(EDGE, np.asarray(events.mode))))
    np.testing.assert_allclose(np.unique(trace.requests.service_est_ms), estimates_ms, rtol=1e-6)
    jitter = trace.requests.service_ms - (trace.requests.service_est_ms - 2.2)
    assert np.all(jitter > 0) and np.median(jitter) == pytest.approx(2.2, rel=0.05)
    assert np.std(np.log(jitter)) == pytest.approx(0.5, rel=0.05)


def test_more_clients_leave_the_others_as_they_are(events):
    few, many = made(events, 3, fading_depth=1.0), made(events, 6, fading_depth=1.0)
    for a, b in zip(jax.tree.leaves(few), jax.tree.leaves(many), strict=True):
        np.testing.assert_array_equal(a, b[: 3 * EVENTS])
    assert len(np.unique(many.uplink_ms)) == 6 * EVENTS  # every packet fades on its own


def test_clients_differ_in_everything_but_the_times(several):
    trace = made(several, n_clients=7, phase_spread_s=0.0)
    requests = trace.requests
    # Every client has the requests of another replay, all of them, in their order from one of them on.
    own = np.asarray(several.voi_m)
    found = requests.voi_m.reshape(7, EVENTS)
    matched = []
    for row in found:
        run = int(np.argmin([np.abs(np.sort(row) - np.sort(each)).max() for each in own]))
        shift = int(np.argmin(np.abs(own[run] - row[0])))
        np.testing.assert_allclose(np.roll(own[run], -shift), row, rtol=1e-6)
        matched.append((run, shift))
    assert sorted(run for run, _ in matched) == list(range(7)) and len({shift for _, shift in matched}) > 2
    # All ask when the first replay asked.
    ready_ms = (requests.ready_ms - trace.uplink_ms).reshape(7, EVENTS)
    np.testing.assert_allclose(ready_ms, np.tile(1000.0 * several.time_s[0], (7, 1)), rtol=1e-6)
    for name in ("risk_m", "drift_m_per_s", "delay_est_ms", "urgency"):
        assert len(np.unique(getattr(requests, name).reshape(7, EVENTS)[:, 0])) == 7, name


def test_a_replay_without_requests_sends_none_and_a_shorter_one_goes_around(several):
    count = np.array([EVENTS, 0, 5] + [EVENTS] * 4)
    cut = several._replace(valid=jnp.arange(EVENTS)[None] < count[:, None])
    requests = made(cut, n_clients=7).requests
    valid, voi_m = requests.valid.reshape(7, EVENTS), requests.voi_m.reshape(7, EVENTS)
    assert sorted(valid.sum(axis=1)) == [0] + [EVENTS] * 6
    short = [row for row in voi_m if np.isin(row, np.asarray(several.voi_m[2, :5])).all()]
    assert len(short) == 1 and len(np.unique(short[0])) == 5


def test_the_deadline_brings_the_papers_cost():
    """Drawn as they are, the deadlines give the paper's cost to a request of our top value and the paper's latency."""
    low, high = DEADLINE_MS * (1 - DEADLINE_SPREAD), DEADLINE_MS * (1 + DEADLINE_SPREAD)
    deadline_ms = np.random.default_rng(0).uniform(low, high, 400_000)
    assert np.mean(TOP_VALUE_M * PAPER_LATENCY_MS / deadline_ms) == pytest.approx(PAPER_COST, rel=0.005)


def test_clients_with_times_of_their_own_ask_as_often_as_they_did_from_a_place_on(several):
    trace = made(several, n_clients=7, phase_spread_s=0.0, own_times=True)
    time_s = ((trace.requests.ready_ms - trace.uplink_ms) / 1000.0).reshape(7, EVENTS)
    begun = []
    for row, voi_m in zip(time_s, trace.requests.voi_m.reshape(7, EVENTS), strict=True):
        run = int(np.argmin([np.abs(voi_m - each).max() for each in np.asarray(several.voi_m)]))
        shift = (row - np.asarray(several.time_s[run])) % 296.5
        np.testing.assert_allclose(shift, shift[0], atol=1e-3)
        begun.append(shift[0])
    assert np.ptp(begun) > 50

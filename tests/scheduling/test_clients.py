"""Multi-client traces and their metrics against plain Python."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.edge.service import EDGE, estimate_ms
from ovibjax.scheduling.clients import Workload, default_trace_params, make_trace, metrics, synthetic_events
from ovibjax.scheduling.queue_replay import POLICIES, waits
from ovibjax.scheduling.rules import default_params
from tests.oracles import scheduling as oracle
from tests.scheduling.random_requests import random_trace

EVENTS = 12

compiled_trace = jax.jit(make_trace, static_argnames="n_clients")
compiled_metrics = jax.jit(metrics)


@pytest.fixture(scope="module")
def events():
    return synthetic_events(jax.random.key(4), EVENTS)


def made(events, n_clients=5, rate=4.0, seed=0, **numbers):
    params = default_trace_params()._replace(**{name: jnp.float32(value) for name, value in numbers.items()})
    trace = compiled_trace(jax.random.key(seed), events, n_clients, jnp.float32(rate), params)
    return jax.tree.map(np.asarray, trace)


def test_synthetic_events_are_in_order_one_per_slot(events):
    times = np.asarray(events.time_s)
    assert np.all(np.diff(times) >= 0.5) and times[0] >= 0 and times[-1] < 296.5
    assert set(np.asarray(events.payload_bytes).tolist()) <= {4 * 16 + 20 + 4 * m for m in (3, 5)}
    assert np.all(np.asarray(events.valid))


def test_ready_times_follow_phase_encoding_and_transmission(events):
    trace = made(events, phase_spread_s=0.0)
    uplink_ms = 30.3 + 1000.0 * np.asarray(events.payload_bytes) / (4.0 * 1024.0)
    np.testing.assert_allclose(trace.uplink_ms.reshape(5, EVENTS), np.tile(uplink_ms, (5, 1)), rtol=1e-6)
    ready_ms = trace.requests.ready_ms.reshape(5, EVENTS)
    np.testing.assert_allclose(ready_ms[0], 1000.0 * np.asarray(events.time_s) + uplink_ms, rtol=1e-6)
    np.testing.assert_array_equal(ready_ms, np.tile(ready_ms[0], (5, 1)))
    np.testing.assert_array_equal(trace.requests.client.reshape(5, EVENTS), np.tile(np.arange(5)[:, None], EVENTS))


def test_a_client_keeps_its_phase_and_its_urgency(events):
    trace = made(events, phase_spread_s=2.0)
    phase_ms = (trace.requests.ready_ms - trace.uplink_ms).reshape(5, EVENTS) - 1000.0 * np.asarray(events.time_s)
    assert np.all(phase_ms >= -0.1) and np.all(phase_ms <= 2000.1) and np.ptp(phase_ms[:, 0]) > 100
    assert np.all(np.ptp(phase_ms, axis=1) < 0.2)  # float32 at 300 s
    urgency = trace.requests.urgency.reshape(5, EVENTS)
    assert np.all(np.ptp(urgency, axis=1) == 0) and len(np.unique(urgency[:, 0])) == 5
    assert np.all((urgency >= 0.5) & (urgency <= 1.5))
    assert np.all((trace.requests.deadline_ms >= 100) & (trace.requests.deadline_ms <= 400))
    assert len(np.unique(trace.requests.deadline_ms)) == 5 * EVENTS


def test_services_jitter_around_their_estimate(events):
    trace = made(events, n_clients=300)
    fixed_ms = np.asarray(estimate_ms(EDGE, np.tile(np.asarray(events.mode), 300))) - 2.2
    np.testing.assert_allclose(trace.requests.service_est_ms, fixed_ms + 2.2, rtol=1e-6)
    jitter = trace.requests.service_ms - fixed_ms
    assert np.all(jitter > 0) and np.median(jitter) == pytest.approx(2.2, rel=0.05)
    assert np.std(np.log(jitter)) == pytest.approx(0.5, rel=0.05)


def test_more_clients_leave_the_others_as_they_are(events):
    few, many = made(events, 3, fading_depth=1.0), made(events, 6, fading_depth=1.0)
    for a, b in zip(jax.tree.leaves(few), jax.tree.leaves(many), strict=True):
        np.testing.assert_array_equal(a, b[: 3 * EVENTS])
    assert len(np.unique(many.uplink_ms)) == 6 * EVENTS  # every packet fades on its own


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("kind", ["burst", "twins", "empty", "single"])
def test_metrics_equal_the_plain_ones(policy, kind):
    trace = random_trace(8, 40, kind)
    uplink_ms = np.random.default_rng(1).uniform(30, 60, 40).astype(np.float32)
    params = default_params()
    found = compiled_metrics(Workload(trace, uplink_ms), waits(trace, policy, params), params)
    starts, _, _ = oracle.replay(trace, policy)
    requests = oracle.requests_of(trace)
    top = oracle.top_tenth(requests)
    if kind == "twins":  # twins are equal in value, and both belong to the top if one does
        least = min(oracle.scheduling_value(j) for j in top)
        top = [j for j in requests if oracle.scheduling_value(j) >= least]
    for group, members in ((found.top, top), (found.every, requests)):
        np.testing.assert_allclose(np.array(group), oracle.group_metrics(members, starts, uplink_ms), rtol=2e-5)


def test_the_percentile_is_that_of_numpy():
    rng = np.random.default_rng(0)
    for n in (1, 20, 21, 400):
        trace = random_trace(3, n, "spread")._replace(valid=np.ones(n, bool))
        waits_ms = rng.uniform(0, 300, n).astype(np.float32)
        found = compiled_metrics(Workload(trace, np.zeros(n, np.float32)), jnp.asarray(waits_ms), default_params())
        expected = np.percentile(waits_ms + trace.service_ms, 95)
        np.testing.assert_allclose(found.every.edge_p95_ms, expected, rtol=1e-5)

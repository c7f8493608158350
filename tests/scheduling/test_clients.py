"""Traces of many clients: phases, urgencies, deadlines, jitter."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.edge.service import EDGE, estimate_ms
from ovibjax.scheduling.clients import default_trace_params, make_trace
from ovibjax.scheduling.events import synthetic_events

EVENTS = 12

compiled_trace = jax.jit(make_trace, static_argnames="n_clients")


@pytest.fixture(scope="module")
def events():
    return synthetic_events(jax.random.key(4), EVENTS)


def made(events, n_clients=5, rate=4.0, seed=0, **numbers):
    params = default_trace_params()._replace(**{name: jnp.float32(value) for name, value in numbers.items()})
    trace = compiled_trace(jax.random.key(seed), events, n_clients, jnp.float32(rate), params)
    return jax.tree.map(np.asarray, trace)


def test_ready_times_follow_phase_encoding_and_transmission(events):
    trace = made(events, phase_spread_s=0.0)
    uplink_ms = 31.7 + 1000.0 * np.asarray(events.payload_bytes) / (4.0 * 1024.0)
    np.testing.assert_allclose(trace.uplink_ms.reshape(5, EVENTS), np.tile(uplink_ms, (5, 1)), rtol=1e-6)
    ready_ms = trace.requests.ready_ms.reshape(5, EVENTS)
    np.testing.assert_allclose(ready_ms[0], 1000.0 * np.asarray(events.time_s) + uplink_ms, rtol=1e-6)
    np.testing.assert_array_equal(ready_ms, np.tile(ready_ms[0], (5, 1)))
    np.testing.assert_array_equal(trace.requests.client.reshape(5, EVENTS), np.tile(np.arange(5)[:, None], EVENTS))


def test_encoding_takes_as_long_as_the_prefix_says(events):
    longer = events._replace(prefix=jnp.where(jnp.arange(EVENTS) % 2, 32, 128))
    encode_ms = made(longer).uplink_ms - 1000.0 * np.tile(events.payload_bytes, 5) / (4.0 * 1024.0)
    np.testing.assert_allclose(encode_ms, np.tile(np.where(np.arange(EVENTS) % 2, 32.3, 35.7), 5), rtol=1e-5)


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

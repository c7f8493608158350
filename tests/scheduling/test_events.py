"""Events of one client: recorded ones keep what the client predicted, synthetic ones are in order."""

from types import SimpleNamespace

import jax
import numpy as np
import pytest

from ovibjax.control.actions import ACTIONS
from ovibjax.control.client_state import SlotInfo
from ovibjax.errors import InputError
from ovibjax.scheduling.events import Events, recorded_events, recorded_runs, synthetic_events


def test_synthetic_events_are_in_order_one_per_slot():
    events = synthetic_events(jax.random.key(4), 12, runs=3)
    times = np.asarray(events.time_s)
    assert times.shape == (3, 12) and len(np.unique(times)) > 24
    assert np.all(np.diff(times) >= 0.5) and np.all(times[:, 0] >= 0) and np.all(times[:, -1] < 296.5)
    assert set(np.asarray(events.payload_bytes).ravel().tolist()) <= {4 * 16 + 20 + 4 * m for m in (3, 5)}
    assert np.all(np.asarray(events.valid))


def test_recorded_requests_keep_what_the_client_predicted():
    slots = 10
    sent = np.zeros(slots, bool)
    sent[[2, 7]] = True
    number = np.arange(slots, dtype=np.float32)
    run = SimpleNamespace(
        sent=sent,
        action=np.full(slots, 3),
        risk_before_m=number + 1.0,
        voi_m=number / 2,
        delay_s=number / 100,
    )
    context = np.array([0] * 5 + [2] * 5)
    numbers = np.arange(len(ACTIONS))
    actions = SimpleNamespace(mode=numbers, prefix=10 + numbers, payload_bytes=100 + numbers)
    events = recorded_events(run, context, np.array([0.4, 0.9, 1.6]), actions)
    np.testing.assert_array_equal(events.time_s, [1.0, 3.5])
    np.testing.assert_array_equal(events.mode, [3, 3])
    np.testing.assert_array_equal(events.prefix, [13, 13])
    np.testing.assert_array_equal(events.payload_bytes, [103, 103])
    np.testing.assert_allclose(events.voi_m, [1.0, 3.5])
    np.testing.assert_allclose(events.risk_m, [3.0, 8.0])
    np.testing.assert_allclose(events.drift_m_per_s, [0.4, 1.6])
    np.testing.assert_allclose(events.delay_est_ms, [20.0, 70.0])
    run.sent = np.zeros(slots, bool)
    with pytest.raises(InputError, match="sent no request"):
        recorded_events(run, context, np.array([0.4, 0.9, 1.6]), actions)


def test_runs_are_padded_and_the_leader_comes_first():
    rng = np.random.default_rng(0)
    sent = np.zeros((4, 10), bool)
    sent[0, [1, 4]] = sent[2, [3, 5, 8]] = sent[3, 9] = True  # the second never asks
    fields = {name: rng.normal(size=(4, 10)).astype(np.float32) for name in ("risk_before_m", "voi_m", "delay_s")}
    run = SlotInfo(**dict.fromkeys(SlotInfo._fields, np.zeros((4, 10))))._replace(
        sent=sent, action=rng.integers(0, 8, (4, 10)), **fields
    )
    context, rates = rng.integers(0, 3, 10), np.array([0.4, 0.9, 1.6])
    events = recorded_runs(run, context, rates, ACTIONS, first=2)
    assert isinstance(events, Events) and events.time_s.shape == (3, 3)
    np.testing.assert_array_equal(events.valid, [[1, 1, 1], [1, 1, 0], [1, 0, 0]])
    for row, s in enumerate((2, 0, 3)):
        alone = recorded_events(SlotInfo(*(leaf[s] for leaf in run)), context, rates, ACTIONS)
        for padded, leaf in zip(events, alone, strict=True):
            np.testing.assert_array_equal(padded[row][: len(leaf)], leaf)

"""The waiting room serves in the order of the replay, under every rule, and loses nobody."""

import jax
import numpy as np
import pytest

from ovibjax.live.waiting import WIDTHS, Ask, WaitingRoom
from ovibjax.scheduling.queue_replay import replay
from ovibjax.scheduling.requests import RequestTrace
from ovibjax.scheduling.rules import POLICIES, default_params

PARAMS = default_params()


def trace_of(seed, size=60, clients=7, load=1.6):
    """Requests whose times are whole ticks of the replay, so that its clock rounds nothing."""
    rng = np.random.default_rng(seed)
    ready_ms = np.cumsum(rng.integers(0, 64, size)) / 4.0
    f32 = np.float32
    return RequestTrace(
        client=rng.integers(0, clients, size).astype(np.int32),
        ready_ms=ready_ms,
        service_ms=rng.integers(20, int(64 * load), size) / 4.0,
        service_est_ms=rng.integers(20, 80, size).astype(f32) / 4,
        deadline_ms=rng.integers(100, 1000, size).astype(f32),
        voi_m=rng.uniform(-1, 6, size).astype(f32),
        drift_m_per_s=rng.uniform(0, 5, size).astype(f32),
        risk_m=rng.uniform(3, 9, size).astype(f32),
        delay_est_ms=rng.uniform(0, 80, size).astype(f32),
        urgency=rng.uniform(0.5, 1.5, size).astype(f32),
        valid=np.ones(size, bool),
    )


def ask_of(trace, j):
    row = {name: getattr(trace, name)[j].item() for name in Ask._fields if name != "ready_s"}
    return Ask(ready_s=trace.ready_ms[j] / 1000, **row)


def served_in_turn(trace, rule, params):
    """Order of service of a waiting room with the replay's clock."""
    room, clock_ms, order, ahead = WaitingRoom(rule, params), 0.0, [], list(range(len(trace.client)))
    while ahead or len(room):
        if not len(room):
            clock_ms = max(clock_ms, trace.ready_ms[ahead[0]])
        while ahead and trace.ready_ms[ahead[0]] <= clock_ms:
            j = ahead.pop(0)
            room.add(ask_of(trace, j), j)
        j = room.next(clock_ms / 1000)
        order.append(j)
        clock_ms += trace.service_ms[j]
    return order


@pytest.mark.parametrize("rule", POLICIES)
@pytest.mark.parametrize("ties", ["arrival", "client", "last"])
def test_the_order_of_service_is_the_replays(rule, ties):
    params = default_params(ties)
    for seed in range(3):
        trace = trace_of(seed)
        expected = np.argsort(np.asarray(replay(trace, rule, params).start_ms), kind="stable")
        assert served_in_turn(trace, rule, params) == expected.tolist()


def test_the_rules_differ_on_these_requests():
    orders = {tuple(served_in_turn(trace_of(0), rule, PARAMS)) for rule in POLICIES}
    assert len(orders) == len(POLICIES)


def test_nobody_is_lost_in_a_crowd():
    """More requests than the narrower widths hold, some leaving before they are served."""
    trace, room = trace_of(5, size=WIDTHS[1] + 20), WaitingRoom("voi_lyapunov", PARAMS)
    for j in range(len(trace.client)):
        room.add(ask_of(trace, j), j)
    gone = [3, 70, 5, 71]
    for j in gone:
        room.leave(j)
        room.leave(j)
    now_s = trace.ready_ms[-1] / 1000
    served = [room.next(now_s) for _ in range(len(room))]
    assert sorted(served + gone) == list(range(len(trace.client)))
    assert not len(room)
    assert room.backlog_ms == 0


def test_requests_past_their_deadline_come_out():
    trace, room = trace_of(6), WaitingRoom("edf", PARAMS)
    for j in range(len(trace.client)):
        room.add(ask_of(trace, j), j)
    now_ms = trace.ready_ms[-1]
    late = np.flatnonzero(now_ms - trace.ready_ms > trace.deadline_ms)
    assert 0 < len(late) < len(trace.client)
    assert room.backlog_ms == pytest.approx(trace.service_est_ms.sum())
    assert sorted(room.overdue(now_ms / 1000)) == late.tolist()
    assert sorted(room.next(now_ms / 1000) for _ in range(len(room))) == sorted(
        set(range(len(trace.client))) - set(late.tolist())
    )


def test_a_full_room_says_so():
    room, ask = WaitingRoom("fifo", PARAMS), ask_of(trace_of(0), 0)
    for j in range(WIDTHS[-1]):
        room.add(ask, j)
    assert room.full
    with pytest.raises(OverflowError):
        room.add(ask, -1)
    assert room.next(1.0) == 0


@pytest.mark.parametrize("rule", POLICIES)
def test_extreme_numbers_choose_somebody(rule):
    room = WaitingRoom(rule, PARAMS)
    extreme = [
        Ask(1, 0.0, 65535.0, 1e-3, 1e6, 1e6, 1e6, 0.0, 1e6),
        Ask(2, 0.0, 1.0, 1e6, -1e6, 0.0, 0.0, 1e6, 1e-6),
        Ask(1, 1e6, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0),
    ]
    for j, ask in enumerate(extreme):
        room.add(ask, j)
    assert sorted(room.next(2e6) for _ in range(3)) == [0, 1, 2]


def test_choosing_compiles_before_anybody_asks():
    room = WaitingRoom("maxweight", PARAMS)
    room.warm_up()
    trace = trace_of(7, size=WIDTHS[1] + 1)
    for j in range(len(trace.client)):
        room.add(ask_of(trace, j), j)
    with jax.log_compiles(), pytest.MonkeyPatch.context() as patch:
        compiled = []
        patch.setattr("jax._src.compiler.compile_or_get_cached", lambda *a, **k: compiled.append(a))
        while len(room):
            room.next(10.0)
    assert not compiled

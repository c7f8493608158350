"""A log that an exact server would have written is replayed to the same latencies; a slower one is not."""

import numpy as np
import pytest

from ovibjax.live.log_report import edge_ms, read_runs
from ovibjax.live.modelled import modelled_ms, side_by_side
from ovibjax.scheduling.queue_replay import replay
from ovibjax.scheduling.rules import POLICIES, default_params
from tests.live.edges import a_client, an_edge, run
from tests.live.test_edge_server import packet
from tests.live.test_log_report import EDGE, request, written
from tests.live.test_waiting import trace_of


def log_of(path, trace, rule, wait_ms):
    names = ("client", "deadline_ms", "voi_m", "drift_m_per_s", "risk_m", "delay_est_ms", "urgency", "service_est_ms")
    events = []
    for j in np.argsort(trace.ready_ms + wait_ms):
        fields = {name: getattr(trace, name)[j].item() for name in (*names, "service_ms")}
        events.append(request(int(j), "ok", ready_s=500.0 + trace.ready_ms[j] / 1000, queue_ms=wait_ms[j], **fields))
    return written(path, {**EDGE, "rule": rule}, *events)


@pytest.mark.parametrize("rule", POLICIES)
def test_a_log_of_the_replay_gives_the_replay(rule, tmp_path):
    trace = trace_of(3)
    wait_ms = np.asarray(replay(trace, rule, default_params()).start_ms) - trace.ready_ms
    (found,) = read_runs([log_of(tmp_path / "log", trace, rule, wait_ms)])
    order = np.argsort(trace.ready_ms + wait_ms)
    np.testing.assert_allclose(modelled_ms(found), (wait_ms + trace.service_ms)[order], atol=0.01)
    told = side_by_side(found)
    assert told["modelled_p95_ms"] == pytest.approx(told["edge_p95_ms"], abs=0.01)
    assert told["modelled_top_p95_ms"] == pytest.approx(told["top_p95_ms"], abs=0.01)


def test_another_rule_is_another_model(tmp_path):
    trace = trace_of(3)
    wait_ms = np.asarray(replay(trace, "fifo", default_params()).start_ms) - trace.ready_ms
    (found,) = read_runs([log_of(tmp_path / "log", trace, "fifo", wait_ms)])
    assert not np.allclose(modelled_ms(found), modelled_ms(found, "voi_lyapunov"))


def test_a_live_log_can_be_replayed(edge_model, tmp_path):
    log = tmp_path / "log.jsonl"

    async def test():
        edge = an_edge(edge_model, log, rule="edf", service_ms=5.0, in_flight=64)
        async with edge as server, a_client(server.port) as client:
            await client.ask(*(packet(i) for i in range(30)))

    run(test())
    (found,) = read_runs([log])
    told = side_by_side(found)
    assert all(np.isfinite(value) for value in told.values())
    # All arrived at once: the last leaves when everything is done, in the model as in the measurement.
    assert modelled_ms(found).max() == pytest.approx(edge_ms(found).max(), rel=0.01)
    assert found.column("turn_ms").min() >= 0


def test_a_run_without_an_answer_has_no_model(tmp_path):
    (found,) = read_runs([written(tmp_path / "log", EDGE, request(0, "expired"))])
    assert all(np.isnan(value) for value in side_by_side(found).values())

"""Tables of logs against numbers worked out by hand; what is missing or damaged is said."""

import json

import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.live import log_report
from ovibjax.live.log_drawing import draw_log
from ovibjax.scheduling.rules import default_params, scheduling_value


def request(sequence, status="ok", **fields):
    given = {"client": 1, "ready_s": 10.0 + sequence, "deadline_ms": 400, "voi_m": 1.0, "drift_m_per_s": 0.5}
    given |= {"risk_m": 6.0, "delay_est_ms": 20.0, "urgency": 1.0, "service_est_ms": 2.0, "queue_ms": 1.0}
    given |= {"service_ms": 3.0, "unpack_ms": 0.1, "turn_ms": 0.0, "decode_ms": 1.0, "retrieve_ms": 1.5, "pack_ms": 0.2}
    return {"event": "request", "status": status, "sequence": sequence, **given, **fields}


def question(sequence, status="ok", **fields):
    times = {"uplink_ms": 20.0, "e2e_ms": 30.0} if status == "ok" else {}
    return {"event": "question", "status": status, "client": 1, "sequence": sequence, **times, **fields}


def track(client, errors_m, first_slot=0):
    return {"event": "track", "client": client, "first_slot": first_slot, "errors_m": errors_m}


EDGE, ROBOTS = {"event": "start", "side": "edge", "rule": "edf"}, {"event": "start", "side": "robots", "policy": "voi"}
SUMMARY = {"event": "summary"}


def written(path, *events):
    path.write_text("".join(json.dumps(event) + "\n" for event in events))
    return path


def test_a_row_per_run_of_an_edge(tmp_path):
    requests = [request(i, queue_ms=float(i), voi_m=float(i % 7)) for i in range(40)]
    late = [request(50, "expired"), request(51, "gone")]
    refused = {"event": "refused", "why": "magic", "untold": 4}
    path = written(tmp_path / "a", EDGE, *requests, *late, refused, SUMMARY, EDGE, request(0))
    runs = log_report.read_runs([path])
    first, second = log_report.edge_rows(runs)
    assert (first["rule"], first["requests"], first["ok"], first["expired"], first["other"]) == ("edf", 42, 40, 1, 1)
    assert first["refused"] == 5
    assert first["per_s"] == pytest.approx(42 / 51)
    latency_ms = 3.0 + np.arange(40)
    assert first["edge_p95_ms"] == pytest.approx(np.percentile(latency_ms, 95))
    assert first["queue_ms"] == pytest.approx(19.5)
    # The largest value has the largest VOI: 6 of 40 requests, more than the tenth, as equals are in.
    top = latency_ms[np.arange(40) % 7 == 6]
    assert first["top_p95_ms"] == pytest.approx(np.percentile(top, 95))
    assert (first["killed"], second["killed"]) == (False, True)
    assert np.isnan(second["per_s"])


def test_the_top_decile_is_by_scheduling_value(tmp_path):
    rng = np.random.default_rng(0)
    fields = {n: rng.uniform(0.1, 5, 33).astype(np.float32) for n in log_report._VALUE}
    events = [request(i, **{n: float(v[i]) for n, v in fields.items()}) for i in range(33)]
    (run,) = log_report.read_runs([written(tmp_path / "a", EDGE, *events)])
    value = np.asarray(scheduling_value(*fields.values(), default_params().value))
    np.testing.assert_array_equal(np.flatnonzero(log_report.top_decile(run)), np.sort(np.argsort(value)[-4:]))


def test_a_row_per_run_of_robots(tmp_path):
    events = [
        question(0),
        question(1, e2e_ms=50.0),
        question(2, "timeout"),
        question(3, "lost"),
        question(4, "expired"),
    ]
    tracks = [track(1, [3.0], 2), track(1, [1.0, 2.0]), track(0, [5.0, 5.0])]
    (run,) = log_report.read_runs([written(tmp_path / "a", ROBOTS, *events, *tracks, {**SUMMARY, "ended": {}})])
    np.testing.assert_array_equal(log_report.route_errors_m(run), [[5.0, 5.0, np.nan], [1.0, 2.0, 3.0]])
    (row,) = log_report.robot_rows([run])
    assert (row["robots"], row["questions"], row["ok"], row["expired"], row["timeout"], row["other"]) == (
        2,
        5,
        2,
        1,
        1,
        1,
    )
    assert row["e2e_p50_ms"] == 40.0
    assert row["error_mean_m"] == pytest.approx(16 / 5)
    assert not row["killed"]


def test_both_sides_are_compared(tmp_path):
    edge = written(tmp_path / "a", EDGE, request(0), request(1), request(2, "expired"), request(9))
    asked = (question(0), question(1, "timeout"), question(2), question(3))
    robots = written(tmp_path / "b", ROBOTS, *asked)
    edges, driven = log_report.sides(log_report.read_runs([edge, robots]))
    agreed = log_report.agreement(edges, driven)
    assert agreed == {"questions": 4, "answered": 1, "unknown": 2, "unanswered": 1, "unasked": 1}
    assert log_report.agreement(edges, []) is None


def test_both_sides_in_one_file(tmp_path):
    path = written(tmp_path / "a", EDGE, ROBOTS, request(0), question(0), {**SUMMARY, "ended": {}}, SUMMARY)
    runs = log_report.read_runs([path])
    assert [len(run.events) for run in runs] == [1, 1]
    assert all(run.finished for run in runs)


def test_logs_without_anything_in_them_are_named(tmp_path):
    with pytest.raises(InputError, match=r"a: no run begins in it"):
        log_report.read_runs([written(tmp_path / "a", SUMMARY)])
    with pytest.raises(InputError, match="no request and no question"):
        log_report.sides(log_report.read_runs([written(tmp_path / "b", EDGE, SUMMARY)]))
    broken = request(0)
    del broken["queue_ms"]
    with pytest.raises(InputError, match="a request without its fields"):
        log_report.read_runs([written(tmp_path / "c", EDGE, broken)])


@pytest.mark.parametrize("which", [[EDGE, request(0)], [ROBOTS, question(0), track(1, [1.0, 2.0])], None])
def test_the_figure_shows_what_there_is(which, tmp_path):
    both = [EDGE, ROBOTS, *(request(i) for i in range(5)), request(9, "expired"), question(0), track(1, [1.0, 2.0])]
    edges, robots = log_report.sides(log_report.read_runs([written(tmp_path / "a", *(which or both))]))
    draw_log(tmp_path / "edge.png", edges, robots)
    assert (tmp_path / "edge.png").stat().st_size > 5000

"""The card of live edges: what it makes of logs against slow references, loads, verdicts that can fail, refusals."""

import csv
import dataclasses
from collections import Counter

import numpy as np
import pytest

from ovibjax.cards import catalog, live_study
from ovibjax.cards.catalog import cards_folder, load_card
from ovibjax.cards.job import NotHere
from ovibjax.cards.live_claims import judge_claims
from ovibjax.cards.live_load import OfferedLoad
from ovibjax.cards.live_routes import LiveRoutes, ReplayedRoutes
from ovibjax.cards.live_runs import MODELS, PARTS, in_order, run_of
from ovibjax.cards.live_study import LOADS, LiveSize, LiveStudy
from ovibjax.cards.reproduce import reproduce
from ovibjax.errors import InputError
from ovibjax.live.log_report import read_runs
from ovibjax.live.open_loop import Load, Offered
from ovibjax.live.pacing import Pace
from ovibjax.report.claims import HELD, NOT_HELD, ON_AVERAGE, REPORTED
from ovibjax.report.panels import draw_panels
from ovibjax.report.rows import write_rows
from tests.live.test_log_report import EDGE, request, written

card = load_card(cards_folder() / "live.py")
RULES = ("fifo", "voi_lyapunov")
COUNT, WARM = 40, 3


def served_in_turn(due_ms, kept_ms):
    """Waiting plus service of a server that takes requests as they come, one after another."""
    free_ms, found = 0.0, []
    for due, kept in zip(due_ms, kept_ms, strict=True):
        free_ms = max(free_ms, due) + kept
        found.append(free_ms - due)
    return np.array(found)


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A run of FIFO from a made-up log whose lines are in the order of service, and what was put into it."""
    rng = np.random.default_rng(0)
    due_s = 700.0 + np.cumsum(rng.exponential(0.02, COUNT))
    put = {
        "due_s": due_s,
        "service_ms": rng.uniform(14, 22, COUNT),
        "turn_ms": rng.uniform(0.1, 0.9, COUNT),
        "voi_m": rng.uniform(0, 6, COUNT),
        "late_s": rng.uniform(0, 0.004, COUNT),
        "decode_ms": rng.uniform(0.1, 1, COUNT),
        "retrieve_ms": rng.uniform(0.1, 1, COUNT),
    }
    kept_ms = put["service_ms"] + put["turn_ms"]
    # One after another, as they leave.
    put["sent_s"] = sent_s = np.maximum.accumulate(due_s + put["late_s"])
    put["late_s"] = sent_s - due_s
    edge_ms = served_in_turn(1000 * (sent_s - sent_s[0]), kept_ms)
    rows = [request(100 + i, client=0, ready_s=600.0 + i, voi_m=99.0) for i in range(WARM)]
    for j in range(COUNT):
        names = ("service_ms", "turn_ms", "voi_m", "decode_ms", "retrieve_ms")
        fields = {name: float(put[name][j]) for name in names} | {"queue_ms": float(edge_ms[j] - put["service_ms"][j])}
        rows.append(request(j, client=1 + j % 2, ready_s=float(sent_s[j]) + 0.001, **fields))
    mixed = [rows[i] for i in rng.permutation(len(rows))]
    log = written(tmp_path_factory.mktemp("live") / "log", {**EDGE, "rule": "fifo"}, *mixed)
    load = Load(1 + np.arange(COUNT) % 2, np.arange(COUNT), due_s - due_s[0], [b""] * COUNT, {})
    sent = Offered(due_s, sent_s, due_s + 0.003 + edge_ms / 1000, ["ok"] * COUNT)
    offered = OfferedLoad(load, np.full(COUNT, 55.0), ["FS"] * COUNT)
    (run,) = read_runs([log])
    return put, edge_ms, run, run_of(run, offered, sent, Pace(paper_speed=1.0))


def test_a_log_is_read_in_the_order_of_the_load(measured):
    put, edge_ms, _, found = measured
    np.testing.assert_allclose(found.edge_ms, edge_ms, atol=1e-5)
    np.testing.assert_allclose(found.service_ms, put["service_ms"], atol=1e-5)
    np.testing.assert_allclose(found.late_ms, 1000 * put["late_s"], atol=1e-6)
    np.testing.assert_allclose(found.noticed_ms, 1 + 1000 * put["late_s"], atol=1e-2)
    np.testing.assert_allclose(found.end_to_end_ms("live"), 55.0 + 3.0 + edge_ms, atol=1e-6)
    np.testing.assert_allclose(found.end_to_end_ms("kept"), 55.0 + edge_ms, atol=0.02)
    assert found.p95_ms("live") == pytest.approx(np.percentile(edge_ms, 95), abs=1e-4)
    # All other parts of the value are the same: the tenth with the largest VOI, the warm-up not among them.
    top = np.sort(np.argsort(put["voi_m"])[-COUNT // 10 :])
    np.testing.assert_array_equal(np.flatnonzero(found.top), top)
    assert found.p95_ms("live", "top10") == pytest.approx(np.percentile(edge_ms[top], 95), abs=1e-4)


def test_replays_are_those_of_an_exact_server_given_less_or_more(measured):
    put, edge_ms, _, found = measured
    due_ms, left_ms = (1000 * (put[name] - put[name][0]) for name in ("due_s", "sent_s"))
    pace = Pace(paper_speed=1.0)
    planned_ms = [pace.least_ms("FS", 1 + j % 2, j) for j in range(COUNT)]
    np.testing.assert_allclose(found.planned_ms, planned_ms)
    given = {"planned": (due_ms, planned_ms), "service": (left_ms, put["service_ms"])}
    given |= {"kept": (left_ms, put["service_ms"] + put["turn_ms"])}
    assert given.keys() == MODELS.keys()
    for model, times_ms in given.items():
        np.testing.assert_allclose(found.models[model], served_in_turn(*times_ms), atol=0.02)
    assert found.p95_ms("service") < found.p95_ms("kept") == pytest.approx(np.percentile(edge_ms, 95), abs=0.02)


def test_parts_add_up(measured):
    _, edge_ms, _, found = measured
    parts = found.parts
    assert tuple(parts) == PARTS
    np.testing.assert_allclose(parts["decode"] + parts["retrieve"] + parts["wait"], found.service_ms, atol=1e-5)
    np.testing.assert_allclose(parts["queue"] + found.service_ms, edge_ms, atol=1e-5)
    span_ms = 1000 * np.ptp(measured[0]["sent_s"]) + edge_ms[-1]
    assert found.share_busy == pytest.approx((found.service_ms + parts["dispatch"]).sum() / span_ms, rel=1e-3)


def test_a_request_without_an_answer_is_refused(measured):
    with pytest.raises(InputError, match="did not serve 1 of 2 requests"):
        in_order(measured[2], [(1, 0), (1, 999)])


def study(measured, repetitions=3, spread=0.02, **changes):
    """A study whose repetitions differ by some per cent; `changes` are factors on the live latencies of a rule."""
    run, rng = measured[3], np.random.default_rng(1)
    runs = {}
    for load in LOADS:
        for rule in RULES:
            each = []
            for _ in range(repetitions):
                factor = (1.0 if rule == "fifo" else 0.2) * (1 + spread * rng.normal())
                models = {name: factor * times_ms for name, times_ms in run.models.items()}
                models["kept"] = factor * run.edge_ms
                live_ms = factor * changes.get(rule, 1.0) * run.edge_ms
                each.append(dataclasses.replace(run, edge_ms=live_ms, models=models))
            runs[load, rule] = each
    errors_m = 5.0 + rng.uniform(0, 1, (4, 20))
    given, assumed = (ReplayedRoutes(f * errors_m, np.full(11, 75.0), ms) for f, ms in ((1.02, 2.0), (1.5, 20.0)))
    routes = LiveRoutes(errors_m, given, assumed, Counter(ok=9, expired=1), 2.0, 80.0)
    size = LiveSize(RULES, 2, repetitions, {"low": 1.0, "high": 1.0}, 4, 10.0, 5.0)
    return LiveStudy(size, runs, routes, 17.5, {"low": 23.0, "high": 51.0})


def test_verdicts_can_fail(measured):
    found = [claim.verdict for claim in judge_claims(study(measured))]
    assert found[:3] == [HELD] * 3 and found[5:] == [HELD, REPORTED, HELD]
    slow = judge_claims(study(measured, fifo=1.3, voi_lyapunov=8.0))
    assert [claim.verdict for claim in slow[:3]] == [NOT_HELD] * 3 and slow[5].verdict == NOT_HELD
    assert [claim.verdict for claim in judge_claims(study(measured, 1))[:3]] == [ON_AVERAGE] * 3
    away = study(measured)
    away = dataclasses.replace(away, routes=dataclasses.replace(away.routes, live_m=1.3 * away.routes.given.error_m))
    assert judge_claims(away)[7].verdict == NOT_HELD
    assert all(claim.own for claim in judge_claims(away))


def test_tables_caption_and_figure(measured, tmp_path):
    found = study(measured)
    write_rows(tmp_path / "table.csv", card.table_rows(found, [7, 8, 9]))
    with (tmp_path / "table.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 2 * 3 * 2 and {row["seed"] for row in rows} == {"7", "8", "9"}
    assert {row["requests"] for row in rows if row["scope"] == "top10"} == {str(COUNT // 10)}
    assert len(card.part_rows(found)) == 2 * 2 * len(PARTS) and len(card.route_rows(found)) == 4
    assert "23.0 and 51.0 requests per second" in card.caption(found)
    draw_panels(tmp_path / "figure.png", found, card.PANELS, 2)
    assert (tmp_path / "figure.png").stat().st_size > 20_000


def test_without_a_loopback_the_card_is_refused_and_the_others_are_made(tmp_path, monkeypatch, capsys):
    def none(*_, **__):
        raise OSError(97, "Address family not supported by protocol")

    monkeypatch.setattr(live_study.socket, "create_server", none)
    with pytest.raises(NotHere, match=r"no sockets at 127.0.0.1 \(Address family not supported"):
        live_study.require_loopback()
    cards = tmp_path / "cards"
    cards.mkdir()
    start = "from ovibjax.cards.live_study import require_loopback\nTITLE = 'T'\ndef run(job):\n    "
    (cards / "a_live.py").write_text(start + "require_loopback()\n")
    (cards / "b_easy.py").write_text(start + "(job.out / 'made').write_text('')\n")
    monkeypatch.setattr(catalog, "cards_folder", lambda: cards)
    monkeypatch.setattr("ovibjax.cards.reproduce._load", lambda *_: (None, None))
    reproduce("smoke", out=tmp_path / "out")
    assert "a_live: left out, this machine offers no sockets" in " ".join(capsys.readouterr().err.split())
    assert (tmp_path / "out" / "b_easy" / "made").exists()
    with pytest.raises(NotHere):
        reproduce("smoke", ["a_live"], out=tmp_path / "out")

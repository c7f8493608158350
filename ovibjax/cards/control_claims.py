"""What the paper says of VOI-Control against other request policies, judged on paired held-out seeds."""

import itertools

import numpy as np

from ovibjax.cards.control_drawing import MODEL_NAMES, NAMES, PAPER_MEAN_M
from ovibjax.cards.control_results import PAIRED, reductions
from ovibjax.cards.control_study import EXPECTED, FUSED, PAPER, TRANSFER, ControlStudy, Point
from ovibjax.control.controller import PAPER_BUDGET_KB
from ovibjax.report.claims import Claim, interval


def judge_claims(found: ControlStudy) -> list[Claim]:
    """The paper's statements, the same where corrections are fused, and what belongs beside them."""
    return [
        *_papers(found, PAPER),
        *(claim.as_own() for claim in _papers(found, FUSED)),
        *(claim.as_own() for claim in _beside(found)),
        _same_count(found),
        _compact(found),
    ]


def _beside(found: ControlStudy) -> list[Claim]:
    drifts = [point._replace(model=model) for point in (PAPER, FUSED) for model in MODEL_NAMES if model != "rate"]
    return [
        *(_other_drift(found, point) for point in drifts if point in found.points),
        *(_expected(found, point) for point in EXPECTED),
        _tuned(found),
        _with_gap(found),
        _budget(found),
    ]


def _papers(found: ControlStudy, point: Point) -> list[Claim]:
    order = ("oracle_action", "voi", "uncertainty", "budgeted_periodic", "random")
    reduced = (("budgeted_periodic", "24.8 %", "31.0 %"), ("uncertainty", "1.9 %", "4.3 %"))
    return [
        *(_lower(found, better, worse, point) for better, worse in itertools.pairwise(order)),
        *(
            _reduced(found, rival, metric, paper, point)
            for rival, *papers in reduced
            for metric, paper in zip(("mean_m", "p95_m"), papers, strict=True)
        ),
    ]


def _where(point: Point) -> str:
    """How a statement begins that is judged at another setting than the paper's."""
    gate = f"With a gate of {point.gate_sigma:g} sigma on corrections: " if np.isfinite(point.gate_sigma) else ""
    return gate or {"kalman": "With corrections fused by a Kalman filter: "}.get(point.correction, "")


def _lower(found: ControlStudy, better: str, worse: str, point: Point) -> Claim:
    low, high = (found.of(policy, "mean_m", point) for policy in (better, worse))
    return Claim.less(
        f"{_where(point)}{NAMES[better]} has a lower mean error than {NAMES[worse]}",
        f"{PAPER_MEAN_M[better]} / {PAPER_MEAN_M[worse]} m",
        f"{interval(low).text('m')} / {interval(high).text('m')}, difference {interval(high - low).text('m')}",
        *(low, high),
        rule=PAIRED,
    )


def _reduced(found: ControlStudy, rival: str, metric: str, paper: str, point: Point) -> Claim:
    metres, percent = reductions(found, metric, rival, point)
    return Claim.less(
        f"{_where(point)}VOI-Control reduces the {'mean' if metric == 'mean_m' else 'p95'} error of {NAMES[rival]}",
        paper,
        f"{percent.text('%', 1)} ({metres.text('m')})",
        *(found.of("voi", metric, point), found.of(rival, metric, point)),
        rule=PAIRED,
    )


def _other_drift(found: ControlStudy, point: Point) -> Claim:
    gains = [reductions(found, metric, "budgeted_periodic", point)[1].text("%", 1) for metric in ("mean_m", "p95_m")]
    return Claim.reported(
        f"{_where(point)}Against budgeted periodic where odometry drifts as {MODEL_NAMES[point.model]} has it",
        "-",
        f"VOI-Control reduces mean / p95 error by {gains[0]} / {gains[1]}",
        "the paper's drift is a rate in metres per second",
    )


def transfer_claims(found: ControlStudy) -> list[Claim]:
    """VOI-Control against budgeted periodic on routes that prices were not tuned on; intervals over routes."""
    return [_transfer(found, point).as_own() for point in TRANSFER]


def _transfer(found: ControlStudy, point: Point) -> Claim:
    statement = f"{_where(point)}On routes that prices were not tuned on, VOI-Control has a lower mean error than "
    statement += NAMES["budgeted_periodic"]
    voi, periodic = (found.by_route(policy, "mean_m", point) for policy in ("voi", "budgeted_periodic"))
    pairs = ", ".join(f"{a:.1f} / {b:.1f} m" for a, b in zip(voi, periodic, strict=True))
    if len(voi) < 2:
        return Claim.reported(statement, "one route", pairs, "one held-out route: no interval over routes")
    ours = f"{pairs} by route, difference {interval(periodic - voi).text('m', 1)} over {len(voi)} routes"
    return Claim.less(statement, "one route", ours, voi, periodic, rule="whole interval over routes above zero")


def _expected(found: ControlStudy, point: Point) -> Claim:
    usual = found.of("voi", "mean_m", point._replace(prior=PAPER.prior))
    change = interval(found.of("voi", "mean_m", point) - usual)
    return Claim.reported(
        f"{_where(point)}The mean calibrated risk in place of the median residual as what an action may leave",
        "the median",
        f"changes VOI-Control's mean error by {change.text('m')} (from {interval(usual).text('m')})",
        "paired over seeds",
    )


def _tuned(found: ControlStudy) -> Claim:
    metres, percent = reductions(found, "mean_m", "tuned_uncertainty")
    return Claim.reported(
        "Against an uncertainty rule whose threshold and gap are searched as VOI-Control's prices are",
        "-",
        f"VOI-Control reduces the mean error by {percent.text('%', 1)} ({metres.text('m')})",
        "the paper's rule of 6 m and 6 s is not tuned to the budget",
    )


def _with_gap(found: ControlStudy) -> Claim:
    metres, percent = reductions(found, "mean_m", "voi", policy="voi_gap")
    return Claim.reported(
        "A threshold and a shortest gap added to VOI-Control, searched with its prices",
        "-",
        f"reduce its mean error by {percent.text('%', 1)} ({metres.text('m')})",
        "the paper's rule asks wherever the net VOI is positive",
    )


def _budget(found: ControlStudy) -> Claim:
    free_kb = found.free_kb()
    over = 100.0 * float(np.mean(free_kb > PAPER_BUDGET_KB))
    return Claim.true(
        f"Prices that keep {PAPER_BUDGET_KB} KB on every tuning seed keep it on every held-out seed, without the cap",
        "a feasible configuration",
        f"{interval(free_kb).text('KB')}, at most {free_kb.max():.2f} KB; the cap binds on {over:.0f} % of the seeds",
        bool(free_kb.max() <= PAPER_BUDGET_KB),
        "no exception, where nothing but its prices holds VOI-Control back",
    )


def _same_count(found: ControlStudy) -> Claim:
    counts = found.of("voi", "requests")
    same = np.all([counts == found.of(policy, "requests") for policy in ("budgeted_periodic", "random")], axis=0)
    return Claim.true(
        "Budgeted periodic and random send exactly as many requests as VOI-Control under the same budget",
        "22 requests, 2.07 KB",
        f"VOI-Control {interval(counts).text(digits=1)} requests, {interval(found.of('voi', 'kb')).text('KB')}; counts "
        f"equal on {same.sum()} of {len(same)} seeds (front-only requests are smaller than theirs)",
        bool(same.all()),
        "no exception",
    )


def _compact(found: ControlStudy) -> Claim:
    sent, action = found.runs["voi"].sent, found.runs["voi"].action
    compact = float(np.mean(found.scene.actions.prefix[action[sent]] == found.scene.actions.prefixes[0]))
    return Claim.true(
        "The selected configuration uses compact prefixes",
        "all admitted requests",
        f"{100 * compact:.1f} % of VOI-Control's requests",
        compact == 1.0,
        "every request",
    )

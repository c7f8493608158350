"""Fig. and Table "high congestion": five schedulers on recorded VOI-Control requests of many clients."""

import itertools
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from ovibjax.cards.congestion_drawing import (
    PAPER_ALL_EDGE_MS,
    PAPER_TOP,
    draw_cost,
    draw_edge,
    draw_levels,
    draw_sensitivity,
    draw_ties_all,
    draw_ties_top,
)
from ovibjax.cards.congestion_study import Congestion, replay_congestion
from ovibjax.cards.job import Job
from ovibjax.cards.scheduling_drawing import NAMES
from ovibjax.cards.scheduling_study import PAIRED, PAPER_TIES, SCOPES, events_of, metric_columns
from ovibjax.report import panels
from ovibjax.report.claims import Claim, interval, write_claims
from ovibjax.report.rows import write_rows
from ovibjax.scheduling.clients import PHASE_SPREAD_S
from ovibjax.scheduling.congestion import LEVELS
from ovibjax.scheduling.rules import POLICIES
from ovibjax.scheduling.ties import TIES

TITLE = "Whom to serve: schedulers under congestion"

LEAST_CUT = 60.0
"""What of the paper's cut of 76.2 % is asked for here, per cent."""


@dataclass(frozen=True)
class Preset:
    """Size of the experiment.

    Attributes:
        seeds: scheduler seeds.
        sensitivity_seeds: those of the sensitivity panel.
    """

    seeds: int
    sensitivity_seeds: int


PRESETS = {"smoke": Preset(2, 2), "quick": Preset(16, 8), "full": Preset(64, 32)}


def run(job: Job) -> None:
    """Run the card: recorded requests, replays, table, claims, figure."""
    started = time.perf_counter()
    preset = PRESETS[job.preset]
    seeds = [job.seed + i for i in range(preset.seeds)]
    events = events_of(job)
    with job.stage("replay"):
        found = replay_congestion(events, seeds, preset.sensitivity_seeds)
    write_rows(job.out / "table.csv", table_rows(found, seeds))
    write_claims(job.out / "claims.json", judge_claims(found))
    with job.stage("draw"):
        panels.draw_panels(job.out / "figure.png", found, PANELS, 2, height_in=2.3)
    facts: dict[str, Any] = {"phase_spread_s": PHASE_SPREAD_S, "ties": PAPER_TIES, "requests": found.requests}
    job.record(TITLE, caption(found, seeds), seeds, started, **facts)


def table_rows(found: Congestion, seeds: list[int]) -> list[dict[str, Any]]:
    """One row per congestion level, rule, way to break ties, seed and scope, at the paper's V."""
    return [
        {
            "congestion": level,
            "policy": rule,
            "ties": ties,
            "seed": seed,
            "scope": scope,
            **metric_columns(found.levels[rule], scope, (case, i, column)),
        }
        for case, level in enumerate(LEVELS)
        for rule in POLICIES
        for column, ties in enumerate(TIES)
        for i, seed in enumerate(seeds)
        for scope in SCOPES
    ]


def judge_claims(found: Congestion) -> list[Claim]:
    """The paper's table, judged on paired seeds at high congestion under `PAPER_TIES`."""
    percent, alike = (found.cut_percent(levels) for levels in (found.levels, found.equal_urgency))
    return [
        _lowest(found, "edge_p95_ms", "edge p95", "ms", 1),
        _lowest(found, "e2e_p95_ms", "end-to-end p95", "ms", 1),
        _lowest(found, "cost", "weighted cost", "", 2),
        _lowest(found, "stale_m", "stale-feedback penalty", "m", 4),
        Claim.above_zero(
            "Top decile at high congestion: VOI-Lyapunov cuts the edge p95 of Base-DPP",
            "76.2 %",
            interval(percent).text("%", 1),
            percent,
            rule=PAIRED,
        ),
        Claim.at_least(
            f"It cuts it by at least {LEAST_CUT:g} %",
            "76.2 %",
            interval(percent).text("%", 1),
            LEAST_CUT,
            percent,
            rule=f"whole paired 95 % interval at or above {LEAST_CUT:g} %, ties to the lowest client (threshold ours)",
        ).as_own(),
        Claim.above_zero(
            "The same where every mission is equally urgent: what the value of information does alone",
            "-",
            interval(alike).text("%", 1),
            alike,
            rule=PAIRED,
        ).as_own(),
        *(_faster(found, fast, slow) for fast in ("fifo", "edf") for slow in ("base_dpp", "maxweight")),
        _differ(found),
        _own_times(found).as_own(),
    ]


def _own_times(found: Congestion) -> Claim:
    texts = [
        f"{NAMES[rule]} {interval(found.at(rule, 'top10', 'edge_p95_ms', of=found.own_times)).text('ms', 1)}"
        for rule in ("voi_lyapunov", "base_dpp", "fifo")
    ]
    return Claim.reported(
        "Edge p95 of the top decile at high congestion where every client asks at the times of its own replay",
        "-",
        ", ".join(texts),
        "the paper replays the events of one route with perturbed phases, which come in bursts",
    )


def _differ(found: Congestion) -> Claim:
    edge_ms = {rule: found.at(rule, "all", "edge_p95_ms") for rule in ("base_dpp", "maxweight", "fifo")}
    texts = [f"{NAMES[rule]} {interval(values).text('ms', 1)}" for rule, values in edge_ms.items()]
    return Claim.true(
        "All requests at high congestion: Base-DPP, MaxWeight and FIFO differ",
        " / ".join(f"{PAPER_ALL_EDGE_MS[rule]}" for rule in edge_ms) + " ms",
        ", ".join(texts),
        not any(np.array_equal(edge_ms[a], edge_ms[b]) for a, b in itertools.combinations(edge_ms, 2)),
        "edge p95 not equal on every seed, for each two of them",
    )


def _lowest(found: Congestion, metric: str, word: str, unit: str, digits: int) -> Claim:
    order = ("voi_lyapunov", "base_dpp", "maxweight", "edf", "fifo")
    ours, *rivals = (found.at(rule, "top10", metric) for rule in order)
    texts = [interval(values).text(unit, digits) for values in (ours, *rivals)]
    return Claim.less(
        f"Top decile at high congestion: VOI-Lyapunov has the lowest {word} of the five",
        f"{' / '.join(map(str, PAPER_TOP[metric].values()))} {unit}".rstrip(),
        f"{' / '.join(texts)} (Base-DPP, MaxWeight, EDF, FIFO)",
        *(ours, *rivals),
        rule="paired 95 % interval against every other policy above zero",
    )


def _faster(found: Congestion, fast: str, slow: str) -> Claim:
    a, b = (found.at(rule, "all", "edge_p95_ms") for rule in (fast, slow))
    return Claim.less(
        f"All requests at high congestion: {NAMES[fast]} has a lower edge p95 than {NAMES[slow]}",
        f"{PAPER_ALL_EDGE_MS[fast]} / {PAPER_ALL_EDGE_MS[slow]} ms",
        f"{interval(a).text('ms', 1)} / {interval(b).text('ms', 1)}, difference {interval(b - a).text('ms', 1)}",
        *(a, b),
        rule=PAIRED,
    )


def caption(found: Congestion, seeds: list[int]) -> str:
    """What the reader of the figure needs to know."""
    return (
        f"Clients ask {found.requests} times, when VOI-Control does on the paper's held-out route, each with requests "
        f"of a replay of its own, on the held-out routes in turn; {len(seeds)} seeds perturb the phase of a request "
        f"(within {PHASE_SPREAD_S:g} s, set once so that FIFO's edge p95 of all requests at high congestion came to "
        "the paper's 93 ms on tuning seeds), urgency, deadlines and service jitter. (a), (b) High congestion (N = 30, "
        "4 KB/s), 95 % intervals; black ticks: the paper's values. (c) Edge p95 of the top decile by congestion. (d) "
        "Reduction "
        "of that p95 by VOI-Lyapunov against Base-DPP as phase spread and number of clients vary. (e), (f) High "
        "congestion by who goes first of requests with equal priority, which the paper does not say; in the other "
        "panels the lowest client does."
    )


PANELS = {
    "cost of the requests that matter": draw_cost,
    "edge latency": draw_edge,
    "congestion separates the rules": draw_levels,
    "VOI-Lyapunov against Base-DPP": draw_sensitivity,
    "who goes first of equals: top decile": draw_ties_top,
    "who goes first of equals: all requests": draw_ties_all,
}

"""Fig. and Table "high congestion": five schedulers on recorded VOI-Control requests of many clients."""

import time
from dataclasses import dataclass
from typing import Any

from ovibjax.cards.congestion_claims import judge_claims
from ovibjax.cards.congestion_drawing import (
    draw_cost,
    draw_edge,
    draw_levels,
    draw_sensitivity,
    draw_ties_all,
    draw_ties_top,
)
from ovibjax.cards.congestion_study import Congestion, replay_congestion
from ovibjax.cards.job import Job
from ovibjax.cards.scheduling_study import PAPER_TIES, SCOPES, events_of, metric_columns
from ovibjax.report import panels
from ovibjax.report.claims import interval, write_claims
from ovibjax.report.rows import write_rows
from ovibjax.scheduling.clients import PHASE_SPREAD_S
from ovibjax.scheduling.congestion import LEVELS
from ovibjax.scheduling.rules import POLICIES
from ovibjax.scheduling.ties import TIES

TITLE = "Whom to serve: schedulers under congestion"


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


def caption(found: Congestion, seeds: list[int]) -> str:
    """What the reader of the figure needs to know."""
    fifo, varied = interval(found.at("fifo", "all", "edge_p95_ms")), found.varied["fifo"].top.edge_p95_ms.shape[1]
    return (
        f"Clients ask {found.requests} times, when VOI-Control does on the one held-out route, each with requests "
        f"of a replay of its own, on the held-out routes in turn; {len(seeds)} seeds perturb the phase of a request "
        f"(within {PHASE_SPREAD_S:g} s, set once so that FIFO's edge p95 of all requests at high congestion came to "
        f"the paper's 93 ms on tuning seeds; here it is {fifo.text('ms', 0)}), urgency, deadlines and service jitter. "
        "(a), (b) High congestion (N = 30, 4 KB/s), 95 % intervals; black ticks: the paper's values. (c) Edge p95 of "
        "the top decile by congestion. (d) Reduction of that p95 by VOI-Lyapunov against Base-DPP as phase spread and "
        f"number of clients vary, {varied} seeds. (e), (f) High congestion by who goes first of requests with equal "
        "priority, which the paper does not say; in the other panels the lowest client does."
    )


PANELS = {
    "cost of the requests that matter": draw_cost,
    "edge latency": draw_edge,
    "congestion separates the rules": draw_levels,
    "VOI-Lyapunov against Base-DPP": draw_sensitivity,
    "who goes first of equals: top decile": draw_ties_top,
    "who goes first of equals: all requests": draw_ties_all,
}

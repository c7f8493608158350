"""Measured and modelled (not in the paper): live edges and robots on this machine, beside the replay of the same."""

import time
from typing import Any

import numpy as np

from ovibjax.cards.job import Job
from ovibjax.cards.live_claims import judge_claims
from ovibjax.cards.live_drawing import draw_edge, draw_end_to_end, draw_off, draw_parts, draw_routes, draw_top
from ovibjax.cards.live_runs import MODELS, PARTS, SCOPES
from ovibjax.cards.live_study import LOADS, RATE_KB_PER_S, LiveSize, LiveStudy, measure
from ovibjax.live.log_report import percentile
from ovibjax.report import panels
from ovibjax.report.claims import write_claims
from ovibjax.report.rows import write_rows
from ovibjax.scheduling.rules import POLICIES

TITLE = "Measured and modelled"

PRESETS = {
    "smoke": LiveSize(("fifo", "voi_lyapunov"), 2, 1, {"low": 1.5, "high": 2.0}, 2, 60.0, 20.0),
    "quick": LiveSize(POLICIES, 30, 1, {"low": 5.0, "high": 8.0}, 10, 90.0, 9.0),
    "full": LiveSize(POLICIES, 30, 5, {"low": 5.0, "high": 12.0}, 20, 296.5, 6.0),
}


def run(job: Job) -> None:
    """Run the card: live edges in turns, robots, replays of both; tables, claims, figure."""
    started = time.perf_counter()
    found = measure(job, PRESETS[job.preset])
    seeds = [job.seed + i for i in range(found.size.repetitions)]
    write_rows(job.out / "table.csv", table_rows(found, seeds))
    write_rows(job.out / "parts.csv", part_rows(found))
    write_rows(job.out / "routes.csv", route_rows(found))
    write_claims(job.out / "claims.json", judge_claims(found))
    with job.stage("draw"):
        panels.draw_panels(job.out / "figure.png", found, PANELS, 2, height_in=2.4)
    facts: dict[str, Any] = {"kept_ms": round(found.kept_ms, 3), "requests_per_s": found.per_s}
    job.record(TITLE, caption(found), seeds, started, over=(len(seeds), "repetitions"), **facts)


def table_rows(found: LiveStudy, seeds: list[int]) -> list[dict[str, Any]]:
    """One row per load, rule, repetition and scope."""
    rows = []
    for (load, rule), runs in found.runs.items():
        for seed, run in zip(seeds, runs, strict=True):
            for scope in SCOPES:
                chosen = run.top if scope == "top10" else np.ones(len(run.top), bool)
                row = {"load": load, "policy": rule, "seed": seed, "scope": scope, "requests": int(chosen.sum())}
                row |= {"live_p95_ms": run.p95_ms("live", scope)}
                row |= {f"{model}_p95_ms": run.p95_ms(model, scope) for model in MODELS}
                row |= {
                    "live_e2e_p95_ms": percentile(run.end_to_end_ms("live")[chosen], 95),
                    "kept_e2e_p95_ms": percentile(run.end_to_end_ms("kept")[chosen], 95),
                    "late_p99_ms": percentile(run.late_ms, 99),
                    "share_busy": run.share_busy,
                }
                rows.append(row)
    return rows


def part_rows(found: LiveStudy) -> list[dict[str, Any]]:
    """Median and p95 of each part of the edge's time, by load and rule, over all repetitions."""
    rows = []
    for (load, rule), runs in found.runs.items():
        for part in PARTS:
            times_ms = np.concatenate([run.parts[part] for run in runs])
            p50, p95 = percentile(times_ms, 50), percentile(times_ms, 95)
            rows.append({"load": load, "policy": rule, "part": part, "p50_ms": p50, "p95_ms": p95})
    return rows


def route_rows(found: LiveStudy) -> list[dict[str, Any]]:
    """One row per robot: mean route error, driven and in both replays."""
    errors_m = (found.routes.live_m, found.routes.given.error_m, found.routes.assumed.error_m)
    names = ("live_m", "given_m", "assumed_m")
    means_m = zip(*(error_m.mean(axis=1).tolist() for error_m in errors_m), strict=True)
    return [{"robot": i, **dict(zip(names, row, strict=True))} for i, row in enumerate(means_m)]


def caption(found: LiveStudy) -> str:
    """What the reader of the figure needs to know."""
    size, busy = found.size, {load: np.mean([run.share_busy for run in found.every(load)]) for load in LOADS}
    late_ms = np.concatenate([run.late_ms for run in found.every()])
    return (
        "Not in the paper: `ovibjax edge serve` in a process of its own for every rule, load and repetition, asked "
        f"over loopback; {size.repetitions} repetitions, rules in an order drawn anew each time, the same requests "
        f"under every rule. (a) to (d), (f) An open loop: requests that {size.clients} robots sent in replays of their "
        "routes (codes of their frames, VOI, deadlines, state), observed at Poisson times, and sent whole when the "
        "paper's "
        f"encoding time and a {RATE_KB_PER_S:g} KB/s uplink are over; neither is emulated byte by byte. Decoding and "
        "retrieval take a fraction of a millisecond here, so that the edge waits until the paper's service profile is "
        "over (`--paper-speed 1`), drawn by the request's number; nothing expires. One edge took "
        f"{found.kept_ms:.1f} ms a request, by which the loads were chosen: {found.per_s['low']:.1f} and "
        f"{found.per_s['high']:.1f} requests per second; edges were then busy for {100 * busy['low']:.0f} and "
        f"{100 * busy['high']:.0f} % of the time. One request of each client goes first, answered and not counted; "
        "edges compile before they listen. The load generator was late by "
        f"{np.median(late_ms):.1f} ms (median; p99 {np.percentile(late_ms, 99):.1f} ms), which counts into "
        "end-to-end latencies. (a), (b) Replay: given service and dispatch of the live run. (d) Edge p95 of all "
        "requests in replays that are given less or more: green is within 15 %. Dispatch is what an edge does between "
        f"a request and the next, choosing included. (e) {len(found.routes.live_m)} robots in processes of their own, "
        f"closed loop, {size.speed:g} times as fast as the world, the edge too; the replay has their draws, "
        "and waits of a median that it assumes, or that is taken from the live edge; shade: 95 % interval of the "
        "paired difference to the second. (f) `wait` is what makes the edge as slow as the paper's."
    )


PANELS = {
    "edge latency, live and replayed": draw_edge,
    "end to end, with encoding and uplink": draw_end_to_end,
    "top decile under load, live and replayed": draw_top,
    "what a replay must be told": draw_off,
    "closed loop: live and replayed routes": draw_routes,
    "where an edge's time goes": draw_parts,
}

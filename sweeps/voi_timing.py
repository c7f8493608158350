"""Fig. "VOI-Control request timing on a held-out route": risk, requests, error, throughput and edge along one route."""

import time
from typing import Any

import numpy as np

from ovibjax.cards.control_results import PAIRED, representative, representative_replay, study
from ovibjax.cards.control_study import ControlStudy
from ovibjax.cards.job import Job
from ovibjax.cards.timeline import draw_timeline, time_s
from ovibjax.link.latency import kbytes_per_s
from ovibjax.report.claims import Claim, interval, write_claims
from ovibjax.report.rows import write_rows

TITLE = "VOI-Control request timing on a held-out route"


def run(job: Job) -> None:
    """Run the card: study, the representative seed's slots as a table, claims, figure."""
    started = time.perf_counter()
    found = study(job)
    seed, one = representative(found), representative_replay(found)
    context, names = found.route.context, found.scene.contexts
    write_rows(job.out / "table.csv", table_rows(found, seed))
    write_claims(job.out / "claims.json", judge_claims(found))
    with job.stage("draw"):
        draw_timeline(job.out / "figure.png", one, context, names, found.scene.actions, "VOI-Control")
    job.record(TITLE, caption(found), found.seeds, started, representative_seed=found.seeds[seed])


def table_rows(found: ControlStudy, seed: int) -> list[dict[str, Any]]:
    """One row per slot of the representative seed."""
    run = found.runs["voi"]
    names, actions = found.scene.contexts, found.scene.actions.names
    return [
        {
            "time_s": float(start_s),
            "context": names[found.route.context[t]],
            "risk_before_m": float(run.risk_before_m[seed, t]),
            "risk_m": float(run.risk_m[seed, t]),
            "error_m": float(run.error_m[seed, t]),
            "action": actions[run.action[seed, t]] if run.sent[seed, t] else "",
            "rate_bps": float(run.rate_bps[seed, t]),
            "edge_delay_ms": float(1000.0 * run.delay_s[seed, t]),
        }
        for t, start_s in enumerate(time_s(run.sent.shape[1]))
    ]


def judge_claims(found: ControlStudy) -> list[Claim]:
    """What the paper says of the timing: requests wait while the risk is low, and for link and queue."""
    low = {policy: low_risk_percent(found, policy) for policy in ("voi", "budgeted_periodic")}
    both = np.isfinite(list(low.values())).all(axis=0)
    low = {policy: percent[both] for policy, percent in low.items()}
    return [
        Claim.less(
            "VOI-Control delays requests while the local risk is low",
            "delays requests while local risk is low",
            f"{interval(low['voi']).text('%', 1)} of its requests fall into the half of its slots with the lower risk; "
            f"of as many evenly spaced ones {interval(low['budgeted_periodic']).text('%', 1)}",
            *(low["voi"], low["budgeted_periodic"]),
            rule=PAIRED,
        ),
        _adapts(found, "delay_s", 1e3, "ms", "VOI-Control asks while the edge is quick: at a lower predicted delay"),
        _adapts(
            found,
            "rate_bps",
            1 / kbytes_per_s(1.0),
            "KB/s",
            "VOI-Control asks while the link is fast: at a higher rate",
        ),
    ]


def _adapts(found: ControlStudy, field: str, scale: float, unit: str, start: str) -> Claim:
    """What the world was like when VOI-Control asked, and when as many evenly spaced requests were sent."""
    mean = {policy: scale * at_requests(found, policy, field) for policy in ("voi", "budgeted_periodic")}
    both = np.isfinite(list(mean.values())).all(axis=0)
    gain = (mean["voi"] - mean["budgeted_periodic"])[both]
    ours, other = (interval(values[both]).text(unit, 1) for values in mean.values())
    return Claim.above_zero(
        f"{start} than as many evenly spaced requests",
        "adapts decisions under time-varying throughput and queue state",
        f"{ours} against {other} at a request",
        gain if field == "rate_bps" else -gain,
        rule=PAIRED,
    )


def at_requests(found: ControlStudy, policy: str, field: str) -> np.ndarray:
    """[seeds] mean of a field over a policy's requests; NaN where it sent none."""
    run = found.runs[policy]
    count = run.sent.sum(axis=1)
    total = np.where(run.sent, np.asarray(getattr(run, field), np.float64), 0.0).sum(axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def low_risk_percent(found: ControlStudy, policy: str) -> np.ndarray:
    """[seeds] per cent of a policy's requests that were sent below its median local risk; NaN where it sent none."""
    run = found.runs[policy]
    quiet = run.risk_before_m < np.median(run.risk_before_m, axis=1, keepdims=True)
    count = run.sent.sum(axis=1)
    return np.where(count > 0, 100.0 * (run.sent & quiet).sum(axis=1) / np.maximum(count, 1), np.nan)


def caption(found: ControlStudy) -> str:
    """What the reader of the figure needs to know."""
    return (
        f"Held-out seed {found.seeds[representative(found)]}, the one with the median error of {len(found.seeds)}. "
        "(a) Local risk when the client decides, and its requests by view mode; background: route context. (b) Route "
        "error after corrections. (c) Block-fading uplink around 8 KB/s, and the delay that the client predicts for "
        "queueing, service and return."
    )

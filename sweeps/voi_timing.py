"""Fig. "VOI-Control request timing on a held-out route": risk, requests, error, throughput and edge along one route."""

import time
from typing import Any

import numpy as np

from ovibjax.cards.control_results import representative, representative_replay, study
from ovibjax.cards.control_study import ControlStudy
from ovibjax.cards.job import Job
from ovibjax.cards.timeline import draw_timeline, time_s
from ovibjax.report.claims import Claim, interval, write_claims
from ovibjax.report.rows import write_rows

TITLE = "VOI-Control request timing on a held-out route"


def run(job: Job) -> None:
    """Run the card: study, the representative seed's slots as a table, claims, figure."""
    started = time.perf_counter()
    found = study(job)
    seed, one = representative(found), representative_replay(found)
    context, names = found.routes.context[seed], found.scene.contexts
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
            "context": names[found.routes.context[seed, t]],
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
    """What the paper says of the timing: requests wait while the risk is low."""
    run = found.runs["voi"]
    low, all_slots = [], []
    for i in range(len(found.seeds)):
        if run.sent[i].any():
            quiet = run.risk_before_m[i] < np.median(run.risk_before_m[i])
            low.append(100.0 * float(run.sent[i][quiet].sum()) / float(run.sent[i].sum()))
            all_slots.append(100.0 * float(quiet.mean()))
    return [
        Claim.at_least(
            "VOI-Control delays requests while the local risk is low",
            "delays requests while local risk is low",
            f"{interval(low).text('%', 1)} of the requests fall into the half of the slots with the lower risk"
            if low
            else "no request was sent",
            25.0,
            np.array(all_slots) - np.array(low),
            rule="at most half of the share that random timing would put there, whole 95 % interval",
        )
    ]


def caption(found: ControlStudy) -> str:
    """What the reader of the figure needs to know."""
    return (
        f"Held-out seed {found.seeds[representative(found)]}, the one with the median error of {len(found.seeds)}. "
        "(a) Local risk when the client decides, and its requests by view mode; background: route context. (b) Route "
        "error after corrections. (c) Block-fading uplink around 8 KB/s, and the delay that the client predicts for "
        "queueing, service and return."
    )

"""Robots that correct g_psi while they drive, through a town that is no longer what it was in training (ours)."""

import time
from typing import Any

from ovibjax.cards.adaptation_arms import ARMS, SPENT
from ovibjax.cards.adaptation_claims import CALIBRATED, judge_claims
from ovibjax.cards.adaptation_drawing import PANELS
from ovibjax.cards.adaptation_study import WORLDS, AdaptationStudy, adaptation_study
from ovibjax.cards.job import Job
from ovibjax.control.adaptation import PROBE_EVERY, WEIGHTS
from ovibjax.control.changed_worlds import NOISE
from ovibjax.control.environment import SLOT_S
from ovibjax.control.predictor import PRIORS
from ovibjax.report import panels
from ovibjax.report.claims import write_claims
from ovibjax.report.rows import write_rows

TITLE = "Online adaptation: a prior that follows a world that changes"


def run(job: Job) -> None:
    """Run the card: study, table, claims, figure."""
    started = time.perf_counter()
    found = adaptation_study(job)
    write_rows(job.out / "table.csv", table_rows(found))
    write_claims(job.out / "claims.json", judge_claims(found))
    with job.stage("draw"):
        panels.draw_panels(job.out / "figure.png", found, PANELS, 2, height_in=1.9)
    job.record(TITLE, caption(found), found.seeds, started, **facts(found))


def table_rows(found: AdaptationStudy) -> list[dict[str, Any]]:
    """One row per prior, world, arm and held-out seed: errors, payload, requests."""
    return [
        {
            "prior": prior,
            "world": world,
            "arm": arm,
            "seed": seed,
            "mean_m": round(float(found.of(arm, world, prior=prior)[i]), 4),
            "after_m": round(float(found.of(arm, world, "after_m", prior)[i]), 4),
            "kb": round(float(found.of(arm, world, "kb", prior)[i]), 4),
            "requests": int(found.of(arm, world, "requests", prior)[i]),
        }
        for prior in PRIORS
        for world in WORLDS
        for arm in ARMS
        for i, seed in enumerate(found.seeds)
    ]


def facts(found: AdaptationStudy) -> dict[str, Any]:
    """What the provenance says of prices and of the adaptation's numbers."""
    return {
        "prices": {
            prior: {"lambda_b_m_per_s": round(bandwidth, 3), "lambda_d_m_per_s": round(delay, 3)}
            for prior, (bandwidth, delay) in found.prices.items()
        },
        "prior_weight_and_keep": {adapt: list(numbers) for adapt, numbers in WEIGHTS.items()},
        "probe_every": PROBE_EVERY,
        "slots": len(found.context),
        "changed_from_slot": found.slot,
        "budget_kb": round(found.budget_kb, 2),
        "noise": dict(NOISE),
    }


def caption(found: AdaptationStudy) -> str:
    """What the reader of the figure needs to know."""
    weight, keep = WEIGHTS["reported"]
    change_min = found.slot * SLOT_S / 60.0
    lambda_b, lambda_d = found.prices[CALIBRATED]
    return (
        f"VOI-Control on {len(found.seeds)} held-out seeds along the held-out routes, "
        f"{len(found.context) * SLOT_S / 60.0:.0f} min; after {change_min:.0f} min the edge answers otherwise than on "
        "training routes. (a) to (d) Route error, running mean of two minutes, with 95 % intervals: of robots that "
        "expect of an action what training routes showed, of robots that correct this while they drive, and of robots "
        "that are told what is true before and after the change. (e) What each takes off the route error of the "
        "first, paired over seeds; purple corrects from innovations instead of reported risks. (f) Payload; prices "
        f"({lambda_b:.1f} and {lambda_d:.1f} m/s) are the same for all, searched on training routes and tuning seeds "
        f"for {SPENT:.0%} of the budget, without changes. (g), (h) What robots expect of front-only compact requests, "
        "and of the richest, in the most frequent context. The prior is the mean calibrated risk by context and "
        "action; it is multiplied by the discounted mean ratio of the risks that come with answers to it (prior worth "
        f"{weight:g} answers, a factor of {keep:g} per answer), and every {PROBE_EVERY}th request is a probe. Front as "
        "five: front-only answers are those of the richest action on the same frame. Not repetitive: frames of "
        "repetitive blocks are answered as corridor frames. Degraded, failing: features have noise of "
        f"{NOISE['degraded']:g} and {NOISE['failing']:g} of their length, one draw of it; references and calibration "
        "are as before. The paper's median as the prior is in the table and the claims."
    )

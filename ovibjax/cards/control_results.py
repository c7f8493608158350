"""What several cards read off the request-control study: one typical replay, a table, reductions by VOI-Control."""

from typing import Any

import jax
import numpy as np

from ovibjax.cards.control_study import PAPER, ControlStudy, Point, control_study, drives_of
from ovibjax.cards.job import Job
from ovibjax.control.policies import POLICIES
from ovibjax.control.route_replay import RouteResult
from ovibjax.report.claims import Interval, interval
from ovibjax.runtime.progress import console, progress_bar

PAIRED = "whole 95 % interval of the paired difference above zero"
"""How the cards of request control word the rule of a paired comparison."""


def study(job: Job) -> ControlStudy:
    """The request-control study of a job's preset, data and seeds.

    Args:
        job: what the card was given.

    Returns:
        The study; computed once per process.
    """
    with job.stage("render"), progress_bar("rendering the routes", 1) as update:
        drives, training = drives_of(job.preset, job.own_drive, update)
    with console.status("searching prices, replaying held-out seeds"):
        return control_study(job.preset, job.seed, drives, training, job.stage)


def representative(found: ControlStudy, point: Point = PAPER) -> int:
    """Position of the held-out seed whose VOI-Control error is the median one at a setting."""
    mean = found.of("voi", "mean_m", point)
    return int(np.argsort(mean)[len(mean) // 2])


def representative_replay(found: ControlStudy) -> RouteResult:
    """VOI-Control's replay of the representative seed, fields [T]."""
    seed = representative(found)
    return jax.tree.map(lambda field: field[seed], found.runs["voi"])


def reductions(
    found: ControlStudy, metric: str, rival: str, point: Point = PAPER, policy: str = "voi"
) -> tuple[Interval, Interval]:
    """What VOI-Control, or another policy, takes off a rival's error, on paired held-out seeds.

    Args:
        found: the study.
        metric: `mean_m` or `p95_m`.
        rival: another policy.
        point: the setting.
        policy: the policy.

    Returns:
        Paired difference rival minus policy in metres, and relative to the rival's mean in per cent.
    """
    other = found.of(rival, metric, point)
    difference = other - found.of(policy, metric, point)
    return interval(difference), interval(100.0 * difference / other.mean())


def policy_rows(found: ControlStudy) -> list[dict[str, Any]]:
    """One row per policy and held-out seed: errors, requests, payload."""
    return [
        {
            "policy": policy,
            "seed": seed,
            "mean_m": float(found.of(policy, "mean_m")[i]),
            "p95_m": float(found.of(policy, "p95_m")[i]),
            "requests": int(found.of(policy, "requests")[i]),
            "kb": float(found.of(policy, "kb")[i]),
        }
        for policy in POLICIES
        for i, seed in enumerate(found.seeds)
    ]

"""What the figures of request control share: the study with its progress, names and colours of policies."""

from typing import Any

import numpy as np

from ovibjax.cards.control_study import ControlStudy, control_study, drives_of
from ovibjax.cards.job import Job
from ovibjax.control.policies import POLICIES
from ovibjax.report import figures as fig
from ovibjax.runtime.progress import console, progress_bar

NAMES = {
    "oracle_action": "Oracle action",
    "voi": "VOI-Control",
    "uncertainty": "Uncertainty",
    "budgeted_periodic": "Budgeted periodic",
    "periodic": "Periodic",
    "fixed_front": "Fixed-front",
    "random": "Random",
}
"""Policies as the paper writes them."""

COLOURS = {
    "voi": fig.BLUE,
    "oracle_action": fig.GREY,
    "uncertainty": fig.GREEN,
    "budgeted_periodic": fig.ORANGE,
    "periodic": fig.YELLOW,
    "fixed_front": fig.PURPLE,
    "random": fig.RED,
}

MODE_COLOURS = {"F": fig.PURPLE, "FS": fig.BLUE, "H4": fig.GREEN, "A5": fig.ORANGE}


def study(job: Job) -> ControlStudy:
    """The request-control study of a job's preset, data and seeds.

    Args:
        job: what the card was given.

    Returns:
        The study; computed once per process.
    """
    with progress_bar("rendering the routes", 1) as update:
        drives, training = drives_of(job.preset, job.own_features, update)
    with console.status("searching prices, replaying held-out seeds"):
        return control_study(job.preset, job.seed, drives, training)


def representative(found: ControlStudy) -> int:
    """Position of the held-out seed whose VOI-Control error is the median one."""
    mean = found.of("voi", "mean_m")
    return int(np.argsort(mean)[len(mean) // 2])


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

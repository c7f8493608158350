"""What the figures of edge scheduling share: recorded requests, names and colours of policies."""

import jax
import numpy as np

from ovibjax.cards.control_drawing import representative, study
from ovibjax.cards.job import Job
from ovibjax.report import figures as fig
from ovibjax.scheduling.clients import Events
from ovibjax.scheduling.congestion import recorded_events

NAMES = {"voi_lyapunov": "VOI-Lyapunov", "base_dpp": "Base-DPP", "maxweight": "MaxWeight", "edf": "EDF", "fifo": "FIFO"}
"""Policies as the paper writes them."""

COLOURS = {
    "voi_lyapunov": fig.BLUE,
    "base_dpp": fig.ORANGE,
    "maxweight": fig.GREEN,
    "edf": fig.PURPLE,
    "fifo": fig.GREY,
}


def events_of(job: Job) -> Events:
    """VOI-Control's requests on the held-out route of the representative seed; what every client replays."""
    found = study(job)
    seed = representative(found)
    run = jax.tree.map(lambda field: field[seed], found.runs["voi"])
    drift = np.asarray(found.env.drift_m2_per_s)
    return recorded_events(run, found.routes.context[seed], drift, found.scene.actions)

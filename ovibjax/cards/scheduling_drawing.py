"""What the figures of edge scheduling share: recorded requests, names and colours of policies."""

import numpy as np

from ovibjax.cards.control_results import representative, representative_replay, study
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
    context = found.routes.context[representative(found)]
    drift = np.asarray(found.env.drift_m2_per_s)
    return recorded_events(representative_replay(found), context, drift, found.scene.actions)

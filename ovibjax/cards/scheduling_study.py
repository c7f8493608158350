"""What the cards of edge scheduling share: recorded requests, the paper's congestion, values of V, metrics by scope."""

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.cards.control_results import representative, study
from ovibjax.cards.control_study import FUSED
from ovibjax.cards.job import Job
from ovibjax.scheduling.clients import PHASE_SPREAD_S
from ovibjax.scheduling.congestion import LEVELS, Case
from ovibjax.scheduling.events import Events, recorded_runs
from ovibjax.scheduling.replay_metrics import GroupMetrics, ReplayMetrics

VS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
"""Values of V that Base-DPP is run with."""

PAPER_V = VS.index(8.0)
"""Position of the paper's V among them."""

PAPER_TIES = "client"
"""How equal priorities are served where the paper's table is compared with. The paper does not say how. Its MaxWeight
has 2.3 times the edge p95 of FIFO over all requests; with one request a client waiting every backlog is one, and under
ties by arrival MaxWeight would be FIFO. The figure of congestion shows all three ways."""

SENT = FUSED
"""The control replays whose requests are scheduled: corrections are fused by their calibrated risk. Where they replace
the estimate, an answer that is not found leaves a client as it was, and it asks again at once: on tuning seeds three of
nine requests of a route come in the slot after another (fused: one or two), and the requests of thirty clients in two
successive slots are more than the server can do."""

SCOPES = ("top10", "all")
"""Requests that are judged: the tenth with the largest scheduling value, and all."""

PAIRED = "paired 95 % interval above zero"
"""How the cards of scheduling word the rule of a paired comparison."""


def events_of(job: Job) -> Events:
    """VOI-Control's requests, [replays, E].

    The representative seed's on the route of protocol `paper` come first: they give the times. A client's own are
    replays of the held-out routes in turn, with seeds of their own; where there is but one route, of that.
    """
    found = study(job)
    rates, actions, first = np.asarray(found.env.drift.rate_m_per_s), found.scene.actions, representative(found, SENT)
    routes, runs, context = found.scene.held_out, found.histories("voi", SENT), found.route.context
    if len(routes) < 2:
        return recorded_runs(runs, context, rates, actions, first)
    own = found.histories("voi", SENT._replace(protocol="transfer"))
    both = jax.tree.map(lambda a, b: np.concatenate([a[first : first + 1], b]), runs, own)
    slots = both.sent.shape[1]
    each = [context, *(routes[seed % len(routes)].context for seed in range(len(own.sent)))]
    return recorded_runs(both, np.stack([of_route[:slots] for of_route in each]), rates, actions)


def paper_cases(*levels: str) -> Case:
    """The paper's congestion, one case per name of `LEVELS`."""
    clients, rates = zip(*(LEVELS[level] for level in levels), strict=True)
    return Case(jnp.array(clients), jnp.array(rates, jnp.float32), jnp.full(len(clients), PHASE_SPREAD_S, jnp.float32))


def metric_of(found: ReplayMetrics, scope: str, metric: str) -> np.ndarray:
    """One metric of a group of requests.

    Args:
        found: metrics on the host.
        scope: one of `SCOPES`.
        metric: a field of `GroupMetrics`.

    Returns:
        [cases, seeds, settings of the rule].
    """
    group = found.top if scope == "top10" else found.every
    return np.asarray(getattr(group, metric), np.float64)


def metric_columns(found: ReplayMetrics, scope: str, at: tuple[int, int, int]) -> dict[str, float]:
    """Every metric of a group of requests at one place (case, seed, setting), as columns of a table."""
    return {metric: float(metric_of(found, scope, metric)[at]) for metric in GroupMetrics._fields}

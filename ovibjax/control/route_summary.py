"""One replay in numbers: mean and tail of the route error, requests, payload.

`summarize` reads them off a history; `score` sums them up slot by slot, which is what a search over thousands of
controllers has room for.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.control.actions import ACTIONS, ActionSet
from ovibjax.control.client_state import ControlParams
from ovibjax.control.environment import Draws, Route
from ovibjax.control.planning import FOLLOW_VOI, plan
from ovibjax.control.replay_sums import replay_sums
from ovibjax.control.route_replay import RouteResult


class Summary(NamedTuple):
    """One replay in numbers.

    Attributes:
        mean_m: mean route error.
        p95_m: 95th percentile of the route error.
        risk_m: mean local risk.
        requests: int32 number of requests.
        kb: payload, KB of 1,024 bytes.
    """

    mean_m: jax.Array
    p95_m: jax.Array
    risk_m: jax.Array
    requests: jax.Array
    kb: jax.Array


def summarize(result: RouteResult) -> Summary:
    """Mean and tail of the route error, requests and payload of a replay."""
    return Summary(
        mean_m=jnp.mean(result.error_m, axis=-1),
        p95_m=jnp.percentile(result.error_m, 95.0, axis=-1),
        risk_m=jnp.mean(result.risk_m, axis=-1),
        requests=jnp.sum(result.sent.astype(jnp.int32), axis=-1),
        kb=jnp.sum(result.payload_bytes, axis=-1) / 1024.0,
    )


def score(draws: Draws, route: Route, policy: str, params: ControlParams, actions: ActionSet = ACTIONS) -> Summary:
    """`summarize(simulate(...))` with sums instead of histories, for large searches; the tail is not computed.

    Args:
        draws: the realization.
        route: the route.
        policy: a key of `POLICIES` (static). Those in `FOLLOW_VOI` replay VOI-Control first.
        params: environment and controller.
        actions: the action set (static).

    Returns:
        The summary, with `p95_m` NaN.
    """
    slots = draws.rate_bps.shape[0]
    sent = jnp.zeros(slots, bool)
    if policy in FOLLOW_VOI:
        sent = replay_sums(draws, route, "voi", sent, params, actions).action >= 0
    found = replay_sums(draws, route, policy, plan(draws, policy, params, sent), params, actions)
    tail = jnp.full_like(found.error_m, jnp.nan)
    return Summary(found.error_m / slots, tail, found.risk_m / slots, found.requests, found.sent_bytes / 1024.0)

"""One replay in numbers: mean and tail of the route error, requests, payload.

`summarize` reads them off a history; `score` sums them up slot by slot, which is what a search over thousands of
controllers has room for.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.control.actions import ACTIONS, ActionSet
from ovibjax.control.client_state import ControlParams, Slot, by_action, start
from ovibjax.control.client_step import step
from ovibjax.control.environment import Draws, Route
from ovibjax.control.planning import plan
from ovibjax.control.route_replay import RouteResult, slots_of


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
        policy: a key of `POLICIES` that does not follow VOI-Control (static).
        params: environment and controller.
        actions: the action set (static).

    Returns:
        The summary, with `p95_m` NaN.
    """
    n = draws.rate_bps.shape[0]
    planned = plan(draws, policy, params, jnp.zeros(n, bool))
    params = by_action(params)
    zero = jnp.zeros_like(draws.rate_bps[0])

    def one(carry: Any, slot: Slot) -> tuple[Any, None]:
        state, error, risk, requests = carry
        state, info = step(state, slot, policy, params, actions)
        return (state, error + info.error_m, risk + info.risk_m, requests + info.sent.astype(jnp.int32)), None

    begin = (start(draws), zero, zero, jnp.int32(0))
    (state, error, risk, requests), _ = jax.lax.scan(one, begin, slots_of(route, draws, planned))
    return Summary(error / n, jnp.full_like(error, jnp.nan), risk / n, requests, state.sent_bytes / 1024.0)

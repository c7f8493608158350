"""What happens in each slot whatever the client does: delay, loss, arrival and correction of every action.

A seed fixes all of it, so that a search over controllers computes it once for all of them, before the replay.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.control.actions import ActionSet
from ovibjax.control.environment import Draws, Environment, Route
from ovibjax.control.isotropic_belief import Isotropic, added, after_fix
from ovibjax.link.latency import transmit_s

_LONGEST = 1 << 20
"""Slots in which no answer arrives on any route; where nothing is ever given up, a dead link takes for ever."""


class SlotTable(NamedTuple):
    """Slots of one realization; fields [T], those of actions [T, A].

    Attributes:
        number: the slot, from zero.
        scheduled: bool, whether a policy has planned it ahead.
        rate_bps: uplink rate.
        transmit_s: [T, A] time that a request takes to be sent.
        predicted_m: [T, A] predicted residual.
        realised_m: [T, A] realised residual.
        delay_s: [T, A] predicted queueing, service and return delay.
        trip: [T, A] int32, twice the slots until the answer arrives or is known to be lost; one more where it arrives.
        fix_risk_m: [T, A] risk of the position that comes back.
        fixed: [T, A] the belief that it makes.
        drifted: what odometry adds to a belief.
    """

    number: jax.Array
    scheduled: jax.Array
    rate_bps: jax.Array
    transmit_s: jax.Array
    predicted_m: jax.Array
    realised_m: jax.Array
    delay_s: jax.Array
    trip: jax.Array
    fix_risk_m: jax.Array
    fixed: Isotropic
    drifted: Isotropic


def tabulate(draws: Draws, route: Route, planned: jax.Array, env: Environment, actions: ActionSet) -> SlotTable:
    """The slots of a realization.

    Args:
        draws: the realization.
        route: the route.
        planned: [T] bool, see `planning.planned_slots`.
        env: numbers of the world.
        actions: the action set (static).

    Returns:
        The table.
    """
    link_s = transmit_s(jnp.asarray(actions.payload_bytes, jnp.float32)[None], draws.rate_bps[:, None])
    latency_s = link_s + draws.latency_s
    flight = jnp.minimum(jnp.floor(jnp.minimum(latency_s, env.timeout_s) / env.slot_s), _LONGEST).astype(jnp.int32)
    residual_x_m, residual_y_m = route.residual_m[..., 0], route.residual_m[..., 1]
    by_action = jax.tree.map(lambda leaf: leaf[:, None], draws.odometry)
    return SlotTable(
        number=jnp.arange(draws.rate_bps.shape[0]),
        scheduled=planned,
        rate_bps=draws.rate_bps,
        transmit_s=link_s,
        predicted_m=jnp.asarray(route.predicted_m),
        realised_m=jnp.sqrt(residual_x_m**2 + residual_y_m**2),
        delay_s=draws.delay_s,
        trip=2 * flight + (latency_s <= env.timeout_s).astype(jnp.int32),
        fix_risk_m=jnp.asarray(route.risk_m),
        fixed=after_fix(jnp.asarray(route.risk_m), residual_x_m, residual_y_m, env.drift, by_action),
        drifted=added(draws.odometry, env.drift),
    )

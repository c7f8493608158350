"""Route replay: any request policy along a route, slot by slot, as one fixed-length scan of `client_step.step`.

`replay` takes a seed's key and draws channel, drift and queue itself; `simulate` takes the draws, so that one
realization can be shared or replaced, for instance by a measured link.
"""

from functools import partial

import jax
import jax.numpy as jnp

from ovibjax.control.actions import ACTIONS, ActionSet
from ovibjax.control.adaptive_replay import scan_adapted
from ovibjax.control.client_state import ControlParams, Slot, SlotInfo, by_action, start
from ovibjax.control.client_step import step
from ovibjax.control.environment import Draws, Route, draw
from ovibjax.control.planning import FOLLOW_VOI, plan
from ovibjax.control.policies import Policy

RouteResult = SlotInfo
"""What happened along a route: fields [T]."""


def slots_of(route: Route, draws: Draws, scheduled: jax.Array) -> Slot:
    """[T] slots, as the scan takes them."""
    return Slot(
        jnp.arange(scheduled.shape[0]),
        jnp.asarray(route.predicted_m),
        jnp.asarray(route.residual_m),
        jnp.asarray(route.risk_m),
        draws.odometry,
        draws.rate_bps,
        draws.delay_s,
        draws.latency_s,
        scheduled,
    )


def replay_schedule(
    draws: Draws,
    route: Route,
    policy: str | Policy,
    planned: jax.Array,
    params: ControlParams,
    actions: ActionSet = ACTIONS,
    adapt: str = "none",
) -> RouteResult:
    """Replay a policy on a given realization of the world, with the slots that it has planned ahead.

    Args:
        draws: the realization.
        route: the route.
        policy: a key of `POLICIES`, or a function as they are (static).
        planned: [T] bool, see `planning.planned_slots`.
        params: environment and controller.
        actions: the action set (static).
        adapt: what corrects g_psi while driving, one of `adaptation.ADAPT` (static); `params.adaptation` has its
            numbers.

    Returns:
        [T] of everything that happened.
    """
    if adapt != "none":
        return scan_adapted(draws, slots_of(route, draws, planned), route.context, policy, params, actions, adapt)[0]
    slots, params = slots_of(route, draws, planned), by_action(params)
    return jax.lax.scan(lambda state, slot: step(state, slot, policy, params, actions), start(draws), slots)[1]


def simulate(
    draws: Draws,
    route: Route,
    policy: str,
    params: ControlParams,
    actions: ActionSet = ACTIONS,
    adapt: str = "none",
) -> RouteResult:
    """Replay a policy on a given realization of the world.

    Args:
        draws: the realization.
        route: the route.
        policy: a key of `POLICIES` (static). Those in `FOLLOW_VOI` replay VOI-Control first.
        params: environment and controller.
        actions: the action set (static).
        adapt: see `replay_schedule` (static).

    Returns:
        [T] of everything that happened.
    """
    sent = jnp.zeros(draws.rate_bps.shape, bool)
    if policy in FOLLOW_VOI:
        sent = replay_schedule(draws, route, "voi", sent, params, actions).sent
    return replay_schedule(draws, route, policy, plan(draws, policy, params, sent), params, actions, adapt)


replay_draws = jax.jit(simulate, static_argnames=("policy", "actions", "adapt"))
"""`simulate`, compiled once per policy and length of route."""


@partial(jax.jit, static_argnames=("policy", "actions", "adapt"))
def replay(
    key: jax.Array,
    route: Route,
    policy: str,
    params: ControlParams,
    actions: ActionSet = ACTIONS,
    adapt: str = "none",
) -> RouteResult:
    """Replay a request policy along a route with one seed's draws of the world.

    Compiled once per policy and length of route.

    Args:
        key: the seed's key; policies that share it see the same channel, drift and queue.
        route: the route.
        policy: a key of `POLICIES` (static).
        params: environment and controller.
        actions: the action set (static).
        adapt: see `replay_schedule` (static).

    Returns:
        [T] of everything that happened.
    """
    return simulate(draw(key, route, params.env, actions), route, policy, params, actions, adapt)

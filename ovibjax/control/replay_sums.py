"""Sums over a replay instead of its history: by `slot_scan` where that applies, slot by slot of `client_step` else."""

from typing import Any

import jax
import jax.numpy as jnp

from ovibjax.control.actions import ActionSet
from ovibjax.control.belief import CORRECTIONS
from ovibjax.control.client_state import ControlParams, Slot, by_action, start
from ovibjax.control.client_step import step
from ovibjax.control.environment import Draws, Route
from ovibjax.control.route_replay import slots_of
from ovibjax.control.slot_scan import Sums, scan_slots
from ovibjax.control.slot_table import tabulate
from ovibjax.runtime.every_lane import every_lane


def replaces(params: ControlParams) -> jax.Array:
    """Whether corrections replace the estimate or are dropped by their risk alone, and drift is one of the models."""
    control, drift = params.control, params.env.drift
    plain = (control.correction != CORRECTIONS.index("kalman")) & (control.gate_sigma == jnp.inf)
    return plain & (jnp.asarray(drift.walks) == (drift.power < 0.75))


def replay_sums(
    draws: Draws, route: Route, policy: str, planned: jax.Array, params: ControlParams, actions: ActionSet
) -> Sums:
    """Replay a policy on a given realization of the world, with the slots that it has planned ahead.

    Both programs are compiled; that which is right for all lanes of a mapped caller runs.

    Args:
        draws: the realization.
        route: the route.
        policy: a key of `POLICIES` (static).
        planned: [T] bool, see `planning.planned_slots`.
        params: environment and controller.
        actions: the action set (static).

    Returns:
        Sums over the slots.
    """

    def fast(draws: Draws, route: Route, planned: jax.Array, params: ControlParams) -> Sums:
        return sums_by_slots(draws, route, policy, planned, params, actions)

    def general(draws: Draws, route: Route, planned: jax.Array, params: ControlParams) -> Sums:
        return sums_by_steps(draws, route, policy, planned, params, actions)

    return jax.lax.cond(every_lane(replaces(params)), fast, general, draws, route, planned, params)


def sums_by_slots(
    draws: Draws, route: Route, policy: str, planned: jax.Array, params: ControlParams, actions: ActionSet
) -> Sums:
    """`replay_sums` where `replaces` holds."""
    table = tabulate(draws, route, planned, params.env, actions)
    return scan_slots(draws.start, table, policy, params, actions)


def sums_by_steps(
    draws: Draws, route: Route, policy: str, planned: jax.Array, params: ControlParams, actions: ActionSet
) -> Sums:
    """`replay_sums` by the steps that make histories, for any correction."""
    params = by_action(params)
    zero = jnp.zeros_like(draws.rate_bps[0])

    def one(carry: Any, slot: Slot) -> tuple[Any, jax.Array]:
        state, error, risk, requests = carry
        state, info = step(state, slot, policy, params, actions)
        sums = error + info.error_m, risk + info.risk_m, requests + info.sent.astype(jnp.int32)
        return (state, *sums), jnp.where(info.sent, info.action, -1).astype(jnp.int8)

    begin = (start(draws), zero, zero, jnp.int32(0))
    (state, error, risk, requests), action = jax.lax.scan(one, begin, slots_of(route, draws, planned))
    return Sums(error, risk, requests, state.sent_bytes, action)

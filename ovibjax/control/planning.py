"""Slots in which a request policy has planned to ask (paper, Section "View-Rate Selection").

Periodic knows its evenly spaced slots from the start. Budgeted periodic, Random and Oracle action take the number of
VOI-Control's requests, or their slots, from its replay on the same seed.
"""

import jax
import jax.numpy as jnp

from ovibjax.control.client_state import ControlParams
from ovibjax.control.controller import Controller
from ovibjax.control.environment import Draws

FOLLOW_VOI = ("budgeted_periodic", "random", "oracle_action")
"""Policies whose number of requests, or their slots, are VOI-Control's."""


def planned_slots(
    policy: str, slot_s: jax.Array, rank: jax.Array, phase: jax.Array, control: Controller, voi_sent: jax.Array
) -> jax.Array:
    """Slots that a policy has planned ahead.

    Args:
        policy: its name (static).
        slot_s: length of a slot.
        rank: [T] a random permutation.
        phase: offset of Periodic as a share of its period.
        control: numbers of the rules.
        voi_sent: [T] bool, slots in which VOI-Control asked on the same seed.

    Returns:
        [T] bool.
    """
    slots = voi_sent.shape[0]
    slot = jnp.arange(slots)
    count = jnp.sum(voi_sent.astype(jnp.int32))
    if policy == "periodic":
        period = jnp.maximum(jnp.round(control.rules.period_s / slot_s).astype(jnp.int32), 1)
        return (slot + jnp.floor(phase * period.astype(jnp.float32)).astype(jnp.int32)) % period == period - 1
    if policy == "budgeted_periodic":
        # Slots at which the running share of the count passes a half: evenly spaced, exactly `count` of them.
        return ((slot + 1) * count + slots // 2) // slots > (slot * count + slots // 2) // slots
    if policy == "random":
        return rank < count
    if policy == "oracle_action":
        return voi_sent
    return jnp.zeros(slots, bool)


def plan(draws: Draws, policy: str, params: ControlParams, voi_sent: jax.Array) -> jax.Array:
    """[T] bool, slots that a policy has planned ahead, given those in which VOI-Control asked."""
    return planned_slots(policy, params.env.slot_s, draws.rank, draws.phase_s, params.control, voi_sent)

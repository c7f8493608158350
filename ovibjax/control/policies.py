"""When to ask and how: six causal request policies and one that knows the residuals (paper, "View-Rate Selection").

Each policy is a pure function of what the client sees in one slot, with one signature. What is planned ahead (evenly
spaced slots, random slots, another policy's slots) comes in as `scheduled`. Actions are unrolled: a handful of them,
element-wise over whatever the caller maps, is faster than an axis of length eight.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.control.actions import ActionSet
from ovibjax.control.voi import Prices, net_voi


class Rules(NamedTuple):
    """Numbers of the fixed rules; leaves.

    Attributes:
        period_s: Periodic asks this often.
        fixed_front_risk_m: Fixed-front asks above this risk ...
        fixed_front_gap_s: ... and not sooner after the last request.
        uncertainty_risk_m: Uncertainty asks above this risk ...
        uncertainty_gap_s: ... and not sooner after the last request.
    """

    period_s: Any
    fixed_front_risk_m: Any
    fixed_front_gap_s: Any
    uncertainty_risk_m: Any
    uncertainty_gap_s: Any


class Controller(NamedTuple):
    """Numbers of the controller; leaves.

    Attributes:
        prices: lambda_b, lambda_e, lambda_d.
        threshold_m: VOI-Control asks only if the net VOI exceeds this.
        min_gap_s: shortest time between two requests of VOI-Control.
        budget_bytes: payload allowed over the route.
        energy_j: [A] endpoint energy E(a) of each action.
        energy_budget_j: energy allowed over the route.
        available: [A] bool, actions that may be chosen.
        gate_sigma: innovation gate of corrections, see `belief.correct`.
        rules: numbers of the other policies.
    """

    prices: Prices
    threshold_m: Any
    min_gap_s: Any
    budget_bytes: Any
    energy_j: Any
    energy_budget_j: Any
    available: Any
    gate_sigma: Any
    rules: Rules


PAPER_BUDGET_KB = 2.1


def make_controller(
    actions: ActionSet,
    bandwidth_m_per_s: float = 117.0,
    delay_m_per_s: float = 29.0,
    threshold_m: float = 0.27,
    min_gap_s: float = 9.5,
    budget_kb: float = PAPER_BUDGET_KB,
) -> Controller:
    """A controller with the paper's rules, no price on energy, and every action available.

    The default prices, threshold and gap are those that the tuning seeds of the full preset selected.

    Args:
        actions: the action set.
        bandwidth_m_per_s: lambda_b.
        delay_m_per_s: lambda_d.
        threshold_m: net VOI above which VOI-Control asks.
        min_gap_s: shortest time between its requests.
        budget_kb: payload per route, KB of 1,024 bytes.

    Returns:
        Float32 leaves.
    """
    number = jnp.float32
    return Controller(
        prices=Prices(number(bandwidth_m_per_s), number(0.0), number(delay_m_per_s)),
        threshold_m=number(threshold_m),
        min_gap_s=number(min_gap_s),
        budget_bytes=number(budget_kb * 1024.0),
        energy_j=jnp.zeros(len(actions), jnp.float32),
        energy_budget_j=number(jnp.inf),
        available=jnp.ones(len(actions), bool),
        gate_sigma=number(3.0),
        rules=Rules(number(16.0), number(8.0), number(1.0), number(6.0), number(6.0)),
    )


class Observation(NamedTuple):
    """What a client sees in one slot.

    Attributes:
        risk_m: local risk.
        predicted_m: [A] predicted residuals.
        realised_m: [A] realised residuals; for the oracle alone.
        rate_bps: uplink rate.
        delay_s: [A] predicted queueing, service and return delay.
        since_s: time since the last request; days before the first.
        waiting: whether a correction is still under way.
        scheduled: whether this slot was planned ahead.
        allowed: per action, whether it is available and fits the budgets.
    """

    risk_m: jax.Array
    predicted_m: jax.Array
    realised_m: jax.Array
    rate_bps: jax.Array
    delay_s: jax.Array
    since_s: jax.Array
    waiting: jax.Array
    scheduled: jax.Array
    allowed: tuple[jax.Array, ...]


class Decision(NamedTuple):
    """What a client does in one slot.

    Attributes:
        send: whether it asks.
        action: int32, with which action.
    """

    send: jax.Array
    action: jax.Array


Policy = Callable[[Observation, Controller, ActionSet], Decision]


def net_values(seen: Observation, control: Controller, actions: ActionSet) -> list[jax.Array]:
    """Net VOI of each action by its predicted residual."""
    return [
        net_voi(
            seen.risk_m,
            seen.predicted_m[a],
            jnp.float32(size),
            seen.rate_bps,
            seen.delay_s[a],
            control.energy_j[a],
            control.prices,
        )
        for a, size in enumerate(actions.payload_bytes)
    ]


def highest(values: Sequence[jax.Array], allowed: Sequence[jax.Array]) -> tuple[jax.Array, jax.Array]:
    """First action with the highest value among those allowed, and that value; minus infinity if there is none."""
    best = jnp.where(allowed[0], values[0], -jnp.inf)
    index = jnp.zeros(best.shape, jnp.int32)
    for a in range(1, len(values)):
        value = jnp.where(allowed[a], values[a], -jnp.inf)
        better = value > best
        best, index = jnp.where(better, value, best), jnp.where(better, jnp.int32(a), index)
    return index, best


def chosen(values: Sequence[Any], action: jax.Array) -> jax.Array:
    """The entry of a per-action list at a traced action, by selection instead of a gather."""
    value = jnp.asarray(values[0])
    for a in range(1, len(values)):
        value = jnp.where(action == a, values[a], value)
    return value


def voi(seen: Observation, control: Controller, actions: ActionSet) -> Decision:
    """VOI-Control: the action with the highest net VOI, if that is positive and above the threshold (eq. "action")."""
    action, value = highest(net_values(seen, control, actions), seen.allowed)
    # Twice the slack of float32 time, so that a gap of n slots is reached after n slots.
    rested = seen.since_s >= control.min_gap_s - 1e-3
    return Decision((value > jnp.maximum(control.threshold_m, 0.0)) & rested & ~seen.waiting, action)


def scheduled_fs(seen: Observation, control: Controller, actions: ActionSet) -> Decision:
    """Front-plus-sides compact at the slots planned ahead: Periodic, Budgeted periodic and Random."""
    return _fixed(seen, seen.scheduled, "FS", actions)


def fixed_front(seen: Observation, control: Controller, actions: ActionSet) -> Decision:
    """Front-only compact when the risk is high."""
    rules = control.rules
    due = (seen.risk_m > rules.fixed_front_risk_m) & (seen.since_s >= rules.fixed_front_gap_s - 1e-3)
    return _fixed(seen, due & ~seen.waiting, "F", actions)


def uncertainty(seen: Observation, control: Controller, actions: ActionSet) -> Decision:
    """Front-plus-sides compact when the risk is high and the last request some time ago."""
    rules = control.rules
    due = (seen.risk_m > rules.uncertainty_risk_m) & (seen.since_s >= rules.uncertainty_gap_s - 1e-3)
    return _fixed(seen, due & ~seen.waiting, "FS", actions)


def oracle_action(seen: Observation, control: Controller, actions: ActionSet) -> Decision:
    """At VOI-Control's slots, the action with the lowest realised residual after the same penalties."""
    knowing = seen._replace(predicted_m=seen.realised_m)
    # Penalties apply in full even where the residual exceeds the risk: no positive part.
    values = [
        value - jnp.maximum(seen.realised_m[a] - seen.risk_m, 0.0)
        for a, value in enumerate(net_values(knowing, control, actions))
    ]
    action, value = highest(values, seen.allowed)
    return Decision(seen.scheduled & (value > -jnp.inf), action)


def _fixed(seen: Observation, due: jax.Array, mode: str, actions: ActionSet) -> Decision:
    """One action, always the same."""
    action = actions.index(mode, actions.prefixes[0])
    return Decision(due & seen.allowed[action], jnp.full(due.shape, action, jnp.int32))


POLICIES: dict[str, Policy] = {
    "voi": voi,
    "periodic": scheduled_fs,
    "budgeted_periodic": scheduled_fs,
    "fixed_front": fixed_front,
    "random": scheduled_fs,
    "uncertainty": uncertainty,
    "oracle_action": oracle_action,
}
"""Policies by name; the last is no causal policy but a bound."""

FOLLOW_VOI = ("budgeted_periodic", "random", "oracle_action")
"""Policies whose number of requests, or their slots, are VOI-Control's."""


def schedule(
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

"""When to ask and how: the paper's request policies and a variant of ours (paper, Section "View-Rate Selection").

Each policy is a pure function of what the client sees in one slot, with one signature. What is planned ahead (evenly
spaced slots, random slots, another policy's slots) comes in as `scheduled`, see `planning`. Actions are unrolled: a
handful of them, element-wise over whatever the caller maps, is faster than an axis of length eight.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.control.actions import ActionSet
from ovibjax.control.controller import Controller
from ovibjax.control.voi import request_cost_m


class Observation(NamedTuple):
    """What a client sees in one slot.

    Attributes:
        risk_m: local risk.
        predicted_m: [A] predicted residuals.
        realised_m: [A] realised residuals; for the oracle alone.
        rate_bps: uplink rate.
        transmit_s: [A] time that a request takes to be sent.
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
    transmit_s: jax.Array
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


def worthwhile_m(seen: Observation, residual_m: jax.Array, control: Controller, actions: ActionSet) -> list[jax.Array]:
    """Local risk above which a request with each action has a positive net VOI: its residual plus what it costs.

    The net VOI of an action with a positive gross VOI is L less this number. As no request costs less than nothing, an
    action without one never has a positive net VOI; so the action with the highest net VOI, where that is positive, is
    the one with the lowest of these numbers, which do not depend on the client.

    Args:
        seen: what the client sees.
        residual_m: [A] residuals, predicted or realised.
        control: prices and energies.
        actions: the action set (static).

    Returns:
        One array per action; infinite where nothing can be sent.
    """
    return [
        residual_m[a] + request_cost_m(seen.transmit_s[a], seen.delay_s[a], control.energy_j[a], control.prices)
        for a in range(len(actions))
    ]


def lowest(values: Sequence[jax.Array], allowed: Sequence[jax.Array]) -> tuple[jax.Array, jax.Array]:
    """First action with the lowest value among those allowed, and that value; infinity if there is none."""
    best = jnp.where(allowed[0], values[0], jnp.inf)
    index = jnp.zeros(best.shape, jnp.int32)
    for a in range(1, len(values)):
        better = allowed[a] & (values[a] < best)
        best, index = jnp.where(better, values[a], best), jnp.where(better, jnp.int32(a), index)
    return index, best


def chosen(values: Any, action: jax.Array) -> jax.Array:
    """The entry of a per-action list or array at a traced action, by selection instead of a gather.

    It goes by the bits of the action: half the work of comparing it with each.
    """
    left, place = [jnp.asarray(value) for value in values], action
    while len(left) > 1:
        odd = place & 1 == 1
        pairs, alone = zip(left[::2], left[1::2], strict=False), left[len(left) & ~1 :]
        left = [*(jnp.where(odd, second, first) for first, second in pairs), *alone]
        place = place >> 1
    return left[0]


def voi(seen: Observation, control: Controller, actions: ActionSet) -> Decision:
    """VOI-Control: the action with the highest net VOI, if that is positive (eq. "action"); one request at a time."""
    return voi_gap(seen, as_written(control), actions)


def as_written(control: Controller) -> Controller:
    """A controller without threshold and gap, with which `voi_gap` is `voi`."""
    zero = jnp.zeros_like(control.threshold_m)
    return control._replace(threshold_m=zero, min_gap_s=zero)


def voi_gap(seen: Observation, control: Controller, actions: ActionSet) -> Decision:
    """A variant of ours: a net VOI above a threshold, and not sooner than a gap after the last request."""
    action, worthwhile = lowest(worthwhile_m(seen, seen.predicted_m, control, actions), seen.allowed)
    # Twice the slack of float32 time, so that a gap of n slots is reached after n slots.
    rested = seen.since_s >= control.min_gap_s - 1e-3
    worth = seen.risk_m > worthwhile + jnp.maximum(control.threshold_m, 0.0)
    return Decision(worth & rested & ~seen.waiting, action)


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
    # Penalties apply in full even where the residual exceeds the risk: no positive part.
    action, value = lowest(worthwhile_m(seen, seen.realised_m, control, actions), seen.allowed)
    return Decision(seen.scheduled & (value < jnp.inf), action)


def _fixed(seen: Observation, due: jax.Array, mode: str, actions: ActionSet) -> Decision:
    """One action, always the same."""
    action = actions.index(mode, actions.prefixes[0])
    return Decision(due & seen.allowed[action], jnp.full(due.shape, action, jnp.int32))


POLICIES: dict[str, Policy] = {
    "voi": voi,
    "voi_gap": voi_gap,
    "periodic": scheduled_fs,
    "budgeted_periodic": scheduled_fs,
    "fixed_front": fixed_front,
    "random": scheduled_fs,
    "uncertainty": uncertainty,
    "oracle_action": oracle_action,
}
"""Policies by name; the last is no causal policy but a bound."""

FIXED_ACTION = ("periodic", "budgeted_periodic", "fixed_front", "random", "uncertainty")
"""Those that do not choose among actions."""

VARIANTS = ("voi_gap",)
"""Those that are ours and not the paper's."""

"""One client in one slot: drift, correction, decision, request.

Odometry drifts; a correction that has arrived takes effect; the client decides; a correction that returns within the
slot is used in that slot, a later one from the slot it arrives in. A newer request supersedes one that is under way.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.control import belief
from ovibjax.control.actions import ActionSet
from ovibjax.control.belief import Belief, Fix
from ovibjax.control.client_state import ControlParams, Slot, SlotInfo, State
from ovibjax.control.controller import Controller
from ovibjax.control.policies import POLICIES, Decision, Observation, Policy, chosen
from ovibjax.control.voi import net_voi
from ovibjax.link.latency import transmit_s
from ovibjax.runtime.computed_once import computed_once


class Request(NamedTuple):
    """A request with one action, and the correction that it would bring.

    Attributes:
        payload_bytes: its size b(a).
        latency_s: time from decision to correction.
        fix: the position that the edge would send back.
        delay_s: predicted queueing, service and return delay.
        energy_j: energy it costs.
        residual_m: realised error of that position.
        voi_m: predicted net VOI.
    """

    payload_bytes: jax.Array
    latency_s: jax.Array
    fix: Fix
    delay_s: jax.Array
    energy_j: jax.Array
    residual_m: jax.Array
    voi_m: jax.Array


def step(
    state: State, slot: Slot, policy: str | Policy, params: ControlParams, actions: ActionSet
) -> tuple[State, SlotInfo]:
    """One slot of one client under a policy, a key of `POLICIES` or a function; it and `actions` are static."""
    state, seen = observe(state, slot, params, actions, budgeted=policy != "oracle_action")
    decision = decide(seen, slot, policy, params, actions)
    return respond(state, slot, seen, decision, params, actions)


def observe(
    state: State, slot: Slot, params: ControlParams, actions: ActionSet, budgeted: bool
) -> tuple[State, Observation]:
    """Odometry drifts, a correction that is due takes effect, and the client looks around.

    Args:
        state: the client.
        slot: what the world brings.
        params: environment and controller.
        actions: the action set (static).
        budgeted: whether the payload budget binds (static).

    Returns:
        The client after drift and correction, and what it sees.
    """
    now = belief.propagate(state.belief, slot.odometry, params.env.drift)
    pending = belief.propagate(state.pending, slot.odometry, params.env.drift)
    state = state._replace(
        belief=belief.select(state.flight == 1, pending, now),
        pending=pending,
        flight=jnp.maximum(state.flight - 1, 0),
        since=state.since + 1,
    )
    seen = Observation(
        risk_m=belief.local_risk_m(state.belief),
        predicted_m=slot.predicted_m,
        realised_m=jnp.sqrt(jnp.sum(slot.residual_m**2, axis=-1)),
        rate_bps=slot.rate_bps,
        transmit_s=transmit_s(jnp.asarray(actions.payload_bytes, jnp.float32), slot.rate_bps),
        delay_s=slot.delay_s,
        since_s=state.since.astype(jnp.float32) * params.env.slot_s,
        waiting=state.flight > 0,
        scheduled=slot.scheduled,
        allowed=affordable(state.sent_bytes, state.used_j, params.control, actions, budgeted),
    )
    return state, seen


def affordable(
    sent_bytes: jax.Array, used_j: jax.Array, control: Controller, actions: ActionSet, budgeted: bool
) -> tuple[jax.Array, ...]:
    """Which actions are available and fit the budgets.

    Args:
        sent_bytes: [...] payload sent so far.
        used_j: [...] energy used so far.
        control: budgets and availability.
        actions: the action set (static).
        budgeted: whether the payload budget binds (static).

    Returns:
        One bool array per action.
    """
    allowed = []
    for a, size in enumerate(actions.payload_bytes):
        fits = used_j + control.energy_j[a] <= control.energy_budget_j
        if budgeted:
            fits = fits & (sent_bytes + jnp.float32(size) <= control.budget_bytes)
        allowed.append(fits & control.available[a])
    return tuple(allowed)


def decide(seen: Observation, slot: Slot, policy: str | Policy, params: ControlParams, actions: ActionSet) -> Decision:
    """Ask a policy what to do; `policy` and `actions` are static."""
    rule = POLICIES[policy] if isinstance(policy, str) else policy

    def code(seen: Observation) -> jax.Array:
        decision = rule(seen, params.control, actions)
        return jnp.where(decision.send, decision.action, -1)

    made = computed_once(slot.number >= 0, code, seen)
    return Decision(made >= 0, jnp.maximum(made, 0))


def request_with(
    action: jax.Array, risk_m: jax.Array, slot: Slot, seen: Observation, params: ControlParams, actions: ActionSet
) -> Request:
    """The request that a client would send with an action.

    Args:
        action: int32 number of the action.
        risk_m: local risk.
        slot: what the world brings.
        seen: what the client saw.
        params: environment and controller.
        actions: the action set (static).

    Returns:
        The request.
    """
    size = chosen([jnp.float32(b) for b in actions.payload_bytes], action)
    predicted_m, delay_s, energy_j, residual_m, rest_s, fix_risk_m = (
        chosen(values, action)
        for values in (
            *(slot.predicted_m, slot.delay_s, params.control.energy_j),
            *(seen.realised_m, slot.latency_s, slot.risk_m),
        )
    )
    residual_x_m, residual_y_m = (chosen(slot.residual_m[:, axis], action) for axis in (0, 1))
    fix = Fix(residual_x_m, residual_y_m, fix_risk_m, slot.odometry.toward_x, slot.odometry.toward_y)
    value_m = net_voi(risk_m, predicted_m, size, slot.rate_bps, delay_s, energy_j, params.control.prices)
    latency_s = transmit_s(size, slot.rate_bps) + rest_s
    return Request(size, latency_s, fix, delay_s, energy_j, residual_m, value_m)


def respond(
    state: State, slot: Slot, seen: Observation, decision: Decision, params: ControlParams, actions: ActionSet
) -> tuple[State, SlotInfo]:
    """Send the request that was decided on and let its correction come back.

    Args:
        state: the client after `observe`.
        slot: what the world brings.
        seen: what the client saw.
        decision: what it decided.
        params: environment and controller.
        actions: the action set (static).

    Returns:
        The client at the end of the slot, and what happened.
    """

    def request_of(action: jax.Array, risk_m: jax.Array) -> Request:
        return request_with(action, risk_m, slot, seen, params, actions)

    def use(before: Belief, fix: Fix) -> Belief:
        return belief.correct(before, fix, params.control.correction, params.control.gate_sigma)

    send, action = decision
    running = slot.number >= 0
    request = computed_once(running, request_of, action, seen.risk_m)
    corrected = computed_once(running, use, state.belief, request.fix)
    lost = request.latency_s > params.env.timeout_s
    coming = belief.select(lost, state.belief, corrected)
    flight = jnp.floor(jnp.minimum(request.latency_s, params.env.timeout_s) / params.env.slot_s).astype(jnp.int32)
    now = belief.select(send & (flight == 0), coming, state.belief)
    paid = jnp.where(send, request.payload_bytes, 0.0)
    after = State(
        belief=now,
        pending=belief.select(send, coming, state.pending),
        flight=jnp.where(send, flight, state.flight),
        since=jnp.where(send, 0, state.since),
        sent_bytes=state.sent_bytes + paid,
        used_j=state.used_j + jnp.where(send, request.energy_j, 0.0),
    )
    info = SlotInfo(
        error_m=belief.error_m(now),
        risk_before_m=seen.risk_m,
        risk_m=belief.local_risk_m(now),
        sent=send,
        action=action,
        payload_bytes=paid,
        voi_m=request.voi_m,
        delay_s=request.delay_s,
        latency_s=request.latency_s,
        residual_m=request.residual_m,
        rate_bps=slot.rate_bps,
    )
    return after, info

"""Sums over a replay by a scan that carries little and computes nothing that `slot_table` knows.

Decisions are those of `client_step.step`, whose policies it asks, where a correction replaces the estimate or is
dropped: not for `kalman`, nor behind an innovation gate. It is made for thousands of lanes: whatever ends in an array
is a loop over all of them, so that there are few, and one decision serves them all.

A request under way is a second belief, which drifts with the first and takes its place from the slot `lands` on. Then
the two are equal until the next request; a correction that is lost or dropped never lands.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.control.actions import ActionSet
from ovibjax.control.belief import CORRECTIONS, Belief
from ovibjax.control.client_state import ControlParams, by_action
from ovibjax.control.client_step import affordable
from ovibjax.control.controller import Controller
from ovibjax.control.drift import Drift
from ovibjax.control.isotropic_belief import Isotropic, error_m, isotropic, risk_m
from ovibjax.control.policies import FIXED_ACTION, POLICIES, Observation, chosen
from ovibjax.control.slot_table import SlotTable
from ovibjax.runtime.computed_once import computed_case, computed_once
from ovibjax.runtime.every_lane import every_lane

_NEVER = 1 << 30
_LONG_AGO = -(1 << 20) - 1


class Sums(NamedTuple):
    """Sums over the slots of a replay.

    Attributes:
        error_m: distance between estimate and truth, after a correction that came in time.
        risk_m: local risk after it.
        requests: int32 how many were sent.
        sent_bytes: their payload.
        action: [T] int8 what was sent in each slot, -1 for nothing.
    """

    error_m: jax.Array
    risk_m: jax.Array
    requests: jax.Array
    sent_bytes: jax.Array
    action: jax.Array


class Client(NamedTuple):
    """One client between slots.

    Attributes:
        belief: what it navigates with, unless `pending` has landed.
        pending: the belief with the correction that was asked for last.
        lands: int32 slot from which that holds.
        arrives: int32 slot in which the answer to the last request arrives.
        last: int32 slot of that request.
        sent_bytes: payload sent so far.
        used_j: energy used so far.
    """

    belief: Isotropic
    pending: Isotropic
    lands: jax.Array
    arrives: jax.Array
    last: jax.Array
    sent_bytes: jax.Array
    used_j: jax.Array


def scan_slots(start: Belief, table: SlotTable, policy: str, params: ControlParams, actions: ActionSet) -> Sums:
    """Replay a policy along tabulated slots.

    Args:
        start: the belief before the first slot.
        table: the slots.
        policy: a key of `POLICIES` (static).
        params: environment and controller.
        actions: the action set (static).

    Returns:
        The sums.
    """
    params = by_action(params)
    case = _case(params.control, actions)
    zero = jnp.zeros_like(table.rate_bps[0])

    def one(carry: Any, number: jax.Array) -> tuple[Any, jax.Array]:
        client, error, risk, requests = carry
        # The slot before, whose state is at hand as arrays: decisions are not computed again for two sums.
        error, risk = _add(error, risk, client, number - 1, params.env.drift)
        deciders = _deciders(table, number, policy, params, actions)
        if policy in FIXED_ACTION:  # nothing to compare
            code, used_j = computed_once(number >= 0, deciders[-1], client)
        else:
            code, used_j = computed_case(case, deciders, client)
        requests = requests + (code >= 0).astype(jnp.int32)
        client = _after(client, code, at(table, number), actions)._replace(used_j=used_j)
        return (client, error, risk, requests), _action(code, actions).astype(jnp.int8)

    begin = (_begin(start, zero, params.env.drift), zero, zero, jnp.int32(0))
    (client, error, risk, requests), action = jax.lax.scan(one, begin, table.number)
    error, risk = _add(error, risk, client, table.number[-1], params.env.drift)
    return Sums(error, risk, requests, client.sent_bytes, action)


def _begin(start: Belief, zero: jax.Array, drift: Drift) -> Client:
    """A client before the first slot."""
    belief = isotropic(start, drift)
    return Client(belief, belief, jnp.int32(_NEVER), jnp.int32(_LONG_AGO), jnp.int32(_LONG_AGO), zero, zero)


def _current(client: Client, number: jax.Array) -> Isotropic:
    """The belief in a slot."""
    return jax.tree.map(lambda a, b: jnp.where(client.lands <= number, a, b), client.pending, client.belief)


def _add(
    error: jax.Array, risk: jax.Array, client: Client, number: jax.Array, drift: Drift
) -> tuple[jax.Array, jax.Array]:
    """Sums with a slot that is over; the one before the first does not count."""
    belief = _current(client, number)
    counts = number >= 0
    return (
        error + jnp.where(counts, error_m(belief, drift), 0.0),
        risk + jnp.where(counts, risk_m(belief, drift), 0.0),
    )


def _case(control: Controller, actions: ActionSet) -> jax.Array:
    """Which of `_deciders` is right for all lanes: an eighth of the comparisons goes where nothing can run out."""
    free = (control.energy_budget_j >= 0.0) & jnp.isfinite(control.prices.energy_m_per_j)
    for a in range(len(actions)):
        free = free & control.available[a] & (control.energy_j[a] == 0.0)
    unlimited = free & (control.budget_bytes == jnp.inf)
    return jnp.where(every_lane(unlimited), 0, jnp.where(every_lane(free), 1, 2))


def at(table: SlotTable, number: jax.Array) -> SlotTable:
    """One slot of a table, taken where it is used: a slice that a branch is given is a copy."""
    return jax.tree.map(lambda leaf: jax.lax.dynamic_index_in_dim(leaf, number, keepdims=False), table)


def _deciders(table: SlotTable, number: jax.Array, policy: str, params: ControlParams, actions: ActionSet) -> list[Any]:
    """Functions of the client that say what it does: where no budget binds, where payload alone does, and in general.

    They return a code and the energy used so far. The code is -1 for nothing. Otherwise its lowest bits are the action,
    the next one whether the correction is used, the others how many slots it takes.
    """
    control = params.control
    count = len(actions)
    costless = control._replace(
        energy_j=(jnp.float32(0.0),) * count, prices=control.prices._replace(energy_m_per_j=jnp.float32(0.0))
    )
    budgeted = policy != "oracle_action"

    def decide(client: Client, control: Controller, allowed: Sequence[jax.Array]) -> jax.Array:
        return _decide(client, at(table, number), policy, (params, control, actions), tuple(allowed))

    def general(client: Client) -> tuple[jax.Array, jax.Array]:
        def by_both(client: Client) -> jax.Array:
            return decide(client, control, affordable(client.sent_bytes, client.used_j, control, actions, budgeted))

        code = computed_once(number >= 0, by_both, client)
        energy_j = chosen(control.energy_j, jnp.maximum(_action(code, actions), 0))
        return code, client.used_j + jnp.where(code >= 0, energy_j, 0.0)

    def by_payload(client: Client) -> tuple[jax.Array, jax.Array]:
        fits = [client.sent_bytes + jnp.float32(b) <= control.budget_bytes for b in actions.payload_bytes]
        return decide(client, costless, fits), client.used_j

    def unlimited(client: Client) -> tuple[jax.Array, jax.Array]:
        return decide(client, costless, (jnp.bool_(True),) * count), client.used_j

    return [unlimited, by_payload if budgeted else unlimited, general]


def _decide(
    client: Client,
    slot: SlotTable,
    policy: str,
    rules: tuple[ControlParams, Controller, ActionSet],
    allowed: tuple[jax.Array, ...],
) -> jax.Array:
    """What a client does, see `_deciders`."""
    params, control, actions = rules
    belief = _current(client, slot.number)
    belief = belief._replace(accumulated_m=belief.accumulated_m + slot.drifted.accumulated_m)
    seen = Observation(
        risk_m=risk_m(belief, params.env.drift),
        predicted_m=slot.predicted_m,
        realised_m=slot.realised_m,
        rate_bps=slot.rate_bps,
        transmit_s=slot.transmit_s,
        delay_s=slot.delay_s,
        since_s=(slot.number - client.last).astype(jnp.float32) * params.env.slot_s,
        waiting=client.arrives > slot.number,
        scheduled=slot.scheduled,
        allowed=allowed,
    )
    decision = POLICIES[policy](seen, control, actions)
    trip, fix_risk_m = (chosen(values, decision.action) for values in (slot.trip, slot.fix_risk_m))
    taken = (fix_risk_m < seen.risk_m) | (control.correction != CORRECTIONS.index("replace"))
    used = (trip & 1) & taken.astype(jnp.int32)
    return jnp.where(decision.send, decision.action + (((trip & ~1) + used) << _bits(actions)), -1)


def _after(client: Client, code: jax.Array, slot: SlotTable, actions: ActionSet) -> Client:
    """A client at the end of a slot in which it did what a code says; the energy is not counted here."""
    send, action, trip = code >= 0, jnp.maximum(_action(code, actions), 0), code >> _bits(actions)
    used = send & (trip & 1 == 1)
    arrives = slot.number + (trip >> 1)
    fix = Isotropic(
        chosen(slot.fixed.fixed_m2, action),
        chosen(slot.fixed.error_a, action),
        jnp.zeros_like(client.pending.accumulated_m),
        chosen(slot.fixed.error_b, action),
    )
    paid = chosen([jnp.float32(b) for b in actions.payload_bytes], action)
    return Client(
        belief=jax.tree.map(jnp.add, _current(client, slot.number), slot.drifted),
        pending=jax.tree.map(lambda f, p, d: jnp.where(used, f, p + d), fix, client.pending, slot.drifted),
        lands=jnp.where(send, jnp.where(used, arrives, _NEVER), client.lands),
        arrives=jnp.where(send, arrives, client.arrives),
        last=jnp.where(send, slot.number, client.last),
        sent_bytes=client.sent_bytes + jnp.where(send, paid, 0.0),
        used_j=client.used_j,
    )


def _bits(actions: ActionSet) -> int:
    """Bits that number the actions."""
    return (len(actions) - 1).bit_length()


def _action(code: jax.Array, actions: ActionSet) -> jax.Array:
    """The action of a code; -1 for none."""
    return jnp.where(code < 0, -1, code & ((1 << _bits(actions)) - 1))

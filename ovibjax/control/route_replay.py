"""Route replay: any request policy along a route, slot by slot, as one fixed-length scan.

A slot: odometry drifts; a correction that has arrived takes effect; the client decides; a correction that returns
within the slot is used in that slot, a later one from the slot it arrives in. A correction under way is a second
belief that drifts with the first: the estimate as it will be. A newer request supersedes one that is under way.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.control import belief
from ovibjax.control.actions import ACTIONS, ActionSet
from ovibjax.control.belief import Belief
from ovibjax.control.environment import Draws, Environment, Route, draw
from ovibjax.control.policies import (
    FOLLOW_VOI,
    POLICIES,
    Controller,
    Decision,
    Observation,
    chosen,
    schedule,
)
from ovibjax.control.voi import net_voi
from ovibjax.link.latency import transmit_s
from ovibjax.runtime.computed_once import computed_once


class Params(NamedTuple):
    """Everything a replay depends on beside route and key; leaves.

    Attributes:
        env: drift, link, queue.
        control: prices, budget, rules.
    """

    env: Environment
    control: Controller


class State(NamedTuple):
    """One client between slots.

    Attributes:
        belief: what it navigates with.
        pending: the belief as a correction under way will make it.
        flight: int32 slots until that correction arrives; 0 for none.
        since: int32 slots since the last request.
        sent_bytes: payload sent so far.
        used_j: energy used so far.
    """

    belief: Belief
    pending: Belief
    flight: jax.Array
    since: jax.Array
    sent_bytes: jax.Array
    used_j: jax.Array


class Slot(NamedTuple):
    """What the world brings in one slot; `number` counts from zero, the other fields are as in `Route` and `Draws`."""

    number: jax.Array
    predicted_m: jax.Array
    residual_m: jax.Array
    increment: Belief
    rate_bps: jax.Array
    delay_s: jax.Array
    latency_s: jax.Array
    scheduled: jax.Array


class SlotInfo(NamedTuple):
    """What happened in one slot, or [T] of them: the result of a replay.

    Attributes:
        error_m: distance between estimate and truth, after a correction that came in time.
        risk_before_m: local risk when the client decided.
        risk_m: local risk after it.
        sent: whether a request was sent.
        action: int32, with which action; meaningful where sent.
        payload_bytes: its size; 0 where none was sent.
        voi_m: predicted net VOI of the action; meaningful where sent.
        delay_s: its predicted queueing, service and return delay.
        latency_s: time from decision to correction.
        residual_m: realised residual of the action.
        rate_bps: uplink rate.
    """

    error_m: jax.Array
    risk_before_m: jax.Array
    risk_m: jax.Array
    sent: jax.Array
    action: jax.Array
    payload_bytes: jax.Array
    voi_m: jax.Array
    delay_s: jax.Array
    latency_s: jax.Array
    residual_m: jax.Array
    rate_bps: jax.Array


RouteResult = SlotInfo


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


def by_action(params: Params) -> Params:
    """The same numbers with one array per action: sliced before the loop, mapped candidates stay contiguous in it."""
    control = params.control
    return params._replace(control=control._replace(energy_j=(*control.energy_j,), available=(*control.available,)))


def start(draws: Draws) -> State:
    """A client before the first slot."""
    zero = jnp.zeros_like(draws.rate_bps[0])
    never = jnp.int32(1 << 20)
    return State(draws.start, draws.start, jnp.int32(0), never, zero, zero)


def observe(state: State, slot: Slot, params: Params, actions: ActionSet, budgeted: bool) -> tuple[State, Observation]:
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
    control = params.control
    now = belief.propagate(state.belief, slot.increment)
    pending = belief.propagate(state.pending, slot.increment)
    state = state._replace(
        belief=belief.select(state.flight == 1, pending, now),
        pending=pending,
        flight=jnp.maximum(state.flight - 1, 0),
        since=state.since + 1,
    )
    sizes = actions.payload_bytes
    allowed = []
    for a in range(len(actions)):
        fits = state.used_j + control.energy_j[a] <= control.energy_budget_j
        if budgeted:
            fits = fits & (state.sent_bytes + jnp.float32(sizes[a]) <= control.budget_bytes)
        allowed.append(fits & control.available[a])
    seen = Observation(
        risk_m=belief.local_risk_m(state.belief),
        predicted_m=slot.predicted_m,
        realised_m=jnp.sqrt(jnp.sum(slot.residual_m**2, axis=-1)),
        rate_bps=slot.rate_bps,
        delay_s=slot.delay_s,
        since_s=state.since.astype(jnp.float32) * params.env.slot_s,
        waiting=state.flight > 0,
        scheduled=slot.scheduled,
        allowed=tuple(allowed),
    )
    return state, seen


def decide(seen: Observation, slot: Slot, policy: str, params: Params, actions: ActionSet) -> Decision:
    """Ask a policy what to do; `policy` and `actions` are static."""

    def code(seen: Observation) -> jax.Array:
        decision = POLICIES[policy](seen, params.control, actions)
        return jnp.where(decision.send, decision.action, -1)

    made = computed_once(slot.number >= 0, code, seen)
    return Decision(made >= 0, jnp.maximum(made, 0))


def respond(
    state: State, slot: Slot, seen: Observation, decision: Decision, params: Params, actions: ActionSet
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
    send, action = decision
    every, running = range(len(actions)), slot.number >= 0

    def of_action(action: jax.Array, risk_m: jax.Array) -> Any:
        size = chosen([jnp.float32(b) for b in actions.payload_bytes], action)
        predicted_m, delay_s, energy_j, residual_m, rest_s = (
            chosen([values[a] for a in every], action)
            for values in (slot.predicted_m, slot.delay_s, params.control.energy_j, seen.realised_m, slot.latency_s)
        )
        measured = [chosen([slot.residual_m[a, axis] for a in every], action) for axis in (0, 1)]
        value = net_voi(risk_m, predicted_m, size, slot.rate_bps, delay_s, energy_j, params.control.prices)
        latency_s = transmit_s(size, slot.rate_bps) + rest_s
        return size, latency_s, measured, predicted_m, delay_s, energy_j, residual_m, value

    def fuse(before: Belief, measured: list[jax.Array], predicted_m: jax.Array) -> Belief:
        return belief.correct(before, measured[0], measured[1], predicted_m, params.control.gate_sigma)

    size, latency_s, measured, predicted_m, delay_s, energy_j, residual_m, value = computed_once(
        running, of_action, action, seen.risk_m
    )
    corrected = computed_once(running, fuse, state.belief, measured, predicted_m)
    lost = latency_s > params.env.timeout_s
    coming = belief.select(lost, state.belief, corrected)
    flight = jnp.floor(jnp.minimum(latency_s, params.env.timeout_s) / params.env.slot_s).astype(jnp.int32)
    now = belief.select(send & (flight == 0), coming, state.belief)
    paid = jnp.where(send, size, 0.0)
    after = State(
        belief=now,
        pending=belief.select(send, coming, state.pending),
        flight=jnp.where(send, flight, state.flight),
        since=jnp.where(send, 0, state.since),
        sent_bytes=state.sent_bytes + paid,
        used_j=state.used_j + jnp.where(send, energy_j, 0.0),
    )
    info = SlotInfo(
        error_m=belief.error_m(now),
        risk_before_m=seen.risk_m,
        risk_m=belief.local_risk_m(now),
        sent=send,
        action=action,
        payload_bytes=paid,
        voi_m=value,
        delay_s=delay_s,
        latency_s=latency_s,
        residual_m=residual_m,
        rate_bps=slot.rate_bps,
    )
    return after, info


def step(state: State, slot: Slot, policy: str, params: Params, actions: ActionSet) -> tuple[State, SlotInfo]:
    """One slot of one client under a policy; `policy` and `actions` are static."""
    state, seen = observe(state, slot, params, actions, budgeted=policy != "oracle_action")
    decision = decide(seen, slot, policy, params, actions)
    return respond(state, slot, seen, decision, params, actions)


def slots_of(route: Route, draws: Draws, scheduled: jax.Array) -> Slot:
    """[T] slots, as the scan takes them."""
    return Slot(
        jnp.arange(scheduled.shape[0]),
        jnp.asarray(route.predicted_m),
        jnp.asarray(route.residual_m),
        draws.increment,
        draws.rate_bps,
        draws.delay_s,
        draws.latency_s,
        scheduled,
    )


def replay_schedule(
    draws: Draws, route: Route, policy: str, planned: jax.Array, params: Params, actions: ActionSet = ACTIONS
) -> RouteResult:
    """Replay a policy on a given realization of the world, with the slots that it has planned ahead.

    Args:
        draws: the realization.
        route: the route.
        policy: a key of `POLICIES` (static).
        planned: [T] bool, see `policies.schedule`.
        params: environment and controller.
        actions: the action set (static).

    Returns:
        [T] of everything that happened.
    """
    slots, params = slots_of(route, draws, planned), by_action(params)
    return jax.lax.scan(lambda state, slot: step(state, slot, policy, params, actions), start(draws), slots)[1]


def simulate(draws: Draws, route: Route, policy: str, params: Params, actions: ActionSet = ACTIONS) -> RouteResult:
    """Replay a policy on a given realization of the world.

    Args:
        draws: the realization.
        route: the route.
        policy: a key of `POLICIES` (static). Those in `FOLLOW_VOI` replay VOI-Control first.
        params: environment and controller.
        actions: the action set (static).

    Returns:
        [T] of everything that happened.
    """
    sent = jnp.zeros(draws.rate_bps.shape, bool)
    if policy in FOLLOW_VOI:
        sent = replay_schedule(draws, route, "voi", sent, params, actions).sent
    return replay_schedule(draws, route, policy, plan(draws, policy, params, sent), params, actions)


def plan(draws: Draws, policy: str, params: Params, voi_sent: jax.Array) -> jax.Array:
    """[T] bool, slots that a policy has planned ahead, given those in which VOI-Control asked."""
    return schedule(policy, params.env.slot_s, draws.rank, draws.phase_s, params.control, voi_sent)


replay = jax.jit(simulate, static_argnames=("policy", "actions"))
"""`simulate`, compiled once per policy and length of route."""


def run(key: jax.Array, route: Route, policy: str, params: Params, actions: ActionSet = ACTIONS) -> RouteResult:
    """Replay a policy along a route with one seed's draws of the world.

    Args:
        key: the seed's key; policies that share it see the same channel, drift and queue.
        route: the route.
        policy: a key of `POLICIES` (static).
        params: environment and controller.
        actions: the action set (static).

    Returns:
        [T] of everything that happened.
    """
    return simulate(draw(key, route, params.env, actions), route, policy, params, actions)


def summarize(result: RouteResult) -> Summary:
    """Mean and tail of the route error, requests and payload of a replay."""
    return Summary(
        mean_m=jnp.mean(result.error_m, axis=-1),
        p95_m=jnp.percentile(result.error_m, 95.0, axis=-1),
        risk_m=jnp.mean(result.risk_m, axis=-1),
        requests=jnp.sum(result.sent.astype(jnp.int32), axis=-1),
        kb=jnp.sum(result.payload_bytes, axis=-1) / 1024.0,
    )


def score(draws: Draws, route: Route, policy: str, params: Params, actions: ActionSet = ACTIONS) -> Summary:
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

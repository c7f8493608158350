"""Clients and edge queue together, slot by slot (paper, Section "VOI-Weighted Edge Scheduling", coupled replay).

Arrivals depend on the queue: every client reads the backlog at the start of a slot, its request controller prices the
predicted wait, and what it sends joins the queue after encoding and transmission. The server, work-conserving and
non-preemptive, serves by one of the scheduling rules within the slot; a correction comes back when its service ends.
Controller and rules are those of the decoupled replays. A client has at most one request under way.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.control import belief
from ovibjax.control.actions import ACTIONS, ActionSet
from ovibjax.control.client_state import ControlParams, Slot, SlotInfo, State, start
from ovibjax.control.client_step import decide, observe, respond
from ovibjax.control.environment import SLOT_S, Draws, Route
from ovibjax.control.route_replay import slots_of
from ovibjax.edge.service import draw_ms, estimate_ms
from ovibjax.link.latency import JETSON, compute_ms_at, transmit_s
from ovibjax.scheduling.requests import NEVER, Requests
from ovibjax.scheduling.rules import RULES, Queue, SchedulerParams

_TICKS_PER_MS = 1024.0
_FASTEST_SERVICE_MS = 10.0
_UNDER_WAY_S = 1e6  # a correction whose time of return the queue has not decided yet


class Mission(NamedTuple):
    """What the edge knows of a client's requests beside their content; fields [N].

    Attributes:
        urgency: mission urgency omega.
        deadline_ms: relative deadline.
    """

    urgency: jax.Array
    deadline_ms: jax.Array


class Pool(NamedTuple):
    """The request each client has at the edge or on its way there; fields [N], times from the start of the slot.

    Attributes:
        waiting: whether there is one that has not been served.
        ready_ms: when it joins the queue; negative for an earlier slot.
        sent_ms: when it was decided on.
        service_ms: time it will occupy the server.
        service_est_ms: its estimate.
        voi_m: predicted net VOI.
        risk_m: local risk.
        delay_est_ms: predicted latency.
        drift_m_per_s: drift rate.
    """

    waiting: jax.Array
    ready_ms: jax.Array
    sent_ms: jax.Array
    service_ms: jax.Array
    service_est_ms: jax.Array
    voi_m: jax.Array
    risk_m: jax.Array
    delay_est_ms: jax.Array
    drift_m_per_s: jax.Array


class CoupledResult(NamedTuple):
    """What happened, [T, N].

    Attributes:
        info: each client's slots, as in the decoupled replay; `latency_s` has no meaning here.
        served: whether a request of the client was served in the slot.
        edge_ms: its queueing and service time.
        response_ms: from decision to correction.
        backlog_ms: [T] predicted work in the queue at the start of the slot.
    """

    info: SlotInfo
    served: jax.Array
    edge_ms: jax.Array
    response_ms: jax.Array
    backlog_ms: jax.Array


def run(
    key: jax.Array,
    draws: Draws,
    routes: Route,
    mission: Mission,
    policy: str,
    params: ControlParams,
    scheduler: str,
    scheduler_params: SchedulerParams,
    actions: ActionSet = ACTIONS,
) -> CoupledResult:
    """Replay N clients and their shared edge server.

    Args:
        key: service-time jitter.
        draws: [N, ...] a realization per client; its queue is not used.
        routes: [N, T, ...] a route per client.
        mission: [N] urgencies and deadlines.
        policy: request policy, one that plans nothing ahead: voi, fixed_front or uncertainty (static).
        params: environment and controller, shared by the clients.
        scheduler: a key of `RULES` (static).
        scheduler_params: its numbers.
        actions: the action set (static).

    Returns:
        The replay.
    """
    n, length = draws.rate_bps.shape
    none = jnp.zeros((n, length), bool)
    slots = jax.vmap(slots_of)(routes, draws, none)
    slots = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, 1), slots)
    growth = jnp.moveaxis(params.env.drift_m2_per_s[routes.context], 0, 1)
    keys = jax.vmap(lambda t: jax.random.fold_in(key, t))(jnp.arange(length))
    zero, idle = jnp.zeros(n, jnp.float32), jnp.zeros(n, bool)
    pool = Pool(idle, *([zero] * 8))
    begin = (jax.vmap(start)(draws), pool, jnp.float32(0.0))

    def step(carry: tuple[State, Pool, jax.Array], inputs: tuple[Slot, jax.Array, jax.Array]) -> Any:
        slot, growth, slot_key = inputs
        return _slot(carry, slot, growth, slot_key, mission, policy, params, scheduler, scheduler_params, actions)

    return jax.lax.scan(step, begin, (slots, growth, keys))[1]


def _slot(
    carry: tuple[State, Pool, jax.Array],
    slot: Slot,
    growth_m2_per_s: jax.Array,
    key: jax.Array,
    mission: Mission,
    policy: str,
    params: ControlParams,
    scheduler: str,
    scheduler_params: SchedulerParams,
    actions: ActionSet,
) -> tuple[tuple[State, Pool, jax.Array], CoupledResult]:
    clients, pool, free_ms = carry
    n = pool.waiting.shape[0]
    env, mode = params.env, jnp.asarray(actions.mode)
    backlog_ms = jnp.maximum(free_ms, 0.0) + jnp.sum(jnp.where(pool.waiting, pool.service_est_ms, 0.0))
    delay_s = (backlog_ms + estimate_ms(env.service, mode) + env.return_ms) / 1000.0
    slot = slot._replace(
        number=slot.number[0],
        delay_s=jnp.broadcast_to(delay_s, (n, len(actions))),
        latency_s=jnp.full((n, len(actions)), _UNDER_WAY_S, jnp.float32),
    )
    patient = params._replace(env=env._replace(timeout_s=jnp.float32(jnp.inf)))
    axes: Any = jax.tree.map(lambda _: 0, slot)._replace(number=None)

    def act(client: State, one: Slot) -> tuple[State, SlotInfo]:
        client, seen = observe(client, one, patient, actions, budgeted=True)
        decision = decide(seen, one, policy, patient, actions)
        return respond(client, one, seen, decision, patient, actions)

    clients, info = jax.vmap(act, in_axes=(0, axes))(clients, slot)
    encode_ms = compute_ms_at(JETSON, jnp.asarray(actions.prefix))[info.action]
    sent_mode = mode[info.action]
    fresh = Pool(
        waiting=info.sent,
        ready_ms=encode_ms + 1000.0 * transmit_s(info.payload_bytes, info.rate_bps),
        sent_ms=jnp.zeros(n, jnp.float32),
        service_ms=draw_ms(key, env.service, sent_mode),
        service_est_ms=estimate_ms(env.service, sent_mode),
        voi_m=info.voi_m,
        risk_m=info.risk_before_m,
        delay_est_ms=1000.0 * info.delay_s,
        drift_m_per_s=growth_m2_per_s / (2.0 * info.risk_before_m),  # d sqrt(tr P) / dt, as in recorded requests
    )
    pool = jax.tree.map(lambda new, old: jnp.where(info.sent, new, old), fresh, pool)
    slot_ms = 1000.0 * env.slot_s
    finish_ms, pool, free_ms = _serve(pool, free_ms, slot_ms, mission, scheduler, scheduler_params)
    served = jnp.isfinite(finish_ms)
    return_ms = finish_ms + env.return_ms
    late = jnp.floor(return_ms / slot_ms)
    now = served & (late < 1)
    clients = clients._replace(
        belief=belief.select(now, clients.pending, clients.belief),
        flight=jnp.where(served, jnp.where(now, 0.0, late).astype(jnp.int32), clients.flight),
    )
    info = info._replace(error_m=belief.error_m(clients.belief), risk_m=belief.local_risk_m(clients.belief))
    result = CoupledResult(info, served, finish_ms - pool.ready_ms, return_ms - pool.sent_ms, backlog_ms)
    pool = pool._replace(ready_ms=pool.ready_ms - slot_ms, sent_ms=pool.sent_ms - slot_ms)
    return (clients, pool, free_ms - slot_ms), result


def _serve(
    pool: Pool, free_ms: jax.Array, slot_ms: jax.Array, mission: Mission, scheduler: str, params: SchedulerParams
) -> tuple[jax.Array, Pool, jax.Array]:
    """Serve what begins within the slot; returns ends of service [N], NaN where there was none."""
    n = pool.waiting.shape[0]
    # No more services begin in a slot of the paper's length; a longer one would serve less than it could.
    decisions = min(n, int(1000.0 * SLOT_S / _FASTEST_SERVICE_MS))

    def serve(carry: Any, _: None) -> Any:
        waiting, finish_ms, free_ms = carry
        earliest = jnp.min(jnp.where(waiting, pool.ready_ms, jnp.inf))
        clock_ms = jnp.maximum(free_ms, earliest)
        arrived = waiting & (pool.ready_ms <= clock_ms)
        active = jnp.any(waiting) & (clock_ms < slot_ms)
        priority = RULES[scheduler](_queue(pool, arrived, clock_ms, mission), params)
        first = arrived & (priority == jnp.max(priority))
        chosen = jnp.argmin(jnp.where(first, pool.ready_ms, jnp.inf))
        end_ms = clock_ms + pool.service_ms[chosen]
        taken = (jnp.arange(n) == chosen) & active
        return (waiting & ~taken, jnp.where(taken, end_ms, finish_ms), jnp.where(active, end_ms, free_ms)), None

    begin = (pool.waiting, jnp.full(n, jnp.nan, jnp.float32), free_ms)
    (waiting, finish_ms, free_ms), _ = jax.lax.scan(serve, begin, None, length=decisions)
    return finish_ms, pool._replace(waiting=waiting), free_ms


def _queue(pool: Pool, arrived: jax.Array, clock_ms: jax.Array, mission: Mission) -> Queue:
    """The pool as scheduling rules see it."""
    n = arrived.shape[0]
    ready = jnp.clip(pool.ready_ms * _TICKS_PER_MS, -1e9, 1e9).astype(jnp.int32)
    number = jnp.arange(n, dtype=jnp.int32)
    return Queue(
        requests=Requests(
            position=number,
            valid=pool.waiting,
            client=number,
            ready=jnp.where(pool.waiting, ready, NEVER),
            service=jnp.zeros(n, jnp.int32),
            slack=(mission.deadline_ms - pool.service_est_ms) * _TICKS_PER_MS,
            per_deadline=1.0 / (mission.deadline_ms * _TICKS_PER_MS),
            service_est_ms=jnp.maximum(pool.service_est_ms, 1e-3),
            due=pool.ready_ms + mission.deadline_ms,
            voi_m=pool.voi_m,
            drift_m_per_s=pool.drift_m_per_s,
            risk_m=pool.risk_m,
            delay_est_ms=pool.delay_est_ms,
            urgency=mission.urgency,
            previous=jnp.full(n, -1, jnp.int32),
            group=number,
            total=jnp.sum(pool.waiting.astype(jnp.int32)),
            tick_ms=jnp.float32(1.0 / _TICKS_PER_MS),
        ),
        clock=jnp.clip(clock_ms * _TICKS_PER_MS, -1e9, 1e9).astype(jnp.int32),
        waiting=arrived,
        head=arrived,
        backlog=arrived.astype(jnp.float32),
    )

"""Clients and edge queue together, slot by slot, so that arrivals feel the queue.

This is the coupled replay of the paper's Section "VOI-Weighted Edge Scheduling", after its theorem. Every client reads
the backlog at the start of a slot, its request controller prices the predicted wait, and what it sends joins the queue
after encoding and transmission, see `shared_queue`; a correction comes back when its service ends. Controller and rules
are those of the decoupled replays. A client has at most one request under way.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.control import belief
from ovibjax.control.actions import ACTIONS, ActionSet
from ovibjax.control.client_state import ControlParams, Slot, SlotInfo, State, start
from ovibjax.control.client_step import decide, observe, respond
from ovibjax.control.environment import Draws, Route
from ovibjax.control.route_replay import slots_of
from ovibjax.edge.service import draw_ms, estimate_ms
from ovibjax.link.latency import JETSON, compute_ms_at, transmit_s
from ovibjax.scheduling.rules import SchedulerParams
from ovibjax.scheduling.shared_queue import Mission, Pool, empty_pool, serve_slot

_UNDER_WAY_S = 1e6  # a correction whose time of return the queue has not decided yet


class Fleet(NamedTuple):
    """The clients of one edge server; fields [N, ...].

    Attributes:
        draws: a realization per client; its queue is not used.
        routes: [N, T, ...] a route per client.
        mission: [N] urgencies and deadlines.
    """

    draws: Draws
    routes: Route
    mission: Mission


class CoupledParams(NamedTuple):
    """Numbers of both sides; leaves.

    Attributes:
        control: environment and controller, shared by the clients.
        scheduler: numbers of the scheduling rule.
    """

    control: ControlParams
    scheduler: SchedulerParams


@dataclass(frozen=True)
class CoupledRules:
    """Who decides; hashable, a static argument.

    Attributes:
        policy: request policy, one that plans nothing ahead: voi, fixed_front or uncertainty.
        scheduler: scheduling rule, a key of `RULES`.
        actions: the action set.
    """

    policy: str
    scheduler: str
    actions: ActionSet = ACTIONS


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


def replay_coupled(key: jax.Array, fleet: Fleet, params: CoupledParams, rules: CoupledRules) -> CoupledResult:
    """Replay N clients and the edge server they share.

    Args:
        key: service-time jitter.
        fleet: the clients.
        params: numbers of request control and scheduling.
        rules: policy, rule and actions (static).

    Returns:
        The replay.
    """
    n, length = fleet.draws.rate_bps.shape
    none = jnp.zeros((n, length), bool)
    slots = jax.vmap(slots_of)(fleet.routes, fleet.draws, none)
    slots = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, 1), slots)
    drift = jnp.moveaxis(params.control.env.drift.rate_m_per_s[fleet.routes.context], 0, 1)
    keys = jax.vmap(lambda t: jax.random.fold_in(key, t))(jnp.arange(length))
    pool = empty_pool(n)
    begin = _State(jax.vmap(start)(fleet.draws), pool, jnp.float32(0.0))

    def step(state: _State, inputs: tuple[Slot, jax.Array, jax.Array]) -> tuple[_State, CoupledResult]:
        return _slot(state, *inputs, fleet.mission, params, rules)

    return jax.lax.scan(step, begin, (slots, drift, keys))[1]


class _State(NamedTuple):
    """Between slots: the clients, their requests, and when the server is free, from the start of the slot."""

    clients: State
    pool: Pool
    free_ms: jax.Array


def _slot(
    state: _State,
    slot: Slot,
    drift_m_per_s: jax.Array,
    key: jax.Array,
    mission: Mission,
    params: CoupledParams,
    rules: CoupledRules,
) -> tuple[_State, CoupledResult]:
    """One slot: clients act, the server serves, corrections come back."""
    clients, pool, free_ms = state
    env, mode = params.control.env, jnp.asarray(rules.actions.mode)
    backlog_ms = jnp.maximum(free_ms, 0.0) + jnp.sum(jnp.where(pool.waiting, pool.service_est_ms, 0.0))
    delay_s = (backlog_ms + estimate_ms(env.service, mode) + env.return_ms) / 1000.0
    clients, info = _act(clients, slot, delay_s, params.control, rules)
    fresh = _sent(info, mode, drift_m_per_s, key, params.control, rules.actions)
    pool = jax.tree.map(lambda new, old: jnp.where(info.sent, new, old), fresh, pool)
    slot_ms = 1000.0 * env.slot_s
    finish_ms, pool, free_ms = serve_slot(pool, free_ms, slot_ms, mission, rules.scheduler, params.scheduler)
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
    return _State(clients, pool, free_ms - slot_ms), result


def _act(
    clients: State, slot: Slot, delay_s: jax.Array, params: ControlParams, rules: CoupledRules
) -> tuple[State, SlotInfo]:
    """Every client decides, knowing the predicted delay [A]; corrections stay under way until they are served."""
    env, actions = params.env, rules.actions
    n = clients.flight.shape[0]
    slot = slot._replace(
        number=slot.number[0],
        delay_s=jnp.broadcast_to(delay_s, (n, len(actions))),
        latency_s=jnp.full((n, len(actions)), _UNDER_WAY_S, jnp.float32),
    )
    patient = params._replace(env=env._replace(timeout_s=jnp.float32(jnp.inf)))
    axes: Any = jax.tree.map(lambda _: 0, slot)._replace(number=None)

    def act(client: State, one: Slot) -> tuple[State, SlotInfo]:
        client, seen = observe(client, one, patient, actions, budgeted=True)
        decision = decide(seen, one, rules.policy, patient, actions)
        return respond(client, one, seen, decision, patient, actions)

    return jax.vmap(act, in_axes=(0, axes))(clients, slot)


def _sent(
    info: SlotInfo,
    mode: jax.Array,
    drift_m_per_s: jax.Array,
    key: jax.Array,
    params: ControlParams,
    actions: ActionSet,
) -> Pool:
    """The requests that clients sent in a slot, as they reach the edge; `mode` [A] is that of each action."""
    env = params.env
    encode_ms = compute_ms_at(JETSON, jnp.asarray(actions.prefix))[info.action]
    sent_mode = mode[info.action]
    return Pool(
        waiting=info.sent,
        ready_ms=encode_ms + 1000.0 * transmit_s(info.payload_bytes, info.rate_bps),
        sent_ms=jnp.zeros(info.sent.shape, jnp.float32),
        service_ms=draw_ms(key, env.service, sent_mode),
        service_est_ms=estimate_ms(env.service, sent_mode),
        voi_m=info.voi_m,
        risk_m=info.risk_before_m,
        delay_est_ms=1000.0 * info.delay_s,
        drift_m_per_s=drift_m_per_s,
    )

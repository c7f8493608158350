"""The edge queue that clients of a coupled replay share: one request a client, served within the slot by a rule.

The server is work-conserving and non-preemptive. Times count from the start of the slot; those of earlier slots are
negative.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.control.environment import SLOT_S
from ovibjax.scheduling.requests import NEVER, Requests
from ovibjax.scheduling.rules import RULES, Queue, SchedulerParams
from ovibjax.scheduling.ties import served_first

_TICKS_PER_MS = 1024.0
_FASTEST_SERVICE_MS = 10.0


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


def empty_pool(clients: int) -> Pool:
    """No request of any client."""
    zero, idle = jnp.zeros(clients, jnp.float32), jnp.zeros(clients, bool)
    return Pool(idle, *([zero] * 8))


def serve_slot(
    pool: Pool, free_ms: jax.Array, slot_ms: jax.Array, mission: Mission, scheduler: str, params: SchedulerParams
) -> tuple[jax.Array, Pool, jax.Array]:
    """Serve the requests whose service begins within the slot.

    Args:
        pool: requests at the edge or on their way there.
        free_ms: when the server is free.
        slot_ms: length of the slot.
        mission: urgencies and deadlines.
        scheduler: a key of `RULES` (static).
        params: its numbers.

    Returns:
        Ends of service [N], NaN where there was none; the pool without them; when the server is free.
    """
    n = pool.waiting.shape[0]
    # No more services begin in a slot of the paper's length; a longer one would serve less than it could.
    decisions = min(n, int(1000.0 * SLOT_S / _FASTEST_SERVICE_MS))
    # Equal arrival times go by client.
    arrival = jnp.argsort(jnp.argsort(pool.ready_ms)).astype(jnp.int32)

    def serve(carry: Any, _: None) -> Any:
        waiting, finish_ms, free_ms = carry
        earliest = jnp.min(jnp.where(waiting, pool.ready_ms, jnp.inf))
        clock_ms = jnp.maximum(free_ms, earliest)
        arrived = waiting & (pool.ready_ms <= clock_ms)
        active = jnp.any(waiting) & (clock_ms < slot_ms)
        queue = _queue(pool, arrived, arrival, clock_ms, mission)
        priority = RULES[scheduler](queue, params)
        chosen = served_first(priority, queue.requests.client, arrival, params.ties)
        end_ms = clock_ms + pool.service_ms[chosen]
        taken = (jnp.arange(n) == chosen) & active
        return (waiting & ~taken, jnp.where(taken, end_ms, finish_ms), jnp.where(active, end_ms, free_ms)), None

    begin = (pool.waiting, jnp.full(n, jnp.nan, jnp.float32), free_ms)
    (waiting, finish_ms, free_ms), _ = jax.lax.scan(serve, begin, None, length=decisions)
    return finish_ms, pool._replace(waiting=waiting), free_ms


def _queue(pool: Pool, arrived: jax.Array, arrival: jax.Array, clock_ms: jax.Array, mission: Mission) -> Queue:
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
        arrival=arrival,
    )

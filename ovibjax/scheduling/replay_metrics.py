"""What a replay of the edge queue is judged by: latency, stale feedback, weighted cost.

The paper's tables look at the tenth of the requests that are worth most (Section "Multi-Client Scheduling").
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.scheduling.clients import Workload
from ovibjax.scheduling.rules import SchedulerParams, scheduling_value

_TOP_SHARE = 0.1
"""Share of the requests that the paper calls high-value, by scheduling value."""

_TAIL = 0.05
"""Share above a 95th percentile."""


class GroupMetrics(NamedTuple):
    """Scheduling metrics of a group of requests; NaN for an empty one.

    Attributes:
        edge_p95_ms: 95th percentile of waiting plus service.
        e2e_p95_ms: 95th percentile of encoding, transmission, waiting and service.
        stale_m: mean stale-feedback penalty, drift rate times end-to-end latency.
        cost: mean weighted cost, scheduling value times end-to-end latency over relative deadline.
        edge_cost: the same with the edge latency, waiting and service, which is what deadlines count.
    """

    edge_p95_ms: jax.Array
    e2e_p95_ms: jax.Array
    stale_m: jax.Array
    cost: jax.Array
    edge_cost: jax.Array


class ReplayMetrics(NamedTuple):
    """Metrics of the tenth of the requests with the largest scheduling value, and of all."""

    top: GroupMetrics
    every: GroupMetrics


def metrics(workload: Workload, wait_ms: jax.Array, params: SchedulerParams) -> ReplayMetrics:
    """Latencies, stale-feedback penalty and weighted cost of one replay.

    The response latency D_j of the cost counts from the observation, as the delay of the penalty does. The paper does
    not say so; its table does. From VOI-Lyapunov to Base-DPP the edge p95 grows 137.7 / 32.8 = 4.2 times and the
    penalty, which counts the uplink, 0.022 / 0.012 = 1.83 times: a cost at the edge would grow more than the penalty,
    and it grows 1.82 / 1.12 = 1.63 times.

    Args:
        workload: leaves [J].
        wait_ms: [J] waits of its replay, as `queue_replay.waits` gives them.
        params: scalars; only the coefficients of the scheduling value are used.

    Returns:
        Scalars.
    """
    r = workload.requests
    valid = jnp.asarray(r.valid, bool)
    voi, drift, risk, delay, urgency, deadline_ms, service_ms = (
        jnp.asarray(leaf, jnp.float32)
        for leaf in (
            *(r.voi_m, r.drift_m_per_s, r.risk_m, r.delay_est_ms),
            *(r.urgency, r.deadline_ms, r.service_ms),
        )
    )
    value = scheduling_value(voi, drift, risk, delay, urgency, params.value)
    edge_ms = wait_ms + service_ms
    e2e_ms = workload.uplink_ms + edge_ms
    stale_m = drift * e2e_ms / 1000.0
    cost, edge_cost = (value * latency_ms / deadline_ms for latency_ms in (e2e_ms, edge_ms))

    def group(members: jax.Array) -> GroupMetrics:
        count = jnp.sum(members.astype(jnp.float32))
        means = (jnp.sum(jnp.where(members, each, 0.0)) / count for each in (stale_m, cost, edge_cost))
        return GroupMetrics(_upper_percentile(edge_ms, members), _upper_percentile(e2e_ms, members), *means)

    return ReplayMetrics(group(_top(value, valid)), group(valid))


def _top(value: jax.Array, valid: jax.Array) -> jax.Array:
    """The tenth of the valid requests, rounded up, with the largest values; equals of the last are included."""
    most = -(-value.size // round(1 / _TOP_SHARE))
    largest = jax.lax.top_k(jnp.where(valid, value, -jnp.inf), most)[0]
    count = jnp.ceil(_TOP_SHARE * jnp.sum(valid.astype(jnp.float32)) - 1e-4).astype(jnp.int32)
    return valid & (value >= largest[jnp.maximum(count - 1, 0)])


def _upper_percentile(values: jax.Array, members: jax.Array) -> jax.Array:
    """95th percentile of the members by linear interpolation, from the largest values only: no sort of them all."""
    kept = min(values.size, int(_TAIL * values.size) + 2)
    largest = jax.lax.top_k(jnp.where(members, values, -jnp.inf), kept)[0]
    count = jnp.sum(members.astype(jnp.float32))
    from_top = jnp.maximum(_TAIL * (count - 1.0), 0.0)
    upper = jnp.floor(from_top)
    at = upper.astype(jnp.int32)
    above, below = largest[at], largest[jnp.minimum(at + 1, kept - 1)]
    fraction = from_top - upper
    between = jnp.where(fraction > 0, above + fraction * (below - above), above)
    return jnp.where(count > 0, between, jnp.nan)

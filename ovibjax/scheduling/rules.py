"""Five rules for the next request to serve (paper, Section "VOI-Weighted Edge Scheduling").

A rule gives every request a priority; the server takes the largest, among equals as `ties` says. FIFO, EDF and
VOI-Lyapunov choose among all waiting requests, MaxWeight and Base-DPP among each client's head of line.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.errors import InputError
from ovibjax.scheduling.requests import Requests
from ovibjax.scheduling.ties import TIES

PAPER_V = 8.0
"""Weight of the VOI against the backlog in Base-DPP (paper, Section "Multi-Client Scheduling")."""

PAPER_WEIGHTS = (3.2, 1.2, 1.2, 1.4, 0.6, 0.1)
"""(w_v, w_r, w_l, w_a, w_o, w_s) of VOI-Lyapunov (paper, after eq. "voi_scheduler_impl")."""

PAPER_VALUE = (0.1, 1.8, 0.22, 0.006)
"""Floor, and coefficients of drift, risk and latency (paper, eq. "scheduler_value")."""


class ValueCoefficients(NamedTuple):
    """Numbers of eq. "scheduler_value", which turn drift, risk and latency into metres of VOI.

    Attributes:
        floor: least scheduling value.
        drift: weight of the drift rate, s.
        risk: weight of the local risk.
        delay: weight of the predicted latency, m/ms.
    """

    floor: jax.Array
    drift: jax.Array
    risk: jax.Array
    delay: jax.Array


class Weights(NamedTuple):
    """Weights (w_v, w_r, w_l, w_a, w_o, w_s) of eq. "voi_scheduler_impl".

    Attributes:
        value_per_service: value over estimated service time.
        value: value.
        laxity: shortness of the remaining margin.
        age: waiting age.
        overrun: predicted overrun.
        service: shortness of the estimated service time.
    """

    value_per_service: jax.Array
    value: jax.Array
    laxity: jax.Array
    age: jax.Array
    overrun: jax.Array
    service: jax.Array


class SchedulerParams(NamedTuple):
    """Every number of the rules; all are leaves that can be swept.

    Attributes:
        V: weight of the VOI against the backlog in Base-DPP.
        weights: weights of VOI-Lyapunov.
        value: coefficients of its scheduling value.
        ties: int32 index into `TIES`, who is served among requests of equal priority.
    """

    V: jax.Array
    weights: Weights
    value: ValueCoefficients
    ties: jax.Array


class Queue(NamedTuple):
    """State of the edge queue at a decision.

    Attributes:
        requests: leaves [W], part of the trace, sorted by arrival, that holds all waiting requests.
        clock: int32 ticks.
        waiting: [W] bool, arrived and not served.
        head: [W] bool, head of its client's line.
        backlog: [W] float32, waiting requests Q of its client, itself included; for rules of `BY_CLIENT`.
        arrival: [W] int32, place in the order of arrival, no two the same.
    """

    requests: Requests
    clock: jax.Array
    waiting: jax.Array
    head: jax.Array
    backlog: jax.Array
    arrival: jax.Array


Rule = Callable[[Queue, SchedulerParams], jax.Array]


def default_params(ties: str = "arrival") -> SchedulerParams:
    """The paper's numbers: V = 8, weights (3.2, 1.2, 1.2, 1.4, 0.6, 0.1), value (0.1, 1.8, 0.22, 0.006).

    Args:
        ties: one of `TIES`; the paper does not say which.

    Returns:
        Scalars.

    Raises:
        InputError: another word for ties.
    """
    if ties not in TIES:
        raise InputError(f"ties {ties!r} is unknown; it must be one of {', '.join(TIES)}")
    return SchedulerParams(
        V=jnp.float32(PAPER_V),
        weights=Weights(*map(jnp.float32, PAPER_WEIGHTS)),
        value=ValueCoefficients(*map(jnp.float32, PAPER_VALUE)),
        ties=jnp.int32(TIES.index(ties)),
    )


def scheduling_value(
    voi_m: jax.Array,
    drift_m_per_s: jax.Array,
    risk_m: jax.Array,
    delay_est_ms: jax.Array,
    urgency: jax.Array,
    coefficients: ValueCoefficients,
) -> jax.Array:
    """Mission-weighted scheduling value of requests (paper, eq. "scheduler_value").

    Args:
        voi_m: [...] predicted net VOI.
        drift_m_per_s: [...] drift rate.
        risk_m: [...] local risk.
        delay_est_ms: [...] predicted latency.
        urgency: [...] mission urgency.
        coefficients: scalars.

    Returns:
        [...] float32 metres, at least the floor.
    """
    c = coefficients
    metres = voi_m + c.drift * drift_m_per_s + c.risk * risk_m - c.delay * delay_est_ms
    return jnp.maximum(c.floor, urgency * metres)


def timing(age: jax.Array, slack: jax.Array, per_deadline: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Laxity, normalized age and normalized overrun of waiting requests (paper, after eq. "voi_scheduler_impl").

    Args:
        age: [...] time since arrival; NaN stays NaN.
        slack: [...] relative deadline less estimated service time, the unit of `age`.
        per_deadline: [...] one over the relative deadline.

    Returns:
        Laxity in the unit of `age`, age and overrun in relative deadlines.
    """
    late = age - slack
    overrun = jax.lax.select(late < 0, jnp.zeros_like(late), late)
    return overrun - late, age * per_deadline, overrun * per_deadline


def term_scales(low: Sequence[jax.Array], high: Sequence[jax.Array], weights: Weights) -> list[jax.Array]:
    """Factor of each term in the score: weight over range, zero where the range is zero.

    Args:
        low: smallest value over the waiting requests of (v / G, v, laxity, age, overrun, G).
        high: largest value.
        weights: weights in the same order.

    Returns:
        Six factors, negative for the terms of which little is good.
    """
    signed = weights._replace(laxity=-weights.laxity, service=-weights.service)
    scales = []
    for least, most, weight in zip(low, high, signed, strict=True):
        span = most - least
        some = span > 0
        scale = jnp.broadcast_to(weight, span.shape) / jax.lax.select(some, span, jnp.ones_like(span))
        scales.append(jax.lax.select(some, scale, jnp.zeros_like(scale)))
    return scales


def weighted_sum(terms: Sequence[jax.Array], scales: Sequence[jax.Array]) -> jax.Array:
    """Score of eq. "voi_scheduler_impl" up to a constant that all waiting requests share.

    Min-max normalization subtracts the least value of each term; the differences between scores do not need it.
    """
    total = scales[0] * terms[0]
    for scale, term in zip(scales[1:], terms[1:], strict=True):
        total = total + scale * term
    return total


def _among(candidates: jax.Array, priority: jax.Array) -> jax.Array:
    return jnp.where(candidates, priority, -jnp.inf)


def fifo(queue: Queue, params: SchedulerParams) -> jax.Array:
    """First in, first out; no two requests tie: equal arrival times go by their order in the trace, whatever `ties`.

    Args:
        queue: the queue.
        params: not used.

    Returns:
        [W] float32 priority, -inf where a request may not be served.
    """
    del params
    return _among(queue.waiting, -queue.arrival.astype(jnp.float32))


def edf(queue: Queue, params: SchedulerParams) -> jax.Array:
    """Earliest absolute deadline first, equal ones tie; arguments and result as in `fifo`."""
    del params
    return _among(queue.waiting, -queue.requests.due)


def maxweight(queue: Queue, params: SchedulerParams) -> jax.Array:
    """Longest backlog first, Base-DPP at V = 0; arguments and result as in `fifo`."""
    return base_dpp(queue, params._replace(V=jnp.zeros_like(params.V)))


def base_dpp(queue: Queue, params: SchedulerParams) -> jax.Array:
    """Head-of-line requests by Q + V nu (paper, eq. "voi_scheduler" for one request); arguments as in `fifo`."""
    return _among(queue.head, queue.backlog + params.V * queue.requests.voi_m)


def voi_lyapunov(queue: Queue, params: SchedulerParams) -> jax.Array:
    """The shaped rule over all waiting requests (paper, eq. "voi_scheduler_impl"); arguments as in `fifo`."""
    r = queue.requests
    value = scheduling_value(r.voi_m, r.drift_m_per_s, r.risk_m, r.delay_est_ms, r.urgency, params.value)
    age = (queue.clock - r.ready).astype(jnp.float32)
    terms = (value / r.service_est_ms, value, *timing(age, r.slack, r.per_deadline), r.service_est_ms)
    low = [jnp.min(term, where=queue.waiting, initial=jnp.inf) for term in terms]
    high = [jnp.max(term, where=queue.waiting, initial=-jnp.inf) for term in terms]
    return _among(queue.waiting, weighted_sum(terms, term_scales(low, high, params.weights)))


RULES: dict[str, Rule] = {
    "fifo": fifo,
    "edf": edf,
    "maxweight": maxweight,
    "base_dpp": base_dpp,
    "voi_lyapunov": voi_lyapunov,
}
"""Scheduling rules by name."""

POLICIES = tuple(RULES)
"""Names of the scheduling rules; the argument `policy` of a queue replay is one of them."""

BY_CLIENT = ("maxweight", "base_dpp")
"""Rules that choose among heads of line."""

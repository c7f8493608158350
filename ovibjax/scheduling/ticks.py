"""The clock of a queue replay: times in whole milliseconds and a fraction, counted in integer ticks.

A float32 clock loses the quarter of a millisecond after an hour. Times are therefore taken apart into whole
milliseconds and a fraction of 2^-20 ms (a nanosecond), exact for float32 and for float64 inputs, and the replay
counts int32 ticks from the first arrival. A tick is 2^-shift ms, the finest power of two at which arrivals and services
of the whole trace fit 31 bits: 0.24 microseconds for the paper's route of 296.5 s, 2 microseconds for an hour.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.scheduling.requests import LONGEST_MS, NEVER, Numbers, Requests, RequestTrace

_FINE = 20
_FINE_PER_MS = 1 << _FINE
_HORIZON_TICKS = 2.0**30.9  # below 2^31, for rounding of services and of this estimate


class Split(NamedTuple):
    """Times in two int32 parts.

    Attributes:
        whole: [...] milliseconds, rounded down.
        fine: [...] the rest in units of 2^-20 ms.
    """

    whole: jax.Array
    fine: jax.Array


class SplitTrace(NamedTuple):
    """A trace whose times are exact; the attributes are those of `RequestTrace`, service as integers, G in float32."""

    client: jax.Array
    ready: Split
    service: Split
    service_est_ms: jax.Array
    deadline: Split
    deadline_ms: jax.Array
    voi_m: jax.Array
    drift_m_per_s: jax.Array
    risk_m: jax.Array
    delay_est_ms: jax.Array
    urgency: jax.Array
    valid: jax.Array


def split_times(trace: RequestTrace) -> SplitTrace:
    """Convert a trace of any leading axes without loss of time resolution.

    Args:
        trace: leaves [..., J].

    Returns:
        The same requests with int32 times; values of padding are replaced by harmless ones.
    """
    valid = jnp.asarray(trace.valid, bool)

    def floats(values: Numbers, padding: float = 0.0) -> jax.Array:
        return jnp.where(valid, jnp.asarray(values, jnp.float32), padding)

    longest = np.float64(LONGEST_MS) if isinstance(trace.deadline_ms, np.ndarray) else jnp.float32(LONGEST_MS)
    deadline_ms = trace.deadline_ms.clip(max=longest)
    return SplitTrace(
        client=jnp.where(valid, jnp.asarray(trace.client).astype(jnp.int32), -1),
        ready=_split(trace.ready_ms, trace.valid),
        service=_split(trace.service_ms, trace.valid),
        service_est_ms=floats(trace.service_est_ms, 1.0),
        deadline=_split(deadline_ms, trace.valid),
        deadline_ms=floats(deadline_ms, 1.0),
        voi_m=floats(trace.voi_m),
        drift_m_per_s=floats(trace.drift_m_per_s),
        risk_m=floats(trace.risk_m),
        delay_est_ms=floats(trace.delay_est_ms),
        urgency=floats(trace.urgency),
        valid=valid,
    )


def sort_requests(trace: SplitTrace) -> Requests:
    """Sort one trace by arrival and count its times in ticks.

    Args:
        trace: leaves [J].

    Returns:
        The sorted requests.
    """
    order = jnp.lexsort((trace.ready.fine, trace.ready.whole, ~trace.valid))
    t: SplitTrace = jax.tree.map(lambda leaf: leaf[order], trace)
    first = jnp.where(t.valid[0], t.ready.whole[0], 0)
    shift = _shift(t, first)
    tick_ms = _power_of_two(-shift)
    ready = _ticks(Split(t.ready.whole - first, t.ready.fine), shift)
    per_tick = _power_of_two(shift)
    previous, group = _same_client(t.client)
    return Requests(
        position=order.astype(jnp.int32),
        valid=t.valid,
        client=t.client,
        ready=jnp.where(t.valid, ready, NEVER),
        service=jnp.where(t.valid, _ticks(t.service, shift), 0),
        slack=(t.deadline_ms - t.service_est_ms) * per_tick,
        per_deadline=tick_ms / t.deadline_ms,
        service_est_ms=t.service_est_ms,
        due=_due_rank(t),
        voi_m=t.voi_m,
        drift_m_per_s=t.drift_m_per_s,
        risk_m=t.risk_m,
        delay_est_ms=t.delay_est_ms,
        urgency=t.urgency,
        previous=previous,
        group=group,
        total=jnp.sum(t.valid.astype(jnp.int32)),
        tick_ms=tick_ms,
    )


def _split(values_ms: Numbers, valid: Numbers) -> Split:
    """Take times apart, in float64 where they are NumPy arrays of it."""
    if isinstance(values_ms, np.ndarray) and isinstance(valid, np.ndarray):
        exact = np.where(valid, np.asarray(values_ms, np.float64), 0.0)
        floor = np.floor(exact)
        rest = np.rint((exact - floor) * _FINE_PER_MS).astype(np.int32)
        return Split(jnp.asarray(floor.astype(np.int32) + (rest >> _FINE)), jnp.asarray(rest & (_FINE_PER_MS - 1)))
    values = jnp.where(jnp.asarray(valid, bool), jnp.asarray(values_ms, jnp.float32), 0.0)
    whole = jnp.floor(values)
    fine = jnp.rint((values - whole) * _FINE_PER_MS).astype(jnp.int32)
    return Split(whole.astype(jnp.int32) + (fine >> _FINE), fine & (_FINE_PER_MS - 1))


def _power_of_two(exponent: jax.Array) -> jax.Array:
    """Exact 2^exponent, which the exponential function need not give."""
    return jax.lax.bitcast_convert_type((exponent + 127) << 23, jnp.float32)


def _shift(trace: SplitTrace, first: jax.Array) -> jax.Array:
    last = jnp.max(jnp.where(trace.valid, trace.ready.whole - first, 0)).astype(jnp.float32)
    busy = jnp.sum(trace.service.whole.astype(jnp.float32) + trace.service.fine.astype(jnp.float32) / _FINE_PER_MS)
    shift = jnp.floor(jnp.log2(_HORIZON_TICKS / (last + busy + 2.0)))
    return jnp.clip(shift, 0, _FINE).astype(jnp.int32)


def _ticks(time: Split, shift: jax.Array) -> jax.Array:
    drop = _FINE - shift
    half = (1 << drop) >> 1
    return (time.whole << shift) + ((time.fine + half) >> drop)


def _due_rank(trace: SplitTrace) -> jax.Array:
    """Dense rank of absolute deadlines, from their exact sums: only equal ones share a rank."""
    fine = trace.ready.fine + trace.deadline.fine
    whole = trace.ready.whole + trace.deadline.whole + (fine >> _FINE)
    due = Split(whole, fine & (_FINE_PER_MS - 1))
    order = jnp.lexsort((due.fine, due.whole, ~trace.valid))
    whole, fine = due.whole[order], due.fine[order]
    later = (whole[1:] != whole[:-1]) | (fine[1:] != fine[:-1])
    rank = jnp.concatenate([jnp.zeros(1, jnp.int32), jnp.cumsum(later, dtype=jnp.int32)])
    return rank[jnp.argsort(order)].astype(jnp.float32)


def _same_client(client: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Positions of the previous and of the first request of each request's client."""
    grouped = jnp.argsort(client).astype(jnp.int32)
    of = client[grouped]
    starts = jnp.concatenate([jnp.ones(1, bool), of[1:] != of[:-1]])
    before = jnp.concatenate([jnp.full(1, -1, jnp.int32), grouped[:-1]])
    first = grouped[jax.lax.cummax(jnp.where(starts, jnp.arange(client.size, dtype=jnp.int32), 0))]
    back = jnp.argsort(grouped)
    return jnp.where(starts, -1, before)[back], first[back]

"""The clock of a queue replay: times in whole milliseconds and a fraction, counted in integer ticks.

A float32 clock loses the quarter of a millisecond after an hour. Times are therefore taken apart into whole
milliseconds and a fraction of 2^-20 ms (a nanosecond), exact for float32 and for float64 inputs, and the replay
counts int32 ticks from the first arrival. A tick is 2^-shift ms, the finest power of two at which arrivals and services
of the whole trace fit 31 bits: 0.24 microseconds for the paper's route of 296.5 s, 2 microseconds for an hour.

Traces of NumPy arrays are taken apart and put in order on the host, where 64-bit keys sort ten times as fast as several
32-bit ones do in a compiled program on a CPU.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.scheduling.requests import LONGEST_MS, NEVER, Numbers, Requests, RequestTrace

_FINE = 20
_FINE_PER_MS = 1 << _FINE
_NUMBERED = 1 << 12  # times and positions up to this fit 63 bits: times are 51 bits in size, see `LONGEST_MS`
_AFTER_ALL = np.int64((1 << 50) + 1)
_HORIZON_TICKS = 2.0**30.9  # below 2^31, for rounding of services and of this estimate


class Split(NamedTuple):
    """Times in two int32 parts.

    Attributes:
        whole: [...] milliseconds, rounded down.
        fine: [...] the rest in units of 2^-20 ms.
    """

    whole: Numbers
    fine: Numbers


class SplitTrace(NamedTuple):
    """A trace whose times are exact; the other attributes are those of `RequestTrace`.

    Attributes:
        ready: [..., J] of each request.
        service: [..., J]; its estimate stays a float.
        deadline: [..., J].
        order: [..., J] int32 positions by arrival, equal arrivals by index, padding last.
    """

    client: Numbers
    ready: Split
    service: Split
    service_est_ms: Numbers
    deadline: Split
    deadline_ms: Numbers
    voi_m: Numbers
    drift_m_per_s: Numbers
    risk_m: Numbers
    delay_est_ms: Numbers
    urgency: Numbers
    valid: Numbers
    order: Numbers


def split_times(trace: RequestTrace | SplitTrace) -> SplitTrace:
    """Take the times of a trace apart without loss, and order its requests by arrival.

    Args:
        trace: leaves [..., J]; one that has been taken apart stays as it is.

    Returns:
        The same requests; times of padding are zero.
    """
    if isinstance(trace, SplitTrace):
        return trace
    ready = _split(trace.ready_ms, trace.valid)
    longest = np.float64(LONGEST_MS) if isinstance(trace.deadline_ms, np.ndarray) else jnp.float32(LONGEST_MS)
    deadline_ms = trace.deadline_ms.clip(max=longest)
    times = {"ready": ready, "service": _split(trace.service_ms, trace.valid), "deadline_ms": deadline_ms}
    fields = {name: leaf for name, leaf in trace._asdict().items() if name in SplitTrace._fields} | times
    return SplitTrace(**fields, deadline=_split(deadline_ms, trace.valid), order=_order(ready, trace.valid))


def split_on_host(trace: RequestTrace) -> RequestTrace | SplitTrace:
    """What a compiled program is called with: a trace of JAX arrays as it is, another one taken apart."""
    return trace if all(isinstance(leaf, jax.Array) for leaf in trace) else split_times(trace)


def sort_requests(trace: SplitTrace) -> Requests:
    """Sort one trace by arrival and count its times in ticks.

    Args:
        trace: leaves [J].

    Returns:
        The sorted requests; numbers of padding are harmless ones.
    """
    t: Any = jax.tree.map(lambda leaf: leaf[trace.order], trace)
    valid = t.valid.astype(bool)

    def floats(values: jax.Array, padding: float = 0.0) -> jax.Array:
        return jnp.where(valid, values.astype(jnp.float32), padding)

    client = jnp.where(valid, t.client.astype(jnp.int32), -1)
    service_est_ms, deadline_ms = floats(t.service_est_ms, 1.0), floats(t.deadline_ms, 1.0)
    first = jnp.where(valid[0], t.ready.whole[0], 0)
    shift = _shift(t, first)
    tick_ms = _power_of_two(-shift)
    ready = _ticks(Split(t.ready.whole - first, t.ready.fine), shift)
    per_tick = _power_of_two(shift)
    previous, group = _same_client(client)
    return Requests(
        position=jnp.asarray(trace.order),
        valid=valid,
        client=client,
        ready=jnp.where(valid, ready, NEVER),
        service=jnp.where(valid, _ticks(t.service, shift), 0),
        slack=(deadline_ms - service_est_ms) * per_tick,
        per_deadline=tick_ms / deadline_ms,
        service_est_ms=service_est_ms,
        due=_due_rank(t),
        voi_m=floats(t.voi_m),
        drift_m_per_s=floats(t.drift_m_per_s),
        risk_m=floats(t.risk_m),
        delay_est_ms=floats(t.delay_est_ms),
        urgency=floats(t.urgency),
        previous=previous,
        group=group,
        total=jnp.sum(valid.astype(jnp.int32)),
        tick_ms=tick_ms,
    )


def _split(values_ms: Numbers, valid: Numbers) -> Split:
    """Take times apart, in float64 where they are NumPy arrays of it."""
    if isinstance(values_ms, np.ndarray) and isinstance(valid, np.ndarray):
        # At most 2^50 in size: exact.
        exact = np.rint(np.where(valid, values_ms, 0.0) * np.float64(_FINE_PER_MS)).astype(np.int64)
        return Split((exact >> _FINE).astype(np.int32), (exact & (_FINE_PER_MS - 1)).astype(np.int32))
    values = jnp.where(jnp.asarray(valid, bool), jnp.asarray(values_ms, jnp.float32), 0.0)
    whole = jnp.floor(values)
    fine = jnp.rint((values - whole) * _FINE_PER_MS).astype(jnp.int32)
    return Split(whole.astype(jnp.int32) + (fine >> _FINE), fine & (_FINE_PER_MS - 1))


def _order(time: Split, valid: Numbers) -> Numbers:
    """[..., J] int32 positions by time, equal times by position, padding last."""
    if isinstance(time.whole, np.ndarray) and isinstance(valid, np.ndarray):
        key = (time.whole.astype(np.int64) << _FINE) + time.fine
        size = key.shape[-1]
        if size > _NUMBERED:
            return np.argsort(np.where(valid, key, np.iinfo(np.int64).max), axis=-1, stable=True).astype(np.int32)
        # Keys that end in their position sort more than twice as fast as positions by keys.
        key = np.where(valid, key, _AFTER_ALL) * _NUMBERED + np.arange(size)
        key.sort(axis=-1)
        return (key & (_NUMBERED - 1)).astype(np.int32)
    return jnp.lexsort((time.fine, time.whole, ~jnp.asarray(valid, bool))).astype(jnp.int32)


def _power_of_two(exponent: jax.Array) -> jax.Array:
    """Exact 2^exponent, which the exponential function need not give."""
    return jax.lax.bitcast_convert_type((exponent + 127) << 23, jnp.float32)


def _shift(trace: Any, first: jax.Array) -> jax.Array:
    last = jnp.max(jnp.where(trace.valid, trace.ready.whole - first, 0)).astype(jnp.float32)
    busy = jnp.sum(trace.service.whole.astype(jnp.float32) + trace.service.fine.astype(jnp.float32) / _FINE_PER_MS)
    shift = jnp.floor(jnp.log2(_HORIZON_TICKS / (last + busy + 2.0)))
    return jnp.clip(shift, 0, _FINE).astype(jnp.int32)


def _ticks(time: Any, shift: jax.Array) -> jax.Array:
    drop = _FINE - shift
    half = (1 << drop) >> 1
    return (time.whole << shift) + ((time.fine + half) >> drop)


def _due_rank(trace: Any) -> jax.Array:
    """[J] float32 dense rank of absolute deadlines, from their exact sums: only equal ones share a rank."""
    fine = trace.ready.fine + trace.deadline.fine
    whole = trace.ready.whole + trace.deadline.whole + (fine >> _FINE)
    due = Split(whole, fine & (_FINE_PER_MS - 1))
    order = _order(due, trace.valid)
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

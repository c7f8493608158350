"""Requests that reach the edge server, and the clock they are replayed on (paper, "Multi-Client Scheduling").

A float32 clock loses the quarter of a millisecond after an hour. Times are therefore taken apart into whole
milliseconds and a fraction of 2^-20 ms (a nanosecond), exact for float32 and for float64 inputs, and the replay
counts int32 ticks from the first arrival. A tick is 2^-shift ms, the finest power of two at which arrivals and services
of the whole trace fit 31 bits: 0.24 microseconds for the paper's route of 296.5 s, 2 microseconds for an hour.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from ovibjax.errors import InputError

Numbers = jax.Array | npt.NDArray[Any]

NEVER = np.int32(2**31 - 1)
"""A tick after every event."""

_FINE = 20
_FINE_PER_MS = 1 << _FINE
_HORIZON_TICKS = 2.0**30.9  # below 2^31, for rounding of services and of this estimate
_LONGEST_MS = float(1 << 30)


class RequestTrace(NamedTuple):
    """Requests of all clients of one edge server, in any order.

    Attributes:
        client: [J] int, client that sent it.
        ready_ms: [J] time at which it joins the edge queue; float64 NumPy arrays keep their precision.
        service_ms: [J] time it occupies the server.
        service_est_ms: [J] estimate G of that time, which is all the scheduler knows, positive.
        deadline_ms: [J] relative deadline, from `ready_ms`, positive.
        voi_m: [J] predicted net VOI, metres.
        drift_m_per_s: [J] fitted drift rate.
        risk_m: [J] local risk, metres.
        delay_est_ms: [J] predicted latency.
        urgency: [J] mission urgency omega, positive.
        valid: [J] bool, false for padding, which is never served.
    """

    client: Numbers
    ready_ms: Numbers
    service_ms: Numbers
    service_est_ms: Numbers
    deadline_ms: Numbers
    voi_m: Numbers
    drift_m_per_s: Numbers
    risk_m: Numbers
    delay_est_ms: Numbers
    urgency: Numbers
    valid: Numbers


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


class Requests(NamedTuple):
    """Requests sorted by arrival, equal arrivals by index, padding last; what a scheduling rule sees.

    Attributes:
        position: [J] int32 position in the trace.
        valid: [J] bool.
        client: [J] int32.
        ready: [J] int32 ticks since the first whole millisecond of the trace; `NEVER` for padding.
        service: [J] int32 ticks.
        slack: [J] float32 ticks, relative deadline less estimated service time.
        per_deadline: [J] float32, one over the relative deadline in ticks.
        service_est_ms: [J] float32.
        due: [J] float32, rank of the absolute deadline, first is 0; equal deadlines share none: the earlier arrival
            comes first.
        voi_m: [J] float32.
        drift_m_per_s: [J] float32.
        risk_m: [J] float32.
        delay_est_ms: [J] float32.
        urgency: [J] float32.
        previous: [J] int32 sorted position of the same client's request before this one, -1 for its first.
        group: [J] int32 sorted position of the same client's first request.
        total: int32 number of valid requests.
        tick_ms: float32 length of a tick, a power of two.
    """

    position: jax.Array
    valid: jax.Array
    client: jax.Array
    ready: jax.Array
    service: jax.Array
    slack: jax.Array
    per_deadline: jax.Array
    service_est_ms: jax.Array
    due: jax.Array
    voi_m: jax.Array
    drift_m_per_s: jax.Array
    risk_m: jax.Array
    delay_est_ms: jax.Array
    urgency: jax.Array
    previous: jax.Array
    group: jax.Array
    total: jax.Array
    tick_ms: jax.Array


def is_concrete(trace: RequestTrace) -> bool:
    """Whether the trace holds numbers, not the symbols of a transformation."""
    return not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(trace))


def check(trace: RequestTrace) -> None:
    """Refuse a trace that cannot be replayed; of a trace inside a transformation only the shapes are looked at.

    Raises:
        InputError: shapes that differ, times or estimates that are not finite, out of range, or not positive.
    """
    shapes = {name: np.shape(leaf) for name, leaf in trace._asdict().items()}
    for name, shape in shapes.items():
        if shape != shapes["valid"] or not shape or 0 in shape:
            raise InputError(f"{name} has shape {shape} and valid {shapes['valid']}; give one or more requests each")
    if not is_concrete(trace):
        return
    valid = np.asarray(trace.valid, bool)
    bounds = {"ready_ms": -_LONGEST_MS, "service_ms": 0.0, "service_est_ms": 0.0, "deadline_ms": 0.0}
    for name, least in bounds.items():
        values = np.asarray(getattr(trace, name), np.float64)
        bad = ~(np.isfinite(values) & (values >= least) & (values <= _LONGEST_MS)) & valid
        if name.endswith(("est_ms", "deadline_ms")):
            bad |= (values <= 0) & valid
        if bad.any():
            at = tuple(int(i) for i in np.argwhere(bad)[0])
            rule = "positive" if name.endswith(("est_ms", "deadline_ms")) else f"at least {least:g}"
            where = at[0] if len(at) == 1 else at
            raise InputError(f"{name}[{where}] is {values[at]}; it must be {rule} and at most {_LONGEST_MS:.0f} ms")


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

    longest = np.float64(_LONGEST_MS) if isinstance(trace.deadline_ms, np.ndarray) else jnp.float32(_LONGEST_MS)
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
    """Rank of absolute deadlines, from their exact sums."""
    fine = trace.ready.fine + trace.deadline.fine
    whole = trace.ready.whole + trace.deadline.whole + (fine >> _FINE)
    order = jnp.lexsort((fine & (_FINE_PER_MS - 1), whole, ~trace.valid))
    return jnp.argsort(order).astype(jnp.float32)


def _same_client(client: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Positions of the previous and of the first request of each request's client."""
    grouped = jnp.argsort(client).astype(jnp.int32)
    of = client[grouped]
    starts = jnp.concatenate([jnp.ones(1, bool), of[1:] != of[:-1]])
    before = jnp.concatenate([jnp.full(1, -1, jnp.int32), grouped[:-1]])
    first = grouped[jax.lax.cummax(jnp.where(starts, jnp.arange(client.size, dtype=jnp.int32), 0))]
    back = jnp.argsort(grouped)
    return jnp.where(starts, -1, before)[back], first[back]

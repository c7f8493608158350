"""Requests that reach the edge server: a trace of them, and what a scheduling rule sees of it.

Paper, Section "Multi-Client Scheduling". How the times of a trace become ticks of a clock is in `ticks`.
"""

from typing import Any, NamedTuple

import jax
import numpy as np
import numpy.typing as npt

from ovibjax.errors import InputError

Numbers = jax.Array | npt.NDArray[Any]

NEVER = np.int32(2**31 - 1)
"""A tick after every event."""

LONGEST_MS = float(1 << 30)
"""Largest time of a trace, twelve days."""


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
        due: [J] float32, dense rank of the absolute deadline, the first is 0; equal deadlines share one.
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
    bounds = {"ready_ms": -LONGEST_MS, "service_ms": 0.0, "service_est_ms": 0.0, "deadline_ms": 0.0}
    for name, least in bounds.items():
        values = np.asarray(getattr(trace, name), np.float64)
        bad = ~(np.isfinite(values) & (values >= least) & (values <= LONGEST_MS)) & valid
        if name.endswith(("est_ms", "deadline_ms")):
            bad |= (values <= 0) & valid
        if bad.any():
            at = tuple(int(i) for i in np.argwhere(bad)[0])
            rule = "positive" if name.endswith(("est_ms", "deadline_ms")) else f"at least {least:g}"
            where = at[0] if len(at) == 1 else at
            raise InputError(f"{name}[{where}] is {values[at]}; it must be {rule} and at most {LONGEST_MS:.0f} ms")

"""Random request traces of all shapes, and what the event loop makes of them.

Every time is a multiple of 1/64 ms, so that any clock adds them exactly.
"""

import numpy as np

from ovibjax.scheduling.requests import RequestTrace
from tests.oracles import scheduling as oracle

CERTAIN = 1e-5
"""Gap between two priorities above which rounding to float32 cannot exchange them."""

KINDS = ("spread", "burst", "ties", "gaps", "overload", "twins", "hour", "single", "empty", "deadlines")


def on_grid(values_ms):
    """Rounded to 1/64 ms."""
    return np.rint(np.asarray(values_ms, np.float64) * 64) / 64


def random_trace(seed, n=40, kind="burst"):
    """Float64 trace of n requests, some of them padding."""
    rng = np.random.default_rng(seed)
    clients = int(rng.integers(1, 9))
    spans = {"burst": 60.0, "hour": 3.6e6, "overload": 30.0, "gaps": 4000.0}
    ready = rng.uniform(0, spans.get(kind, 600.0), n)
    if kind in ("ties", "deadlines"):
        ready = 50.0 * rng.integers(0, 6, n)
    if kind == "hour":
        ready = np.repeat(ready[: n // 4 + 1], 4)[:n] + rng.uniform(0, 30, n)
    service = rng.choice([10.0, 12.5, 17.0], n) if kind == "ties" else rng.uniform(2, 30, n)
    deadline = rng.choice([50.0, 100.0, 150.0], n) if kind == "deadlines" else rng.uniform(20, 300, n)
    voi = rng.integers(0, 8, n) / 8 if kind == "ties" else rng.uniform(0.5, 6, n)
    valid = rng.random(n) < 0.9
    if kind == "single":
        valid = np.arange(n) == rng.integers(n)
    if kind == "empty":
        valid = np.zeros(n, bool)
    trace = RequestTrace(
        client=rng.integers(0, clients, n).astype(np.int32),
        ready_ms=on_grid(ready),
        service_ms=on_grid(service),
        service_est_ms=on_grid(rng.choice([16.0, 17.0, 17.5, 18.25], n)),
        deadline_ms=on_grid(deadline),
        voi_m=voi.astype(np.float32),
        drift_m_per_s=rng.uniform(0.3, 7.6, n).astype(np.float32),
        risk_m=rng.uniform(5, 9, n).astype(np.float32),
        delay_est_ms=rng.uniform(20, 200, n).astype(np.float32),
        urgency=rng.uniform(0.5, 2, n).astype(np.float32),
        valid=valid,
    )
    if kind == "twins":  # every other request is like the one before in all but its index and its service
        twin = np.arange(n) // 2 * 2
        trace = RequestTrace(*(leaf[twin] for leaf in trace))._replace(service_ms=trace.service_ms, valid=trace.valid)
    return trace


def stack(traces):
    """Leaves [R, J]."""
    return RequestTrace(*(np.stack(leaves) for leaves in zip(*traces, strict=True)))


def take(traces, row):
    """One trace of a stack."""
    return RequestTrace(*(leaf[row] for leaf in traces))


def expected_waits(trace, policy, **numbers):
    """Waits [J] by the event loop; NaN for padding."""
    starts, _, gap = oracle.replay(trace, policy, **numbers)
    assert gap > CERTAIN, "rounding decides: choose another seed"
    found = np.full(len(trace.valid), np.nan)
    for index, start in starts.items():
        found[index] = start - trace.ready_ms[index]
    return found

"""The same requests, measured and modelled: an edge's log replayed under the rule that served it.

The replay is given what the log has of each request, and the time that it kept the edge: its service, and what the edge
did between the one before and it (`turn_ms`: packing the last answer, reading what came, choosing). A difference to the
measurement is then one of order, or of arrivals that the edge noticed late.
"""

import numpy as np

from ovibjax.live.log_report import Floats, Run, edge_ms, percentile, top_decile
from ovibjax.scheduling.queue_replay import replay
from ovibjax.scheduling.requests import RequestTrace
from ovibjax.scheduling.rules import default_params

_LEAST_MS = 1e-3


def trace_of(run: Run) -> RequestTrace:
    """The answered requests of an edge as a trace for the replay.

    Args:
        run: a run of an edge with at least one answered request.

    Returns:
        Leaves [J], in the order of the log; times from the first arrival.
    """
    columns = {
        name: run.column(name)
        for name in ("deadline_ms", "voi_m", "drift_m_per_s", "risk_m", "delay_est_ms", "urgency")
    }
    ready_ms = 1000.0 * run.column("ready_s")
    return RequestTrace(
        client=run.column("client").astype(np.int32),
        ready_ms=ready_ms - ready_ms.min(),
        service_ms=run.column("service_ms") + run.column("turn_ms"),
        service_est_ms=np.maximum(run.column("service_est_ms"), _LEAST_MS),
        valid=np.ones(len(ready_ms), bool),
        **columns | {"deadline_ms": np.maximum(columns["deadline_ms"], 1.0)},
    )


def modelled_ms(run: Run, rule: str | None = None) -> Floats:
    """[J] waiting plus service of an edge's answered requests, as the replay has them.

    Args:
        run: a run of an edge with at least one answered request.
        rule: one of `scheduling.rules.POLICIES`; by default the one that served them.

    Returns:
        Milliseconds, in the order of the log.
    """
    return replayed_ms(trace_of(run), rule or run.name)


def replayed_ms(trace: RequestTrace, rule: str) -> Floats:
    """[J] waiting plus service of a trace under a rule with the paper's numbers, in ms."""
    found = replay(trace, rule, default_params())
    return np.asarray(found.finish_ms, np.float64) - np.asarray(trace.ready_ms, np.float64)


def side_by_side(run: Run) -> dict[str, float]:
    """Percentiles of an edge's latency, measured and modelled, in ms.

    Args:
        run: a run of an edge.

    Returns:
        `edge_p95_ms`, `modelled_p95_ms`, `top_p95_ms`, `modelled_top_p95_ms`; NaN where nothing was answered.
    """
    measured_ms, top = edge_ms(run), top_decile(run)
    model_ms = modelled_ms(run) if measured_ms.size else measured_ms
    return {
        "edge_p95_ms": percentile(measured_ms, 95),
        "modelled_p95_ms": percentile(model_ms, 95),
        "top_p95_ms": percentile(measured_ms[top], 95),
        "modelled_top_p95_ms": percentile(model_ms[top], 95),
    }

"""One load at one live edge: what was measured of each request, and three replays of the same requests beside it.

The replays differ in what they are told. `planned` knows what can be known before anybody is asked: when requests are
due, and how long each is to take. `service` is given the service times of the live run instead, and when requests left
the load generator. `kept` is given all the time that a request kept the edge: its service, and the dispatch before it
(packing the last answer, writing the log, reading what came, choosing), which a request that an idle edge takes at once
waits for too.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ovibjax.cards.live_load import OfferedLoad
from ovibjax.errors import InputError
from ovibjax.live.log_report import Run, edge_ms, percentile, top_decile
from ovibjax.live.modelled import replayed_ms, trace_of
from ovibjax.live.open_loop import Offered
from ovibjax.live.pacing import Pace

Floats = npt.NDArray[np.float64]

MODELS = {
    "planned": "before the run",
    "service": "given service times",
    "kept": "given service and dispatch",
}
"""The replays and what they are given, in words."""

SCOPES = ("all", "top10")
"""Requests that are judged: all, and the tenth with the largest scheduling value."""

PARTS = ("unpack", "queue", "dispatch", "decode", "retrieve", "wait", "pack")
"""Where the edge's time on a request goes: `dispatch` is part of `queue`, `wait` what makes it as slow as the paper's;
decoding, retrieval and wait are the service."""


@dataclass(frozen=True)
class LiveRun:
    """One load at one edge; arrays [J] in the order in which requests were due, times in ms.

    Attributes:
        uplink_ms: encoding and transmission, which the load waited for.
        late_ms: how late the load generator was.
        noticed_ms: from due to the edge's note of the arrival.
        service_ms: service.
        planned_ms: how long the service was to take.
        answered_ms: from due to the answer.
        edge_ms: waiting plus service, as the edge tells.
        top: of the tenth with the largest scheduling value.
        parts: times by `PARTS`.
        models: waiting plus service in the replays, by `MODELS`.
        share_busy: share of the time that requests kept the edge.
    """

    uplink_ms: Floats
    late_ms: Floats
    noticed_ms: Floats
    service_ms: Floats
    planned_ms: Floats
    answered_ms: Floats
    edge_ms: Floats
    top: npt.NDArray[np.bool_]
    parts: dict[str, Floats]
    models: dict[str, Floats]
    share_busy: float

    def latency_ms(self, source: str) -> Floats:
        """[J] waiting plus service, of `live` or of a replay."""
        return self.edge_ms if source == "live" else self.models[source]

    def end_to_end_ms(self, source: str) -> Floats:
        """[J] from observation to answer: uplink, and what follows; a replay knows waiting and service alone."""
        return self.uplink_ms + (self.answered_ms if source == "live" else self.models[source])

    def p95_ms(self, source: str, scope: str = "all") -> float:
        """95th percentile of waiting plus service of a scope of `SCOPES`."""
        return percentile(self.latency_ms(source)[self.top if scope == "top10" else slice(None)], 95)


def run_of(log: Run, offered: OfferedLoad, sent: Offered, pace: Pace) -> LiveRun:
    """Put together what the edge's log and the load generator have of the same requests, and replay them.

    Args:
        log: the run of the edge; requests that are not of the load were its warm-up.
        offered: the load.
        sent: what became of it.
        pace: of the edge.

    Returns:
        The run.

    Raises:
        InputError: a request was not answered.
    """
    load = offered.load
    keys = list(zip(load.client.tolist(), load.sequence.tolist(), strict=True))
    mine = in_order(log, keys)
    due_ms, left_ms = (1000.0 * (at_s - at_s[0]) for at_s in (sent.due_s, sent.sent_s))
    planned = zip(offered.mode, keys, strict=True)
    planned_ms = np.array([pace.least_ms(mode, *key) for mode, key in planned])
    service_ms, turn_ms = mine.column("service_ms"), mine.column("turn_ms")
    decode_ms, retrieve_ms = mine.column("decode_ms"), mine.column("retrieve_ms")
    trace, kept_ms = trace_of(mine), service_ms + turn_ms
    given = {"planned": (due_ms, planned_ms), "service": (left_ms, service_ms), "kept": (left_ms, kept_ms)}
    traces = {name: trace._replace(ready_ms=at_ms, service_ms=ms) for name, (at_ms, ms) in given.items()}
    ready_s = mine.column("ready_s")
    ended_s = ready_s + edge_ms(mine) / 1000.0
    return LiveRun(
        uplink_ms=offered.uplink_ms,
        late_ms=sent.late_ms,
        noticed_ms=1000.0 * (ready_s - sent.due_s),
        service_ms=service_ms,
        planned_ms=planned_ms,
        answered_ms=1000.0 * (sent.answered_s - sent.due_s),
        edge_ms=edge_ms(mine),
        top=top_decile(mine),
        parts={
            "unpack": mine.column("unpack_ms"),
            "queue": mine.column("queue_ms"),
            "dispatch": turn_ms,
            "decode": decode_ms,
            "retrieve": retrieve_ms,
            "wait": np.maximum(service_ms - decode_ms - retrieve_ms, 0.0),
            "pack": mine.column("pack_ms"),
        },
        models={name: replayed_ms(trace, mine.name) for name, trace in traces.items()},
        share_busy=float(kept_ms.sum() / (1000.0 * (ended_s.max() - ready_s.min()))),
    )


def in_order(log: Run, keys: Sequence[tuple[int, int]]) -> Run:
    """The answered requests of a run with these clients and sequence numbers, in this order.

    Raises:
        InputError: one of them was not answered.
    """
    by_key = {(e["client"], e["sequence"]): e for e in log.events if e["status"] == "ok"}
    missing = sum(key not in by_key for key in keys)
    if missing:
        raise InputError(f"the edge ({log.name}) did not serve {missing} of {len(keys)} requests: {dict(log.ended)}")
    return Run(log.source, log.start, [by_key[key] for key in keys])

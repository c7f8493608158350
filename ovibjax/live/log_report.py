"""What the logs of edges and robots say: runs, how their requests ended, latencies, stages, route errors."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from ovibjax.errors import InputError, refusal
from ovibjax.live.request_log import read_log
from ovibjax.scheduling.rules import default_params, scheduling_value

STAGES = ("unpack", "queue", "turn", "decode", "retrieve", "pack")
"""Parts of an edge's time on a request, as its log names them; `turn` is part of `queue`: the edge was free, or had
just become so, but had not begun yet."""

TOP_SHARE = 0.1
"""Share of the requests that counts as high-value, by scheduling value (paper, Section "Multi-Client Scheduling")."""

_VALUE = ("voi_m", "drift_m_per_s", "risk_m", "delay_est_ms", "urgency")
_TRACE = (*_VALUE, "client", "ready_s", "deadline_ms", "service_est_ms", "queue_ms", "service_ms", "turn_ms")

Floats = npt.NDArray[np.float64]


@dataclass
class Run:
    """One run of an edge or of robots, from its `start` on.

    Attributes:
        source: the file.
        start: the event that began it.
        events: requests of an edge, or questions of robots.
        tracks: errors along routes, of robots.
        refused: connections that an edge refused or dropped.
        finished: whether it came to its end; a killed one did not.
    """

    source: Path
    start: dict[str, Any]
    events: list[dict[str, Any]] = field(default_factory=list)
    tracks: list[dict[str, Any]] = field(default_factory=list)
    refused: int = 0
    finished: bool = False

    @property
    def is_edge(self) -> bool:
        """Whether it is a run of an edge, not of robots."""
        return self.start["side"] == "edge"

    @property
    def name(self) -> str:
        """The rule of an edge, the policy of robots."""
        return str(self.start.get("rule" if self.is_edge else "policy"))

    @property
    def ended(self) -> Counter[str]:
        """How requests or questions ended."""
        return Counter(event["status"] for event in self.events)

    def column(self, name: str, status: str | None = "ok") -> Floats:
        """Values of a field, of those that ended in one way; those that lack it are left out."""
        events = [event for event in self.events if status is None or event["status"] == status]
        return np.array([event[name] for event in events if event.get(name) is not None], np.float64)


_SIDES = {"request": "edge", "refused": "edge", "question": "robots", "track": "robots"}


def read_runs(paths: Iterable[Path]) -> list[Run]:
    """Runs in the order in which they began, log by log.

    Args:
        paths: logs of `ovibjax edge serve` and `drive`; one file may hold both sides.

    Returns:
        The runs.

    Raises:
        InputError: a file that cannot be read, is no log, or holds no run.
    """
    runs: list[Run] = []
    for path in paths:
        latest: dict[str, Run] = {}
        for event in read_log(path):
            _add(path, event, runs, latest)
        if not latest:
            raise refusal(path, "no run begins in it; it is no log of ovibjax edge serve or drive")
    return runs


def _add(path: Path, event: dict[str, Any], runs: list[Run], latest: dict[str, Run]) -> None:
    kind = event["event"]
    if kind == "start" and event.get("side") in ("edge", "robots"):
        latest[event["side"]] = Run(path, event)
        runs.append(latest[event["side"]])
        return
    if kind == "summary":
        side = "robots" if "ended" in event else "edge"
        if side in latest:
            latest[side].finished = True
        return
    run = latest.get(_SIDES.get(kind, ""))
    if run is None:
        return
    if kind in ("request", "question"):
        _check(path, event)
        run.events.append(event)
    elif kind == "track":
        run.tracks.append(event)
    else:
        run.refused += 1 + int(event.get("untold") or 0)


def _check(path: Path, event: dict[str, Any]) -> None:
    """Refuse an event that lacks what every table needs."""
    numbers = _TRACE if event["event"] == "request" else ("client", "sequence")
    if not isinstance(event.get("status"), str) or not all(isinstance(event.get(n), int | float) for n in numbers):
        raise refusal(path, f"a {event['event']} without its fields; the log is damaged")


def edge_ms(run: Run) -> Floats:
    """[J] waiting plus service of the answered requests of an edge."""
    return run.column("queue_ms") + run.column("service_ms")


def top_decile(run: Run) -> npt.NDArray[np.bool_]:
    """[J] which answered requests are of the tenth with the largest scheduling value."""
    voi_m, drift_m_per_s, risk_m, delay_ms, urgency = (jnp.asarray(run.column(n), jnp.float32) for n in _VALUE)
    found = scheduling_value(voi_m, drift_m_per_s, risk_m, delay_ms, urgency, default_params().value)
    value = np.asarray(found)
    if not value.size:
        return np.zeros(0, bool)
    return value >= np.sort(value)[-int(np.ceil(TOP_SHARE * value.size))]


def edge_rows(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """A row per run of an edge: how requests ended, rate, percentiles in ms."""
    rows = []
    for run in runs:
        found, latency_ms = run.ended, edge_ms(run)
        ready_s = run.column("ready_s", None)
        span_s = float(np.ptp(ready_s)) if ready_s.size > 1 else np.nan
        rows.append(
            {
                "rule": run.name,
                "requests": found.total(),
                "ok": found["ok"],
                "expired": found["expired"],
                "other": found.total() - found["ok"] - found["expired"],
                "refused": run.refused,
                "per_s": found.total() / span_s if span_s > 0 else np.nan,
                "edge_p50_ms": percentile(latency_ms, 50),
                "edge_p95_ms": percentile(latency_ms, 95),
                "edge_p99_ms": percentile(latency_ms, 99),
                "top_p95_ms": percentile(latency_ms[top_decile(run)], 95),
                **{f"{stage}_ms": percentile(run.column(f"{stage}_ms"), 50) for stage in STAGES},
                "killed": not run.finished,
            }
        )
    return rows


def robot_rows(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """A row per run of robots: how questions ended, latencies in ms, route error in m."""
    rows = []
    for run in runs:
        found, errors_m = run.ended, route_errors_m(run)
        rows.append(
            {
                "policy": run.name,
                "robots": len({track["client"] for track in run.tracks}),
                "questions": found.total(),
                "ok": found["ok"],
                "expired": found["expired"],
                "timeout": found["timeout"],
                "other": found.total() - found["ok"] - found["expired"] - found["timeout"],
                "uplink_p50_ms": percentile(run.column("uplink_ms"), 50),
                "e2e_p50_ms": percentile(run.column("e2e_ms"), 50),
                "e2e_p95_ms": percentile(run.column("e2e_ms"), 95),
                "error_mean_m": float(np.nanmean(errors_m)) if errors_m.size else np.nan,
                "error_p95_m": float(np.nanpercentile(errors_m, 95)) if errors_m.size else np.nan,
                "killed": not run.finished,
            }
        )
    return rows


def route_errors_m(run: Run) -> Floats:
    """[robots, slots] errors along the routes; NaN after a robot's end."""
    by_robot: dict[int, list[float]] = {}
    for track in sorted(run.tracks, key=lambda track: track["first_slot"]):
        by_robot.setdefault(track["client"], []).extend(track["errors_m"])
    longest = max(map(len, by_robot.values()), default=0)
    return np.array([row + [np.nan] * (longest - len(row)) for _, row in sorted(by_robot.items())])


def agreement(edges: Sequence[Run], robots: Sequence[Run]) -> dict[str, int] | None:
    """How far both sides tell the same: None where one of them is missing.

    Args:
        edges: runs of edges.
        robots: runs of robots.

    Returns:
        `questions` of robots, `answered` ones that the edge also has as answered in the same way, `unknown` ones that
        say otherwise or that the edge does not have, `unanswered` ones that got no answer, and `unasked` requests of
        the edge that no robot asked.
    """
    if not edges or not robots:
        return None
    known = Counter((event["client"], event["sequence"], event["status"]) for run in edges for event in run.events)
    asked = [event for run in robots for event in run.events]
    told = [event for event in asked if event["status"] not in ("timeout", "lost", "unsent")]
    same = sum(known[event["client"], event["sequence"], event["status"]] > 0 for event in told)
    mine = {(event["client"], event["sequence"]) for event in asked}
    strangers = sum((event["client"], event["sequence"]) not in mine for run in edges for event in run.events)
    return {
        "questions": len(asked),
        "answered": same,
        "unknown": len(told) - same,
        "unanswered": len(asked) - len(told),
        "unasked": strangers,
    }


def percentile(values: Floats, percent: float) -> float:
    """A percentile; NaN of nothing."""
    return float(np.percentile(values, percent)) if values.size else np.nan


def sides(runs: Sequence[Run]) -> tuple[list[Run], list[Run]]:
    """Runs of edges, and runs of robots.

    Raises:
        InputError: there is nothing in them.
    """
    edges = [run for run in runs if run.is_edge and run.events]
    robots = [run for run in runs if not run.is_edge and (run.events or run.tracks)]
    if not edges and not robots:
        raise InputError("the logs hold no request and no question; drive robots first: ovibjax edge drive")
    return edges, robots

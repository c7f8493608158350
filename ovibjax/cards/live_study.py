"""Live edges and robots beside the replay: sizes, and the runs of every rule at every load, in turns."""

import asyncio
import socket
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from ovibjax.cards.control_study import PRESETS, drives_of
from ovibjax.cards.job import Job, NotHere
from ovibjax.cards.live_load import OfferedLoad, Recorded, all_at_once, poisson_load, recorded_requests
from ovibjax.cards.live_routes import LiveRoutes, drive_routes
from ovibjax.cards.live_runs import LiveRun, in_order, run_of
from ovibjax.control.environment import PAPER_SLOTS, SLOT_S
from ovibjax.live.connection import Limits
from ovibjax.live.edge_file import load_edge, save_edge
from ovibjax.live.edge_process import EdgeProcess, edges_running
from ovibjax.live.edge_server import EdgeOptions
from ovibjax.live.exporting import make_edge
from ovibjax.live.log_report import read_runs
from ovibjax.live.open_loop import Offered, offer
from ovibjax.live.pacing import Pace
from ovibjax.live.robot_process import RobotJob
from ovibjax.runtime.progress import console, progress_bar

LOADS = {"low": 0.4, "high": 0.9}
"""Share of the edge's time that requests are to take, by load."""

PACE = Pace(paper_speed=1.0)
"""An edge as slow as the paper's: decoding and retrieval take a fraction of a millisecond here."""

RATE_KB_PER_S = 4.0
"""Uplink of the robots, the slowest of the paper's profiles."""

PATIENCE_S = 60.0
_DEAREST = "voi_lyapunov"  # of the rules, for choosing
_IN_FLIGHT = 4096  # an open loop does not wait for answers


@dataclass(frozen=True)
class LiveSize:
    """Size of the study.

    Attributes:
        rules: scheduling rules.
        clients: clients of a load.
        repetitions: runs of each rule at each load, with requests of their own.
        seconds: length of a run by load.
        robots: robots that drive routes.
        route_s: how long they drive, in the world's time.
        speed: how much faster than ours that is.
    """

    rules: tuple[str, ...]
    clients: int
    repetitions: int
    seconds: dict[str, float]
    robots: int
    route_s: float
    speed: float


@dataclass(frozen=True)
class LiveStudy:
    """What was measured.

    Attributes:
        size: its size.
        runs: by load and rule, one per repetition.
        routes: the closed loop.
        kept_ms: what an edge took for a request when the loads were chosen.
        per_s: requests per second by load.
    """

    size: LiveSize
    runs: dict[tuple[str, str], list[LiveRun]]
    routes: LiveRoutes
    kept_ms: float
    per_s: dict[str, float]

    def p95_ms(self, load: str, rule: str, source: str, scope: str = "all") -> np.ndarray:
        """[repetitions] 95th percentile of waiting plus service, `live` or of a replay."""
        return np.array([run.p95_ms(source, scope) for run in self.runs[load, rule]])

    def off(self, load: str, rule: str, source: str, scope: str = "all") -> np.ndarray:
        """[repetitions] by how much of the live p95 a replay's is above it."""
        return self.p95_ms(load, rule, source, scope) / self.p95_ms(load, rule, "live", scope) - 1.0

    def every(self, load: str | None = None) -> list[LiveRun]:
        """All runs, or those at one load."""
        return [run for (at, _), runs in self.runs.items() for run in runs if load in (None, at)]


def measure(job: Job, size: LiveSize) -> LiveStudy:
    """Make an edge file, record what robots ask, and run every rule at every load, then the closed loop.

    Args:
        job: the card's job.
        size: how much.

    Returns:
        What was measured.

    Raises:
        NotHere: this machine has no loopback sockets.
        InputError: a process that fails.
    """
    require_loopback()
    with job.stage("render"), progress_bar("rendering the routes", 1) as update:
        drives, training = drives_of(job.preset, job.own_drive, update)
    with TemporaryDirectory(prefix="ovibjax-live-") as name:
        folder = Path(name)
        path = folder / "edge.npz"
        with job.stage("train"), console.status("training the encoder, surveying the scene"):
            save_edge(path, make_edge(drives, training, PRESETS[job.preset].checkpoint))
            file = load_edge(path)
        drive = RobotJob(str(path), "127.0.0.1", 1, tuple(range(size.clients)), seed=job.seed)
        drive = replace(drive, profile_kb_per_s=RATE_KB_PER_S, seconds=PAPER_SLOTS * SLOT_S)
        with job.stage("replay"), console.status("replaying the robots"):
            recorded = recorded_requests(drive, file)
        bench = _Bench(path, folder, recorded, size, job.seed)
        with job.stage("time"), progress_bar("asking live edges", bench.steps) as update:
            runs, kept_ms, per_s = asyncio.run(bench.all(update))
        driven = replace(drive, clients=tuple(range(size.robots)), seconds=size.route_s, speed=size.speed)
        with job.stage("time"), console.status(f"driving {size.robots} robots for {size.route_s / size.speed:.0f} s"):
            routes = asyncio.run(drive_routes(path, file, driven, folder))
    return LiveStudy(size, runs, routes, kept_ms, per_s)


def require_loopback() -> None:
    """Refuse a machine on which processes cannot talk to each other.

    Raises:
        NotHere: it offers no sockets at 127.0.0.1.
    """
    try:
        with socket.create_server(("127.0.0.1", 0)) as server:
            socket.create_connection(server.getsockname(), timeout=5.0).close()
    except OSError as error:
        reason = error.strerror or error
        raise NotHere(
            f"this machine offers no sockets at 127.0.0.1 ({reason}), over which edge and robots talk"
        ) from error


class _Bench:
    """Runs of edges, one asked at a time."""

    def __init__(
        self, path: Path, folder: Path, recorded: Sequence[Sequence[Recorded]], size: LiveSize, seed: int
    ) -> None:
        self._path, self._folder, self._recorded, self._size, self._seed = path, folder, recorded, size, seed
        self.steps = 1 + size.repetitions * len(LOADS) * len(size.rules)

    async def all(
        self, update: Callable[[int], None]
    ) -> tuple[dict[tuple[str, str], list[LiveRun]], float, dict[str, float]]:
        """Every repetition of every load; the rules take turns, in an order that is drawn anew each time."""
        size, rng = self._size, np.random.default_rng(self._seed)
        kept_ms = await self._kept_ms()
        update(1)
        per_s = {load: 1000.0 * share / kept_ms for load, share in LOADS.items()}
        runs: dict[tuple[str, str], list[LiveRun]] = {(load, rule): [] for load in LOADS for rule in size.rules}
        done = 1
        for repetition in range(size.repetitions):
            for at, load in enumerate(LOADS):
                number = 1 + len(LOADS) * repetition + at
                seed = (self._seed + repetition, at)
                offered = poisson_load(seed, self._recorded, per_s[load], size.seconds[load], number)
                order = [size.rules[i] for i in rng.permutation(len(size.rules))]
                edges = {rule: self._edge(rule, f"{number}-{rule}") for rule in order}
                sent = {}
                async with edges_running(self._path, list(edges.values())):
                    for rule in order:
                        sent[rule] = await offer(edges[rule].port, offered.load, PATIENCE_S)
                        done += 1
                        update(done)
                for rule in size.rules:
                    runs[load, rule].append(self._seen(edges[rule], offered, sent[rule]))
        return runs, kept_ms, per_s

    async def _kept_ms(self) -> float:
        """Mean time that a request keeps an edge at which many wait, under the rule that takes longest to choose."""
        edge, offered = self._edge(_DEAREST, "first"), all_at_once(self._recorded, 20 * min(3, self._size.clients), 0)
        async with edges_running(self._path, [edge]):
            await offer(edge.port, offered.load, PATIENCE_S)
        (log,) = read_runs([edge.log])
        keys = zip(offered.load.client.tolist(), offered.load.sequence.tolist(), strict=True)
        mine = in_order(log, list(keys))
        return float(np.mean(mine.column("service_ms") + mine.column("turn_ms")))

    def _edge(self, rule: str, name: str) -> EdgeProcess:
        options = EdgeOptions(rule, expire=False, pace=PACE, limits=Limits(in_flight=_IN_FLIGHT))
        return EdgeProcess(options, self._folder / f"{name}.jsonl")

    @staticmethod
    def _seen(edge: EdgeProcess, offered: OfferedLoad, sent: Offered) -> LiveRun:
        (log,) = read_runs([edge.log])
        return run_of(log, offered, sent, PACE)

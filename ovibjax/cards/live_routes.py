"""Robots in processes of their own that drive their routes with a live edge, and the replay of the same routes.

Request control is replayed without an edge: a wait is drawn for every slot, with a median that is assumed. What robots
ask depends on it, as a request is worth less the later its answer comes. So the routes are replayed twice: with the
waits that the replay assumes, and with their median as the live edge had it.
"""

import asyncio
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from ovibjax.control.environment import SLOT_S
from ovibjax.control.route_replay import replay_draws
from ovibjax.errors import InputError
from ovibjax.live.connection import Limits
from ovibjax.live.edge_file import EdgeFile
from ovibjax.live.edge_process import EdgeProcess, edges_running
from ovibjax.live.edge_server import EdgeOptions
from ovibjax.live.fleet import drive_fleet
from ovibjax.live.log_report import percentile, read_runs, route_errors_m
from ovibjax.live.pacing import Pace
from ovibjax.live.request_log import RequestLog
from ovibjax.live.robot_process import RobotJob, robot_of, world_of

_PER_PROCESS, _PROCESSES = 10, 2
_LEAST_MS = 1e-3


@dataclass(frozen=True)
class ReplayedRoutes:
    """Routes as request control replays them.

    Attributes:
        error_m: [robots, slots] distance of estimate and truth.
        latency_ms: [questions] from decision to correction.
        wait_ms: median wait at the edge.
    """

    error_m: npt.NDArray[np.float64]
    latency_ms: npt.NDArray[np.float64]
    wait_ms: float


@dataclass(frozen=True)
class LiveRoutes:
    """Routes that were driven, and replayed.

    Attributes:
        live_m: [robots, slots] distance of estimate and truth, driven.
        given: the replay with the same draws, and the live edge's median wait.
        assumed: the replay with the same draws, and the median wait that it assumes.
        ended: questions by how they ended, driven.
        wait_ms: median wait at the live edge, in the world's time.
        e2e_p95_ms: from decision to answer in the world's time, driven.
    """

    live_m: npt.NDArray[np.float64]
    given: "ReplayedRoutes"
    assumed: "ReplayedRoutes"
    ended: Counter[str]
    wait_ms: float
    e2e_p95_ms: float

    @property
    def time_s(self) -> npt.NDArray[np.float64]:
        """[slots] ends of the slots."""
        return SLOT_S * np.arange(1, self.live_m.shape[1] + 1)


async def drive_routes(path: Path, file: EdgeFile, job: RobotJob, folder: Path) -> LiveRoutes:
    """Drive the robots of a job at a live edge as fast as the paper's, and replay them.

    Args:
        path: the edge file.
        file: its content.
        job: the job; its port and log are set here.
        folder: for logs.

    Returns:
        Both.

    Raises:
        InputError: an edge or a robot that fails.
    """
    options = EdgeOptions("voi_lyapunov", pace=Pace(paper_speed=job.speed), limits=Limits(in_flight=64))
    edge, log = EdgeProcess(options, folder / "routes-edge.jsonl"), folder / "robots.jsonl"
    async with edges_running(path, [edge]):
        told = {**vars(job), "file": str(path), "port": edge.port, "log": str(log)}
        with RequestLog(log) as begun:
            begun.write("start", side="robots", policy=job.policy)
        processes = min(_PROCESSES, -(-len(job.clients) // _PER_PROCESS))
        result = await drive_fleet(RobotJob(**told), processes, asyncio.Event())
    if result.gone:
        raise InputError(f"{len(result.gone)} of {len(job.clients)} robots are gone: their process ended")
    (run,) = read_runs([log])
    waits_ms = job.speed * run.column("queue_ms")
    wait_ms = float(np.median(waits_ms)) if waits_ms.size else 0.0
    return LiveRoutes(
        live_m=route_errors_m(run),
        given=replayed_routes(job, file, max(wait_ms, _LEAST_MS)),
        assumed=replayed_routes(job, file),
        ended=run.ended,
        wait_ms=wait_ms,
        e2e_p95_ms=job.speed * percentile(run.column("e2e_ms"), 95),
    )


def replayed_routes(job: RobotJob, file: EdgeFile, wait_ms: float | None = None) -> ReplayedRoutes:
    """The routes of a job's robots as request control replays them, with the draws of the robots.

    Args:
        job: the job.
        file: the edge file.
        wait_ms: median wait at the edge; None for the one that replays assume.

    Returns:
        Errors and latencies.
    """
    world, errors_m, latencies_ms = world_of(job, file), [], []
    env = world.params.env
    if wait_ms is not None:
        env = env._replace(queue_median_ms=jnp.float32(wait_ms))
        world = replace(world, params=world.params._replace(env=env))
    for number in job.clients:
        robot, _ = robot_of(job, world, number)
        run = replay_draws(robot.draws, robot.route, job.policy, world.params, file.actions)
        errors_m.append(np.asarray(run.error_m, np.float64))
        latencies_ms.append(1000.0 * np.asarray(run.latency_s, np.float64)[np.asarray(run.sent)])
    return ReplayedRoutes(np.array(errors_m), np.concatenate(latencies_ms), float(env.queue_median_ms))

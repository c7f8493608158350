"""Robots in several processes: started, told to go at the same time, listened to, and counted."""

import asyncio
import json
import os
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from ovibjax.errors import InputError
from ovibjax.live.robot_process import RobotJob

_LINE_LIMIT_BYTES = 1 << 20
_START_S, _END_S, _GO_S = 300.0, 30.0, 1.0


@dataclass(frozen=True)
class FleetResult:
    """What became of a fleet.

    Attributes:
        robots: one dictionary per robot that came to its end: `client`, `ended` (questions by how they ended),
            `connections`, `sent_bytes`, `mean_error_m`, `p95_error_m`, `e2e_p50_ms`, `e2e_p95_ms`.
        gone: numbers of robots whose process ended before they did.
    """

    robots: list[dict[str, Any]]
    gone: list[int]

    @property
    def ended(self) -> Counter[str]:
        """Questions of all robots by how they ended."""
        return sum((Counter(robot["ended"]) for robot in self.robots), Counter())


def summary_of(result: FleetResult) -> dict[str, str]:
    """A fleet in a few lines: questions and how they ended, error, latency, traffic."""
    robots, ended = result.robots, result.ended
    words = ", ".join(f"{count} {name}" for name, count in ended.most_common())
    lines = {"robots": str(len(robots)), "questions": f"{ended.total()} ({words})" if ended else "none"}
    if robots:
        means_m, tails_m = ([robot[name] for robot in robots] for name in ("mean_error_m", "p95_error_m"))
        lines["error"] = f"mean {np.mean(means_m):.2f} m, mean of the robots' p95 {np.mean(tails_m):.2f} m"
        lines["sent"] = f"{sum(robot['sent_bytes'] for robot in robots) / 1024:.1f} KB"
    latencies_ms = [robot["e2e_p50_ms"] for robot in robots if robot["e2e_p50_ms"] is not None]
    if latencies_ms:
        lines["answer"] = f"after {np.median(latencies_ms):.1f} ms (median of the robots' medians)"
    lost = sum(robot["connections"].get("disconnected", 0) for robot in robots)
    if lost:
        lines["connections"] = f"{lost} lost"
    return lines


async def drive_fleet(
    job: RobotJob,
    processes: int,
    stop: asyncio.Event,
    on_progress: Callable[[Counter[str], float | None], None] = lambda _, __: None,
) -> FleetResult:
    """Drive the robots of a job in several processes.

    Args:
        job: the job, with the numbers of all robots.
        processes: how many processes.
        stop: set to end it early; the robots end at their next slot.
        on_progress: told how many questions ended in which way so far, and the robots' mean error.

    Returns:
        What became of them.

    Raises:
        InputError: a process could not begin, or met an edge that it cannot use.
    """
    dealt = [tuple(job.clients[first::processes]) for first in range(min(processes, len(job.clients)))]
    members = [_Member(replace(job, clients=clients)) for clients in dealt]
    try:
        async with asyncio.timeout(_START_S):
            await asyncio.gather(*(member.begin() for member in members))
        for member in members:
            member.go()
        followed = [asyncio.ensure_future(member.follow()) for member in members]
        stopping = asyncio.ensure_future(stop.wait())
        telling = asyncio.ensure_future(_tell(members, on_progress))
        try:
            over = asyncio.ensure_future(_all_of(followed))
            waiting: list[asyncio.Future[Any]] = [stopping, over]
            await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
            for member in members:
                member.leave()
            async with asyncio.timeout(_END_S):
                await asyncio.gather(*followed)
        except TimeoutError:
            pass
        finally:
            for task in (stopping, telling, *followed):
                task.cancel()
    finally:
        for member in members:
            await member.end()
    if said := next((member.said for member in members if member.said), None):
        raise InputError(said)
    robots = sorted((robot for member in members for robot in member.robots), key=lambda robot: robot["client"])
    back = {robot["client"] for robot in robots}
    return FleetResult(robots, [number for number in job.clients if number not in back])


class _Member:
    """One process of robots."""

    def __init__(self, job: RobotJob) -> None:
        self.job, self.said = job, ""
        self.robots: list[dict[str, Any]] = []
        self.ended: Counter[str] = Counter()
        self.error_m: float | None = None
        self._process: asyncio.subprocess.Process | None = None

    async def begin(self) -> None:
        """Start it, and wait until it is compiled."""
        environment = {**os.environ, "NPROC": "1"}
        self._process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "ovibjax.live.robot_process"),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            env=environment,
            limit=_LINE_LIMIT_BYTES,
        )
        self._write(json.dumps(asdict(self.job)))
        while (told := await self._line()) is not None:
            if told["event"] == "ready":
                return
            if told["event"] == "error":
                raise InputError(told["said"])
        raise InputError(f"a process of robots ended before it began (code {await self._process.wait()})")

    def go(self) -> None:
        """Let its robots begin."""
        self._write("go")

    async def follow(self) -> None:
        """Listen until it ends."""
        while (told := await self._line()) is not None:
            if told["event"] == "progress":
                self.ended, self.error_m = Counter(told["ended"]), told["error_m"]
            elif told["event"] == "robot":
                self.robots.append(told)
            elif told["event"] == "error":
                self.said = told["said"]

    def leave(self) -> None:
        """Tell it to stop."""
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.close()

    async def end(self) -> None:
        """See that it is over."""
        if self._process is None:
            return
        self.leave()
        # A signal to a process that is just ending would take its exit code from the loop, which says so on the screen.
        with suppress(TimeoutError):
            await asyncio.wait_for(self._process.wait(), _GO_S)
        with suppress(ProcessLookupError):
            if self._process.returncode is None:
                self._process.kill()
        await self._process.wait()

    def _write(self, line: str) -> None:
        assert self._process is not None and self._process.stdin is not None
        self._process.stdin.write(line.encode() + b"\n")

    async def _line(self) -> dict[str, Any] | None:
        assert self._process is not None and self._process.stdout is not None
        line = await self._process.stdout.readline()
        return json.loads(line) if line else None


async def _all_of(tasks: "Sequence[asyncio.Task[None]]") -> None:
    await asyncio.wait(tasks)


async def _tell(members: list[_Member], on_progress: Callable[[Counter[str], float | None], None]) -> None:
    while True:
        await asyncio.sleep(0.5)
        errors_m = [member.error_m for member in members if member.error_m is not None]
        ended: Counter[str] = sum((member.ended for member in members), Counter())
        on_progress(ended, float(np.mean(errors_m)) if errors_m else None)

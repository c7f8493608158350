"""A process of robots: `python -m ovibjax.live.robot_process`, told what to do on standard input, by lines of JSON.

The first line is a job (`RobotJob`). When everything is compiled the process says `ready`; at the line `go` its robots
begin; it says how far they are, then what became of each, and `done`. The end of standard input stops them.
"""

import asyncio
import json
import os
import signal
import sys
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.control.adaptation import ADAPT, ADAPTS, Adaptation, make_adaptation
from ovibjax.control.client_state import ControlParams
from ovibjax.control.controller import (
    GAP_LAMBDA_B_M_PER_S,
    GAP_LAMBDA_D_M_PER_S,
    LAMBDA_B_M_PER_S,
    LAMBDA_D_M_PER_S,
    PAPER_BUDGET_KB,
    make_controller,
)
from ovibjax.control.environment import PAPER_SLOTS, SLOT_S, make_environment
from ovibjax.errors import InputError
from ovibjax.link.trace_files import read_trace
from ovibjax.link.traces import Trace, resample
from ovibjax.live.coded_requests import Sending
from ovibjax.live.edge_file import EdgeFile, load_edge
from ovibjax.live.mode_codes import mode_codes
from ovibjax.live.request_log import RequestLog
from ovibjax.live.robot import Robot, World
from ovibjax.live.robot_driver import Driven, Mission, RobotDriver, WorldClock
from ovibjax.live.robot_link import EdgeAddress, RobotLink
from ovibjax.live.trust import client_tls, read_key
from ovibjax.scheduling.clients import default_trace_params

_TELL_S = 1.0
_LEAST_BUDGET = 0.1  # of a route's, so that a drive of seconds can ask at all
_FRAMES = 64  # of the routes, that the length of a code is guessed from


@dataclass(frozen=True)
class RobotJob:
    """What a process of robots does; plain values, so that it can be written down.

    Attributes:
        file: the edge file.
        host: address of the edge.
        port: its port.
        clients: numbers of the robots.
        policy: one of `robot.LIVE_POLICIES`.
        profile_kb_per_s: mean uplink throughput.
        seconds: how long to drive, in the world's time.
        speed: how much faster than ours the world's time is.
        seed: of everything that is drawn.
        budget_kb: payload allowed over the drive; None for the paper's in proportion to its length.
        trace: a measured throughput trace instead of the profile.
        log: file for a line per question.
        key_file: shared key.
        tls_ca: who signs the edge's certificate.
        tls_cert: the robots' certificate.
        tls_key: its private key.
        code: how prefixes are written, one of `link.codes.CODES`.
        compact: whether under a compact header.
        adapt: what corrects g_psi while they drive, one of `control.adaptation.ADAPT`.
    """

    file: str
    host: str
    port: int
    clients: tuple[int, ...]
    policy: str = "voi"
    profile_kb_per_s: float = 4.0
    seconds: float = 60.0
    speed: float = 1.0
    seed: int = 100
    budget_kb: float | None = None
    trace: str | None = None
    log: str | None = None
    key_file: str | None = None
    tls_ca: str | None = None
    tls_cert: str | None = None
    tls_key: str | None = None
    code: str = "float32"
    compact: bool = False
    adapt: str = "none"

    @property
    def slots(self) -> int:
        """Slots that each robot drives."""
        return max(1, round(self.seconds / SLOT_S))

    def path(self, name: str) -> Path | None:
        """A file of the job, or None."""
        value = getattr(self, name)
        return None if value is None else Path(value)

    def address(self, file: EdgeFile) -> EdgeAddress:
        """The edge, and what robots must know of it.

        Raises:
            InputError: a key or certificate that cannot be used.
        """
        tls = client_tls(self.path("tls_ca"), self.path("tls_cert"), self.path("tls_key"))
        return EdgeAddress(self.host, self.port, file.fingerprint, read_key(self.path("key_file")), tls)


def sending_of(job: RobotJob, file: EdgeFile) -> Sending:
    """How the robots of a job write their requests.

    Raises:
        InputError: a code that the file has no table for.
    """
    if job.code == "float32" and not job.compact:
        return Sending()
    coders = file.coders
    if job.code not in coders:
        raise InputError(f"--code {job.code}: {job.file} knows {', '.join(coders)}; make it anew: ovibjax edge export")
    return Sending(coders[job.code], job.compact)


def world_of(job: RobotJob, file: EdgeFile) -> World:
    """The world that all robots of a job share."""
    env = make_environment(file.context_share, job.profile_kb_per_s)
    prices = (LAMBDA_B_M_PER_S, LAMBDA_D_M_PER_S)
    if job.policy == "voi_gap":
        prices = (GAP_LAMBDA_B_M_PER_S, GAP_LAMBDA_D_M_PER_S)
    budget_kb = job.budget_kb
    if budget_kb is None:
        budget_kb = PAPER_BUDGET_KB * max(job.slots / PAPER_SLOTS, _LEAST_BUDGET)
    sending = sending_of(job, file)
    if sending.coder is not None:
        some = file.route_x[:: max(1, len(file.route_x) // _FRAMES)]
        codes = mode_codes(file.params, file.arch, some, file.actions)
        sizes_bytes = sending.sizes_bytes(file.actions, codes)
        file = replace(file, actions=replace(file.actions, sizes_bytes=sizes_bytes))
    control = make_controller(file.actions, *prices, budget_kb=budget_kb)
    return World(file, ControlParams(env, control, adaptation_of(job, file)), job.policy, job.slots, job.adapt)


def adaptation_of(job: RobotJob, file: EdgeFile) -> Adaptation | None:
    """The numbers of the robots' adaptation; None where they do not adapt.

    Raises:
        InputError: an unknown way to adapt, a policy that does not look at what adapts, or a file without the numbers.
    """
    if job.adapt == "none":
        return None
    if job.adapt not in ADAPT:
        raise InputError(f"--adapt {job.adapt}: ways to adapt are {', '.join(ADAPT)}")
    if job.policy not in ADAPTS:
        raise InputError(f"--adapt {job.adapt}: policy {job.policy} asks alike whatever it learns; take {ADAPTS[0]}")
    if job.adapt not in file.expected_m:
        raise InputError(
            f"--adapt {job.adapt}: {job.file} does not say what to expect; make it anew: ovibjax edge export"
        )
    return make_adaptation(job.adapt, file.expected_m[job.adapt])


def robot_of(job: RobotJob, world: World, number: int, trace: Trace | None = None) -> tuple[Robot, Mission]:
    """A robot of a job and its mission; both depend on the job's seed and the robot's number alone.

    Args:
        job: the job.
        world: of it.
        number: the robot's number.
        trace: measured throughput; each robot begins at another place of it.

    Returns:
        The two.
    """
    key = jax.random.key(job.seed)
    robot = Robot(world, number, key)
    if trace is not None:
        start_s = trace.duration_s * (number * 0.618034 % 1.0)
        robot.draws = robot.draws._replace(rate_bps=jnp.asarray(resample(trace, SLOT_S, job.slots, start_s)))
    urgency_key, deadline_key, phase_key = jax.random.split(jax.random.fold_in(key, 65536 + number), 3)
    given = default_trace_params()
    span_ms = given.deadline_high_ms - given.deadline_low_ms
    deadlines_ms = given.deadline_low_ms + span_ms * jax.random.uniform(deadline_key, (job.slots,))
    mission = Mission(
        urgency=float(given.urgency_low + (given.urgency_high - given.urgency_low) * jax.random.uniform(urgency_key)),
        deadlines_ms=np.asarray(deadlines_ms),
        phase_s=SLOT_S * float(jax.random.uniform(phase_key)),
        timeout_s=float(world.params.env.timeout_s),
    )
    return robot, mission


def _say(event: str, **fields: Any) -> None:
    print(json.dumps({"event": event, **fields}), flush=True)


def _told(driver: RobotDriver, link: RobotLink, number: int) -> dict[str, Any]:
    driven: Driven = driver.driven
    return {
        "client": number,
        "ended": dict(driven.ended),
        "connections": dict(link.counts),
        "why": link.why,
        "sent_bytes": driven.sent_bytes,
        "mean_error_m": float(np.mean(driven.errors_m)),
        "p95_error_m": float(np.percentile(driven.errors_m, 95)),
        "e2e_p50_ms": driven.e2e_ms.percentile_ms(50) if driven.e2e_ms.count else None,
        "e2e_p95_ms": driven.e2e_ms.percentile_ms(95) if driven.e2e_ms.count else None,
    }


async def run_robots(job: RobotJob, lines: asyncio.StreamReader) -> None:
    """Drive the robots of a job.

    Args:
        job: the job.
        lines: standard input after the job.

    Raises:
        InputError: a file that cannot be used, or an edge that these robots cannot use.
    """
    file = load_edge(job.file)
    world, address, sending = world_of(job, file), job.address(file), sending_of(job, file)
    trace = None if job.trace is None else read_trace(Path(job.trace))
    robot_of(job, world, 0)[0].warm_up()
    made = [(number, *robot_of(job, world, number, trace)) for number in job.clients]
    loop, stop = asyncio.get_running_loop(), asyncio.Event()
    for pressed in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(pressed, stop.set)
    _say("ready")
    if await lines.readline() != b"go\n":
        return
    watching = asyncio.ensure_future(_stop_at_end(lines, stop))
    with RequestLog(job.path("log")) as log:
        clock = WorldClock(loop.time(), job.speed)
        links = [RobotLink(address, number) for number, _, _ in made]
        drivers = [
            RobotDriver(robot, link, mission, clock, log, sending)
            for (_, robot, mission), link in zip(made, links, strict=True)
        ]
        connecting = [asyncio.ensure_future(link.stay_connected()) for link in links]
        driving = [asyncio.ensure_future(driver.drive(stop)) for driver in drivers]
        telling = asyncio.ensure_future(_tell(drivers))
        try:
            await _first_failure(driving, connecting)
            for driver, link, (number, _, _) in zip(drivers, links, made, strict=True):
                _say("robot", **_told(driver, link, number))
        finally:
            for task in (telling, watching, *connecting, *driving):
                task.cancel()
            await asyncio.gather(telling, watching, *connecting, *driving, return_exceptions=True)
    _say("done")


async def _first_failure(driving: list["asyncio.Task[Driven]"], connecting: list["asyncio.Task[None]"]) -> None:
    """Wait for all robots; raise what a robot or its connection ran into."""
    waiting: set[asyncio.Task[Any]] = {*driving, *connecting}
    while not all(task.done() for task in driving):
        done, waiting = await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()


async def _tell(drivers: list[RobotDriver]) -> None:
    """Say how far the robots are, every second."""
    while True:
        await asyncio.sleep(_TELL_S)
        ended: Counter[str] = sum((driver.driven.ended for driver in drivers), Counter())
        errors_m = [driver.driven.errors_m[-1] for driver in drivers if driver.driven.errors_m]
        _say("progress", ended=dict(ended), error_m=float(np.mean(errors_m)) if errors_m else None)


async def _stop_at_end(lines: asyncio.StreamReader, stop: asyncio.Event) -> None:
    while await lines.readline():
        pass
    stop.set()


async def _main() -> None:
    loop = asyncio.get_running_loop()
    lines = asyncio.StreamReader()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
    told = json.loads(await lines.readline())
    told["clients"] = tuple(told["clients"])
    job = RobotJob(**{f.name: told[f.name] for f in fields(RobotJob)})
    try:
        await run_robots(job, lines)
    except InputError as error:
        _say("error", said=str(error))


if __name__ == "__main__":
    with suppress(KeyboardInterrupt, BrokenPipeError):
        asyncio.run(_main())
    # Nothing that is still compiling or connecting is worth waiting for.
    sys.stdout.flush()
    os._exit(0)

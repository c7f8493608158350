"""One robot in real time: a slot every half second, questions that go out and come back meanwhile, all written down."""

import asyncio
from collections import Counter
from dataclasses import dataclass, field
from math import isfinite
from typing import Any

import numpy as np

from ovibjax.control.environment import SLOT_S
from ovibjax.link.payload import Request
from ovibjax.live.coded_requests import Sending
from ovibjax.live.latencies import Latencies
from ovibjax.live.messages import RobotState, pack_request
from ovibjax.live.request_log import RequestLog
from ovibjax.live.robot import Decided, Robot
from ovibjax.live.robot_link import Ended, RobotLink
from ovibjax.live.shaping import TokenBucket

_FLOATS = Sending()  # as in the paper
_TRACK_SLOTS = 1000  # of errors in one line of the log


@dataclass(frozen=True)
class Mission:
    """What the edge is told of a robot beside what it knows itself.

    Attributes:
        urgency: mission urgency.
        deadlines_ms: [T] relative deadline of a request in each slot, in the world's time.
        phase_s: when its first slot begins.
        timeout_s: how long it waits for an answer.
    """

    urgency: float
    deadlines_ms: np.ndarray
    phase_s: float
    timeout_s: float


@dataclass
class Driven:
    """What became of a robot.

    Attributes:
        errors_m: distance of estimate and truth at the end of each slot.
        ended: how its questions ended.
        sent_bytes: everything it sent.
        e2e_ms: from decision to answer, of answered questions.
    """

    errors_m: list[float] = field(default_factory=list)
    ended: Counter[str] = field(default_factory=Counter)
    sent_bytes: int = 0
    e2e_ms: Latencies = field(default_factory=Latencies)


class WorldClock:
    """The world's time, which may run faster than ours.

    Args:
        begin_s: when it begins, on the loop's clock.
        speed: how much faster.
    """

    def __init__(self, begin_s: float, speed: float) -> None:
        self._begin_s, self.speed = begin_s, speed

    def now_s(self) -> float:
        """Seconds of the world since it began."""
        return (asyncio.get_running_loop().time() - self._begin_s) * self.speed

    def until_s(self, world_s: float) -> float:
        """Real seconds until a time of the world, none if it is over."""
        return max(0.0, (world_s - self.now_s()) / self.speed)


class RobotDriver:
    """Drives one robot; `drive` runs it to its end, or until it is told to stop.

    Attributes:
        driven: what became of it so far.
    """

    def __init__(
        self,
        robot: Robot,
        link: RobotLink,
        mission: Mission,
        clock: WorldClock,
        log: RequestLog,
        sending: Sending = _FLOATS,
    ) -> None:
        self.driven, self._sending = Driven(), sending
        self._robot, self._link, self._mission, self._clock, self._log = robot, link, mission, clock, log
        rates_bps = np.asarray(robot.draws.rate_bps)
        self._bucket = TokenBucket(rates_bps, SLOT_S)
        self._slots, self._slot = len(rates_bps), 0
        self._wait_s = 0.0
        self._service_s: float | None = None
        self._file = robot.file

    async def drive(self, stop: asyncio.Event) -> Driven:
        """Drive every slot, then wait for what is under way.

        Args:
            stop: set to end it early.

        Returns:
            What became of the robot.
        """
        asking: set[asyncio.Task[None]] = set()
        for slot in range(self._slots):
            await _sleep(self._clock.until_s(self._mission.phase_s + SLOT_S * slot), stop)
            if stop.is_set():
                break
            self._slot = slot
            decided = self._robot.tick(slot, self._link.connected, self._delay_s())
            if slot:
                self.driven.errors_m.append(decided.error_m)
            if decided.send:
                task = asyncio.ensure_future(self._ask(slot, decided))
                asking.add(task)
                task.add_done_callback(asking.discard)
        else:
            await _sleep(self._clock.until_s(self._mission.phase_s + SLOT_S * self._slots), stop)
        if asking:
            await asyncio.wait(asking)
        self.driven.errors_m.append(self._robot.error_m())
        self._log_track()
        return self.driven

    async def _ask(self, slot: int, decided: Decided) -> None:
        """Encode, send, and use the answer."""
        loop, robot = asyncio.get_running_loop(), self._robot
        began_s = loop.time()
        sequence = self._link.next_sequence()
        body = self._question(slot, decided, sequence)
        encode_ms = 1000.0 * (loop.time() - began_s)
        timeout_s = self._mission.timeout_s / self._clock.speed
        ended = await self._link.ask(sequence, body, self._pause_s, timeout_s)
        e2e_ms = 1000.0 * (loop.time() - began_s)
        found: dict[str, Any] = {}
        if ended.status == "ok" and ended.answer is not None:
            residual_m = robot.residual_m(slot, ended.answer.position_m)
            told_m = ended.answer.residual_m
            robot.corrected(slot, residual_m, told_m if isfinite(told_m) else decided.predicted_m, self._slot)
            self.driven.e2e_ms.add(e2e_ms)
            found = {"residual_m": float(np.hypot(*residual_m)), "expected_m": ended.answer.residual_m}
        else:
            robot.given_up(slot)
        if ended.answer is not None:
            self._wait_s = 1e-3 * ended.answer.backlog_ms
            self._service_s = 1e-3 * ended.answer.service_ms or self._service_s
        self.driven.ended[ended.status] += 1
        self.driven.sent_bytes += len(body) + 4 if ended.status != "unsent" else 0
        self._write(slot, decided, sequence, ended, {"encode_ms": encode_ms, "e2e_ms": e2e_ms, **found})

    def _question(self, slot: int, decided: Decided, sequence: int) -> bytes:
        robot, mission = self._robot, self._mission
        actions = self._file.actions
        mode = actions.modes[decided.action // len(actions.prefixes)]
        prefix = robot.encoded(slot, decided.action)
        deadline_ms = int(np.clip(mission.deadlines_ms[slot] / self._clock.speed, 1, 65535))
        packet = self._sending.packet(Request(mode, prefix, decided.voi_m, deadline_ms, robot.number % 65536, sequence))
        drift = float(robot.drift_m_per_s[slot])
        state = RobotState(decided.risk_m, drift, 1000.0 * decided.delay_s, mission.urgency)
        return pack_request(packet, state, small=self._sending.compact)

    def _delay_s(self) -> np.ndarray:
        """[A] queueing, service and return that the robot predicts, in the world's time."""
        greeting = self._link.greeting
        service_s = self._service_s if self._service_s is not None else 1e-3 * (greeting.service_ms if greeting else 0)
        count = len(self._file.actions)
        return np.full(count, (self._wait_s + service_s) * self._clock.speed + self._robot.return_s, np.float32)

    def _pause_s(self, size_bytes: int) -> float:
        """Real seconds until so many bytes have left."""
        now_s = max(self._clock.now_s() - self._mission.phase_s, 0.0)
        return (self._bucket.leaves_s(now_s, size_bytes) - now_s) / self._clock.speed

    def _write(self, slot: int, decided: Decided, sequence: int, ended: Ended, more: dict[str, Any]) -> None:
        actions, answer = self._file.actions, ended.answer
        edge = {} if answer is None else {"queue_ms": answer.queue_ms, "service_ms": answer.service_ms}
        self._log.write(
            "question",
            status=ended.status,
            client=self._robot.number,
            sequence=sequence,
            slot=slot,
            mode=actions.modes[decided.action // len(actions.prefixes)],
            k=int(actions.prefix[decided.action]),
            voi_m=decided.voi_m,
            risk_m=decided.risk_m,
            predicted_m=decided.predicted_m,
            uplink_ms=ended.uplink_ms,
            **edge,
            **more,
        )

    def _log_track(self) -> None:
        errors_m = [round(error_m, 3) for error_m in self.driven.errors_m]
        for first in range(0, len(errors_m), _TRACK_SLOTS):
            part = errors_m[first : first + _TRACK_SLOTS]
            self._log.write("track", client=self._robot.number, first_slot=first, errors_m=part)


async def _sleep(seconds: float, stop: asyncio.Event) -> None:
    """Sleep, but not on after a stop."""
    try:
        await asyncio.wait_for(stop.wait(), seconds)
    except TimeoutError:
        return

"""An edge server: asyncio takes the frames, one request at a time is served by a rule, each is answered and counted.

A service of a millisecond or more is spent in a thread of its own, so that frames are read, and their arrival noted,
while it lasts. A shorter one is not: handing it over and back costs more than it takes.
"""

import asyncio
import ssl
import time
from collections import Counter
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ovibjax.errors import InputError
from ovibjax.link.codes.coder import Coder
from ovibjax.link.payload import Request
from ovibjax.live.connection import Arrival, Connection, Limits
from ovibjax.live.edge_model import EdgeModel
from ovibjax.live.latencies import Latencies
from ovibjax.live.messages import Answer, Greeting, RobotState
from ovibjax.live.pacing import Pace
from ovibjax.live.request_log import RequestLog
from ovibjax.live.waiting import Ask, WaitingRoom
from ovibjax.scheduling.rules import default_params

_LOOK_S = 0.1
_FORGET = 0.05  # weight of the latest service time in the estimate
_MEASURED = 5
_APART_MS = 1.0


@dataclass(frozen=True)
class EdgeOptions:
    """How an edge serves.

    Attributes:
        rule: one of `scheduling.rules.POLICIES`.
        expire: whether a request past its deadline is answered `expired` instead of computed.
        pace: least time that requests take; more than they need makes the edge as slow as another.
        key: shared key; None for no challenge.
        tls: context of TLS; None for plain TCP.
        limits: of connections.
    """

    rule: str = "voi_lyapunov"
    expire: bool = True
    pace: Pace = field(default_factory=Pace)
    key: bytes | None = None
    tls: ssl.SSLContext | None = None
    limits: Limits = field(default_factory=Limits)


@dataclass(eq=False)
class _Pending:
    """A request that waits."""

    connection: Connection
    request: Request
    state: RobotState
    arrival: Arrival
    action: int
    estimate_ms: float


class _Spent(NamedTuple):
    """Begin and end of a service, on the loop's clock, and how long the edge took to begin it once it could."""

    began_s: float
    ended_s: float
    turn_ms: float = 0.0


class _Served(NamedTuple):
    """What a service gave, and how long its parts took."""

    position_m: tuple[float, float, float]
    residual_m: float
    decode_ms: float
    retrieve_ms: float


class EdgeServer:
    """An edge server; `serve` runs it.

    Attributes:
        counts: how many requests ended in each way, and connections in theirs.
        edge_ms: waiting plus service of answered requests.
        port: where it listens, from the moment that `on_ready` is called.
    """

    def __init__(self, model: EdgeModel, options: EdgeOptions, log: RequestLog) -> None:
        self.limits, self.key, self.tls = options.limits, options.key, options.tls
        self.coders: Mapping[str, Coder] = model.file.coders
        self.counts: Counter[str] = Counter()
        self.edge_ms, self.port = Latencies(), 0
        self._model, self._options, self._log = model, options, log
        self._room = WaitingRoom(options.rule, default_params())
        self._connections: set[Connection] = set()
        self._wake, self._idle = asyncio.Event(), asyncio.Event()
        self._idle.set()
        self._closing = False
        self._in_service: _Pending | None = None
        self._worker, self._apart = ThreadPoolExecutor(1, "edge"), True
        self._modes = [mode for mode in model.file.actions.modes for _ in model.file.actions.prefixes]
        self._service_ms = [options.pace.expected_ms(mode) or 1.0 for mode in self._modes]

    def warm_up(self) -> None:
        """Compile everything, and measure how long requests take."""
        self._model.warm_up()
        self._room.warm_up()
        for action, k in enumerate(self._model.file.actions.prefix):
            times_ms = []
            for _ in range(_MEASURED):
                began_s = time.perf_counter()
                self._compute(action, np.zeros(k, np.float32))
                times_ms.append(1000.0 * (time.perf_counter() - began_s))
            self._service_ms[action] = sorted(times_ms)[_MEASURED // 2]
        self._apart = max(self._service_ms) >= _APART_MS
        planned = zip(self._modes, self._service_ms, strict=True)
        self._service_ms = [max(service_ms, self._options.pace.expected_ms(mode)) for mode, service_ms in planned]

    async def serve(self, host: str, port: int, stop: asyncio.Event, on_ready: Callable[[int], None]) -> None:
        """Listen and serve until told to stop; then answer what waits.

        Args:
            host: address to listen at.
            port: port; 0 lets the system choose.
            stop: set when the edge is to stop.
            on_ready: told the port when everything is compiled and robots may come.

        Raises:
            InputError: the address cannot be listened at.
        """
        self.warm_up()
        loop = asyncio.get_running_loop()
        try:
            server = await loop.create_server(lambda: Connection(self), host, port, backlog=self.limits.connections)
        except (OSError, OverflowError) as error:
            why = getattr(error, "strerror", None) or error
            raise InputError(f"--host {host} --port {port}: cannot listen there ({why}); choose another") from error
        self.port = server.sockets[0].getsockname()[1]
        self._log_start(host)
        tasks = [loop.create_task(self._serve_requests()), loop.create_task(self._look_after_connections())]
        stopped = loop.create_task(stop.wait())
        try:
            on_ready(self.port)
            done, _ = await asyncio.wait([stopped, *tasks], return_when=asyncio.FIRST_COMPLETED)
            self._closing = True
            server.close()
            for task in done:
                task.result()  # raises what a task ran into
            with suppress(TimeoutError):
                await asyncio.wait_for(self._idle.wait(), self.limits.drain_s)
        finally:
            server.close()
            for task in (stopped, *tasks):
                task.cancel()
            for pending in [*self._room.owners, *([self._in_service] if self._in_service else [])]:
                self._end(pending, "closing")
            await self._close_connections()
            self._worker.shutdown(wait=False, cancel_futures=True)
            self._log.write("summary", **self.summary())

    def summary(self) -> dict[str, float]:
        """Counts, and percentiles of waiting plus service."""
        percentiles = {f"edge_p{p}_ms": self.edge_ms.percentile_ms(p) for p in (50, 95, 99)}
        return {**dict(sorted(self.counts.items())), **percentiles}

    def greeting(self, nonce: bytes) -> Greeting:
        """What a new connection is greeted with."""
        service_ms = sum(self._service_ms) / len(self._service_ms)
        return Greeting(self.key is not None, self._model.file.fingerprint, nonce, service_ms)

    def opened(self, connection: Connection) -> bool:
        """Take a connection in, if there is room for it."""
        if len(self._connections) >= self.limits.connections or self._closing:
            return False
        self.counts["connections"] += 1
        self._connections.add(connection)
        return True

    def closed(self, connection: Connection, why: str | None) -> None:
        """A connection is gone; its requests leave the queue."""
        self._connections.discard(connection)
        if connection.waiting:
            for pending in self._room.owners:
                if pending.connection is connection:
                    self._room.leave(pending)
                    self._end(pending, "gone")
        if why is not None and not self._closing:
            self.counts["refused"] += 1
            self._log.refused(why, peer=connection.peer, client=connection.client)

    def asked(self, connection: Connection, request: Request, state: RobotState, arrival: Arrival) -> None:
        """A request arrived: queue it, or say why not."""
        action = self._model.action_of(request.mode, len(request.prefix))
        estimate_ms = 0.0 if action is None else self._service_ms[action]
        pending = _Pending(connection, request, state, arrival, -1 if action is None else action, estimate_ms)
        connection.waiting += 1
        self.counts["requests"] += 1
        if self._closing:
            self._end(pending, "closing")
        elif action is None:
            self._end(pending, "unsupported")
        elif connection.waiting > self.limits.in_flight or self._room.full:
            self._end(pending, "busy")
        else:
            ask = Ask(
                client=request.client,
                ready_s=arrival.ready_s,
                deadline_ms=max(request.deadline_ms, 1),
                service_est_ms=estimate_ms,
                voi_m=request.voi_m,
                **state._asdict(),
            )
            self._room.add(ask, pending)
            self._idle.clear()
            self._wake.set()

    async def _serve_requests(self) -> None:
        """One request after another, for ever."""
        loop = asyncio.get_running_loop()
        free_s = loop.time()
        while True:
            if not len(self._room):
                self._idle.set()
                self._wake.clear()
                await self._wake.wait()
            now_s = loop.time()
            if self._options.expire:
                for pending in self._room.overdue(now_s):
                    self._end(pending, "expired")
                if not len(self._room):
                    continue
            could_s = max(free_s, self._room.since_s)
            pending = self._room.next(now_s)
            self._in_service, began_s = pending, loop.time()
            served = await self._computed(pending)
            # An edge that is to be slower than it is.
            if (left_s := began_s + 1e-3 * self._least_ms(pending.request) - loop.time()) > 0:
                await asyncio.sleep(left_s)
            free_s = loop.time()
            spent = _Spent(began_s, free_s, 1000.0 * (began_s - could_s))
            self._in_service = None
            estimate_ms, service_ms = self._service_ms[pending.action], 1000.0 * (spent.ended_s - began_s)
            self._service_ms[pending.action] = estimate_ms + _FORGET * (service_ms - estimate_ms)
            self._end(pending, "ok", spent, served)
            # Frames that came meanwhile are read before the next choice.
            await asyncio.sleep(0)

    def _least_ms(self, request: Request) -> float:
        return self._options.pace.least_ms(request.mode, request.client, request.sequence)

    async def _computed(self, pending: _Pending) -> _Served:
        work = pending.action, pending.request.prefix
        if self._apart:
            return await asyncio.get_running_loop().run_in_executor(self._worker, self._compute, *work)
        return self._compute(*work)

    def _compute(self, action: int, prefix: npt.NDArray[np.float32]) -> _Served:
        """Serve one request."""
        began_s = time.perf_counter()
        descriptor = self._model.decoded(action, prefix)
        decoded_s = time.perf_counter()
        row, distinctness = self._model.retrieved(action, descriptor)
        found = self._model.position_m(row), self._model.residual_m(action, distinctness)
        ended_s = time.perf_counter()
        return _Served(*found, 1000.0 * (decoded_s - began_s), 1000.0 * (ended_s - decoded_s))

    def _end(self, pending: _Pending, status: str, spent: _Spent | None = None, served: _Served | None = None) -> None:
        """Answer a request, count it, and write it down."""
        now_s = asyncio.get_running_loop().time
        spent = spent or _Spent(now_s(), now_s())
        queue_ms = 1000.0 * (spent.began_s - pending.arrival.ready_s)
        service_ms = 1000.0 * (spent.ended_s - spent.began_s)
        pending.connection.waiting -= 1
        packing_s = now_s()
        if status != "gone":
            request = pending.request
            answer = Answer(status, request.client, request.sequence, queue_ms=queue_ms, service_ms=service_ms)
            answer = answer._replace(backlog_ms=self._room.backlog_ms)
            if served is not None:
                answer = answer._replace(residual_m=served.residual_m, position_m=served.position_m)
            status = status if pending.connection.answer(answer) else "gone"
        pack_ms = 1000.0 * (now_s() - packing_s)
        if status == "ok":
            self.edge_ms.add(queue_ms + service_ms)
        self.counts[status] += 1
        self._log.write(
            "request",
            status=status,
            **_told(pending),
            queue_ms=queue_ms,
            service_ms=service_ms,
            turn_ms=spent.turn_ms,
            pack_ms=pack_ms,
            **_parts(served),
        )

    async def _look_after_connections(self) -> None:
        """Drop connections that take too long."""
        loop = asyncio.get_running_loop()
        while True:
            await asyncio.sleep(_LOOK_S)
            now_s = loop.time()
            for connection in list(self._connections):
                if why := connection.overdue(now_s):
                    connection.drop(why)

    async def _close_connections(self) -> None:
        """Let every connection send what was written, for a moment, and end."""
        for connection in list(self._connections):
            connection.close()
        for _ in range(20):
            if not self._connections:
                return
            await asyncio.sleep(0.05)
        for connection in list(self._connections):
            connection.drop(None)

    def _log_start(self, host: str) -> None:
        self._log.write(
            "start",
            side="edge",
            version=1,
            time=time.strftime("%Y-%m-%dT%H:%M:%S%z"),
            rule=self._options.rule,
            expire=self._options.expire,
            service_ms=self._options.pace.service_ms or None,
            paper_speed=self._options.pace.paper_speed or None,
            fingerprint=self._model.file.fingerprint.hex(),
            listening=f"{host}:{self.port}",
            trust=[name for name, used in (("key", self.key), ("tls", self.tls)) if used],
            limits=asdict(self.limits),
        )


def _told(pending: _Pending) -> dict[str, Any]:
    """What a request asked, for the log."""
    request, arrival = pending.request, pending.arrival
    return {
        "client": request.client,
        "sequence": request.sequence,
        "mode": request.mode,
        "k": len(request.prefix),
        "ready_s": arrival.ready_s,
        "unpack_ms": arrival.unpack_ms,
        "deadline_ms": request.deadline_ms,
        "voi_m": request.voi_m,
        **pending.state._asdict(),
        "service_est_ms": pending.estimate_ms,
    }


def _parts(served: _Served | None) -> dict[str, Any]:
    """What serving it gave, for the log."""
    if served is None:
        return {}
    return {"decode_ms": served.decode_ms, "retrieve_ms": served.retrieve_ms, "residual_m": served.residual_m}

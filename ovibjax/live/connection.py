"""One robot's connection to an edge: greeting, challenge, frames; whatever is wrong costs this connection alone."""

import asyncio
import secrets
import socket
import ssl
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from ovibjax.link.codes.coder import Coder
from ovibjax.link.payload import Request
from ovibjax.live.framing import FrameReader, WireError, frame
from ovibjax.live.messages import (
    NONCE_BYTES,
    REQUEST_LIMIT_BYTES,
    Answer,
    Greeting,
    RobotState,
    follows,
    pack_answer,
    pack_greeting,
    pack_welcome,
    unpack_hello,
    unpack_request,
)
from ovibjax.live.trust import client_proof, same, server_proof

_WRITE_LIMIT_BYTES = 1 << 15


@dataclass(frozen=True)
class Limits:
    """What one connection, and all of them, may take.

    Attributes:
        connections: connections at a time.
        in_flight: requests of one connection that wait; further ones are answered `busy`.
        hello_s: time for TLS and the proof of the key.
        frame_s: time from the first byte of a frame to its last.
        idle_s: time without a frame.
        drain_s: time to answer what waits when the edge stops.
    """

    connections: int = 1024
    in_flight: int = 4
    hello_s: float = 5.0
    frame_s: float = 5.0
    idle_s: float = 300.0
    drain_s: float = 5.0


class Edge(Protocol):
    """What a connection needs of the edge that it is a part of."""

    limits: Limits
    key: bytes | None
    tls: ssl.SSLContext | None
    coders: Mapping[str, Coder]

    def greeting(self, nonce: bytes) -> Greeting:
        """What a new connection is greeted with."""

    def opened(self, connection: "Connection") -> bool:
        """Take a connection in, if there is room for it."""

    def closed(self, connection: "Connection", why: str | None) -> None:
        """A connection is gone; `why` where it was refused or dropped."""

    def asked(self, connection: "Connection", request: Request, state: RobotState, arrival: "Arrival") -> None:
        """A request arrived."""


@dataclass(frozen=True)
class Arrival:
    """When a request came.

    Attributes:
        ready_s: when its last byte was there, on the loop's clock.
        unpack_ms: time to parse it.
    """

    ready_s: float
    unpack_ms: float


class Connection(asyncio.Protocol):
    """The edge's side of one connection.

    Attributes:
        peer: the other side's address, for the log.
        client: number of the robot; None until it says.
        waiting: its requests that are not answered.
    """

    def __init__(self, edge: Edge) -> None:
        self.peer, self.waiting = "", 0
        self.client: int | None = None
        self._edge, self._reader = edge, FrameReader(REQUEST_LIMIT_BYTES)
        self._loop = asyncio.get_running_loop()
        self._transport: asyncio.Transport | None = None
        self._nonce = secrets.token_bytes(NONCE_BYTES)
        self._greeted, self._trusted = False, edge.key is None
        self._early: deque[bytes] = deque()
        self._since_s = self._loop.time()  # of the hello, of the frame that is not complete, or of the last one
        self._last: int | None = None
        self._why: str | None = None
        self._over = False
        self._tls: asyncio.Task[None] | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Somebody is there."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self.peer = _address(transport)
        transport.set_write_buffer_limits(high=_WRITE_LIMIT_BYTES)
        plain = transport.get_extra_info("socket")
        plain.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        plain.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _WRITE_LIMIT_BYTES)  # the system's memory counts too
        if not self._edge.opened(self):
            self.drop("too many connections")
        elif self._edge.tls is None:
            self._greet()
        else:
            transport.pause_reading()
            self._tls = self._loop.create_task(self._secure(self._edge.tls))

    async def _secure(self, context: ssl.SSLContext) -> None:
        assert self._transport is not None
        try:
            secured = await self._loop.start_tls(
                self._transport, self, context, server_side=True, ssl_handshake_timeout=self._edge.limits.hello_s
            )
        except (OSError, ssl.SSLError) as error:  # a time-out is one too
            reason = getattr(error, "reason", None) or str(error) or type(error).__name__
            self.drop(f"TLS: {reason}"[:200])
            # The loop does not always tell this protocol of the end.
            self._tls = None
            self.connection_lost(None)
            return
        self._transport = secured
        if self._why is None:
            self._greet()

    def _greet(self) -> None:
        self._send(pack_greeting(self._edge.greeting(self._nonce)))
        self._greeted = True
        while self._early:
            self.data_received(self._early.popleft())

    def data_received(self, data: bytes) -> None:
        """The next bytes of the stream."""
        if self._why is not None:
            return
        if not self._greeted:  # TLS delivers before it says that it is ready
            self._early.append(data)
            return
        now_s = self._loop.time()
        if not self._reader.held:
            self._since_s = now_s
        try:
            for body in self._reader.feed(data):
                self._since_s = now_s
                self._take(body, now_s)
        except WireError as error:
            self.drop(str(error))

    def _take(self, body: bytes, now_s: float) -> None:
        if not self._trusted:
            self._check(body)
            return
        began_s = self._loop.time()
        request, state = unpack_request(body, self._edge.coders)
        unpack_ms = 1000.0 * (self._loop.time() - began_s)
        if self.client is None:
            self.client = request.client
        if request.client != self.client:
            raise WireError(f"client {request.client} on the connection of client {self.client}")
        if self._last is not None and not follows(request.sequence, self._last):
            raise WireError(f"sequence {request.sequence} does not follow {self._last}")
        self._last = request.sequence
        self._edge.asked(self, request, state, Arrival(now_s, unpack_ms))

    def _check(self, body: bytes) -> None:
        key = self._edge.key
        assert key is not None
        try:
            hello = unpack_hello(body)
        except WireError as error:
            raise WireError(f"no proof of the key ({error})") from error
        if not same(hello.proof, client_proof(key, self._nonce, hello.nonce, hello.client)):
            raise WireError("wrong key")
        self.client, self._trusted = hello.client, True
        self._send(pack_welcome(server_proof(key, self._nonce, hello.nonce)))

    def answer(self, answer: Answer) -> bool:
        """Send an answer; whether there is still somebody to send it to."""
        return self._send(pack_answer(answer))

    def _send(self, body: bytes) -> bool:
        transport = self._transport
        if transport is None or transport.is_closing():
            return False
        transport.write(frame(body))
        if transport.get_write_buffer_size() > _WRITE_LIMIT_BYTES:
            self.drop("does not read its answers")
            return False
        return True

    def overdue(self, now_s: float) -> str | None:
        """Why a connection has taken too long, if it has."""
        limits, waited_s = self._edge.limits, now_s - self._since_s
        if not self._greeted or not self._trusted:
            return "no hello in time" if waited_s > limits.hello_s + 1.0 else None
        if self._reader.held:
            return "a frame took too long" if waited_s > limits.frame_s else None
        return "idle" if waited_s > limits.idle_s and not self.waiting else None

    def drop(self, why: str | None) -> None:
        """End the connection at once."""
        self._why = self._why or why or "stopped"
        if self._transport is not None:
            self._transport.abort()

    def close(self) -> None:
        """End the connection when what was written is sent."""
        if self._transport is not None:
            self._transport.close()

    def connection_lost(self, error: Exception | None) -> None:
        """The end."""
        if self._over:
            return
        self._over = True
        if self._tls is not None:
            self._tls.cancel()
        self._edge.closed(self, self._why)


def _address(transport: asyncio.Transport) -> str:
    peer = transport.get_extra_info("peername")
    return f"{peer[0]}:{peer[1]}" if isinstance(peer, tuple) else str(peer)

"""A robot's side of a connection: it comes back after every failure, and every question has an end.

A question ends with an answer, or as `timeout` (none came), `lost` (the connection ended before one came) or `unsent`
(the link was down before all of it had left).
"""

import asyncio
import random
import secrets
import ssl
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

from ovibjax.errors import InputError, one_line
from ovibjax.live.framing import FrameReader, WireError, frame
from ovibjax.live.messages import (
    ANSWER_LIMIT_BYTES,
    NONCE_BYTES,
    Answer,
    Greeting,
    Hello,
    pack_hello,
    unpack_answer,
    unpack_greeting,
    unpack_welcome,
)
from ovibjax.live.trust import client_proof, same, server_proof

_HELLO_S = 5.0
_FIRST_WAIT_S, _LONGEST_WAIT_S = 0.1, 2.0
_PIECE_BYTES = 32
_READ_BYTES = 4096


@dataclass(frozen=True)
class EdgeAddress:
    """Where an edge is, and what it must be.

    Attributes:
        host: its address.
        port: its port.
        fingerprint: 16 bytes that name the edge file.
        key: shared key, if the edge asks for one.
        tls: context of TLS; None for plain TCP.
    """

    host: str
    port: int
    fingerprint: bytes
    key: bytes | None = None
    tls: ssl.SSLContext | None = None


class OtherEdge(InputError):
    """What listens there is no edge that these robots could use; trying again does not help."""


class _Stream:
    """Messages of one connection."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self.writer, self._parser = reader, writer, FrameReader(ANSWER_LIMIT_BYTES)

    async def messages(self) -> AsyncIterator[bytes]:
        while data := await self._reader.read(_READ_BYTES):
            for body in self._parser.feed(data):
                yield body


class Ended(NamedTuple):
    """How a question ended.

    Attributes:
        status: that of the answer, or `timeout`, `lost`, `unsent`.
        answer: the answer, if there was one.
        uplink_ms: from the first byte to the last one sent; None where not all was.
    """

    status: str
    answer: Answer | None = None
    uplink_ms: float | None = None


class RobotLink:
    """The connection of one robot to an edge, kept up by `stay_connected`.

    Attributes:
        greeting: the last greeting of the edge.
        counts: connections made, and failures by kind.
        why: what went wrong last.
    """

    def __init__(self, address: EdgeAddress, client: int) -> None:
        self._address, self._client = address, client
        self.greeting: Greeting | None = None
        self.counts: Counter[str] = Counter()
        self.why = ""
        self._stream: _Stream | None = None
        self._sending = asyncio.Lock()
        self._asked: dict[int, asyncio.Future[Answer]] = {}
        self._half_sent = False
        self._sequence = secrets.randbelow(65536)

    @property
    def connected(self) -> bool:
        """Whether the edge can be asked."""
        return self._stream is not None

    async def stay_connected(self) -> None:
        """Connect, take answers, and come back after every failure, for ever.

        Raises:
            OtherEdge: what listens there serves another file, or wants a key that the robot does not have.
        """
        wait_s = _FIRST_WAIT_S
        while True:
            try:
                async for answer in self._answers():
                    wait_s = _FIRST_WAIT_S
                    future = self._asked.pop(answer.sequence, None)
                    if future is None or answer.client != self._client:
                        self.counts["late"] += 1
                    elif not future.done():
                        future.set_result(answer)
                self.why = "the edge closed the connection"
            except (OSError, ssl.SSLError, WireError, TimeoutError) as error:
                self.why = one_line(error, 160)
            self.counts["disconnected"] += 1
            # Robots that lost their edge at once do not come back at once.
            await asyncio.sleep(wait_s * random.uniform(0.5, 1.5))
            wait_s = min(2.0 * wait_s, _LONGEST_WAIT_S)

    async def _answers(self) -> AsyncIterator[Answer]:
        """Answers of one connection, until it ends."""
        stream = None
        try:
            async with asyncio.timeout(_HELLO_S):
                stream = _Stream(*await self._open())
                messages = stream.messages()
                await self._greeted(stream, messages)
            self.counts["connected"] += 1
            self._stream, self._half_sent = stream, False
            async for body in messages:
                yield unpack_answer(body)
        finally:
            self._stream = None
            for future in self._asked.values():
                future.cancel()
            self._asked.clear()
            if stream is not None:
                stream.writer.close()

    async def _open(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        to = self._address
        return await asyncio.open_connection(to.host, to.port, ssl=to.tls)

    async def _greeted(self, stream: _Stream, messages: AsyncIterator[bytes]) -> None:
        """Both sides know whom they talk to."""
        to, where = self._address, f"{self._address.host}:{self._address.port}"
        body = await anext(messages, None)
        if body is None:
            raise WireError("the edge closed the connection without a greeting")
        greeting = unpack_greeting(body)
        if greeting.fingerprint != to.fingerprint:
            raise OtherEdge(f"{where}: the edge serves another file than this one; give both the same")
        if greeting.wants_key and to.key is None:
            raise OtherEdge(f"{where}: the edge wants a shared key; give --key-file")
        if to.key is not None and not greeting.wants_key:
            raise OtherEdge(f"{where}: the edge cannot prove that it has the shared key; it asks for none")
        if to.key is not None:
            nonce = secrets.token_bytes(NONCE_BYTES)
            proof = client_proof(to.key, greeting.nonce, nonce, self._client)
            stream.writer.write(frame(pack_hello(Hello(self._client, nonce, proof))))
            body = await anext(messages, None)
            if body is None:
                raise WireError("the edge refused the proof of the shared key")
            if not same(unpack_welcome(body), server_proof(to.key, greeting.nonce, nonce)):
                raise OtherEdge(f"{where}: the edge cannot prove that it has the shared key")
        self.greeting = greeting

    def next_sequence(self) -> int:
        """A sequence number that no question had in the last 65,535."""
        self._sequence = (self._sequence + 1) % 65536
        return self._sequence

    async def ask(self, sequence: int, body: bytes, pause_s: Callable[[int], float], timeout_s: float) -> Ended:
        """Send a question in small pieces as the link lets them through, and wait for its answer.

        Args:
            sequence: its sequence number, from `next_sequence`.
            body: its bytes, without a length.
            pause_s: called with the size of the next piece; seconds until it may leave.
            timeout_s: how long to wait, from now on.

        Returns:
            How it ended.
        """
        loop, uplink_ms = asyncio.get_running_loop(), None
        future: asyncio.Future[Answer] = loop.create_future()
        began_s = loop.time()
        try:
            async with asyncio.timeout(timeout_s):
                async with self._sending:
                    stream = self._stream
                    if stream is None or not await self._sent(stream, frame(body), pause_s, sequence, future):
                        return Ended("unsent")
                uplink_ms = 1000.0 * (loop.time() - began_s)
                answer = await future
                return Ended(answer.status, answer, uplink_ms)
        except TimeoutError:
            self._drop_half_sent()
            return Ended("unsent" if uplink_ms is None else "timeout", None, uplink_ms)
        except asyncio.CancelledError:
            if not future.cancelled():
                raise
            return Ended("lost", None, uplink_ms)
        finally:
            self._asked.pop(sequence, None)

    def _drop_half_sent(self) -> None:
        """End a connection on which half a question stands: another one behind it would be read as its other half."""
        if self._half_sent and not self._sending.locked() and self._stream is not None:
            self._stream.writer.transport.abort()
            self._stream = None

    # The connection, what to send over it, when, and who waits for it.
    async def _sent(
        self,
        stream: _Stream,
        data: bytes,
        pause_s: Callable[[int], float],
        sequence: int,
        future: "asyncio.Future[Answer]",
    ) -> bool:
        for at in range(0, len(data), _PIECE_BYTES):
            piece = data[at : at + _PIECE_BYTES]
            await asyncio.sleep(pause_s(len(piece)))
            if self._stream is not stream:
                # Another connection, or none: the rest would make no sense there.
                return False
            last = at + _PIECE_BYTES >= len(data)
            if last:
                self._asked[sequence] = future
            stream.writer.write(piece)
            self._half_sent = not last
        with suppress(ConnectionError):
            await stream.writer.drain()
        return True


async def check_edge(address: EdgeAddress, client: int = 0) -> None:
    """Connect once and go, to find out whether robots can use the edge.

    Args:
        address: the edge.
        client: the number to say hello with.

    Raises:
        InputError: nobody listens there, or somebody else.
    """
    link = RobotLink(address, client)
    trying = asyncio.ensure_future(link.stay_connected())
    try:
        while not link.counts["connected"]:
            done, _ = await asyncio.wait([trying], timeout=0.02)
            if done:
                trying.result()
            if link.counts["disconnected"]:
                raise InputError(
                    f"{address.host}:{address.port}: no edge there ({link.why}); start one: ovibjax edge serve"
                )
    finally:
        trying.cancel()
        with suppress(asyncio.CancelledError, InputError):
            await trying

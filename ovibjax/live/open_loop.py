"""Requests that leave when they are due, whatever the edge does: an open loop, in one process, of bytes made before.

A closed loop of robots asks less where the edge is slow, so that no two rules would see the same requests. Here they
do, and a latency may be counted from when its request was due: a generator that is late cannot hide it.
"""

import asyncio
import gc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from ovibjax.errors import InputError
from ovibjax.live.framing import FrameReader, WireError, frame
from ovibjax.live.messages import ANSWER_LIMIT_BYTES, Answer, unpack_answer

Floats = npt.NDArray[np.float64]

_BEGIN_S = 0.1
_SETTLE_S = 0.2


@dataclass(frozen=True)
class Load:
    """Requests in the order in which they are due.

    Attributes:
        client: [J] number of the client of each.
        sequence: [J] its sequence number, newer than all before it of its client.
        due_s: [J] when its last byte is to leave, from the beginning.
        bodies: [J] its bytes.
        warm: a request per client that goes before all of them, with an older sequence number.
    """

    client: npt.NDArray[np.int64]
    sequence: npt.NDArray[np.int64]
    due_s: Floats
    bodies: Sequence[bytes]
    warm: dict[int, bytes]


@dataclass(frozen=True)
class Offered:
    """When requests were due, left and were answered, on the clock of the loop, which an edge on this machine shares.

    Attributes:
        due_s: [J] when each was due.
        sent_s: [J] when it left.
        answered_s: [J] when its answer had come.
        status: [J] that of the answer.
    """

    due_s: Floats
    sent_s: Floats
    answered_s: Floats
    status: list[str]

    @property
    def late_ms(self) -> Floats:
        """[J] how late requests left."""
        return 1000.0 * (self.sent_s - self.due_s)


async def offer(port: int, load: Load, patience_s: float) -> Offered:
    """Offer a load to an edge on this machine, after one request of each client as a warm-up.

    Args:
        port: where the edge listens.
        load: the requests.
        patience_s: how long to wait for answers when the last request has left.

    Returns:
        What became of them.

    Raises:
        InputError: nobody listens there, the edge goes, or it does not answer in time.
    """
    loop, answered = asyncio.get_running_loop(), _Answers()
    clients: dict[int, _Client] = {}
    try:
        for number in load.warm:
            clients[number] = (await loop.create_connection(lambda: _Client(answered), "127.0.0.1", port))[1]
        for number, body in load.warm.items():
            clients[number].send(body)
        await answered.reaches(len(load.warm), patience_s)
        await asyncio.sleep(_SETTLE_S)
        with _undisturbed():
            begin_s, sent_s = loop.time() + _BEGIN_S, np.zeros(len(load.bodies))
            for j, due_s in enumerate((begin_s + load.due_s).tolist()):
                if (left_s := due_s - loop.time()) > 0:
                    await asyncio.sleep(left_s)
                answered.check()
                sent_s[j] = loop.time()
                clients[int(load.client[j])].send(load.bodies[j])
            await answered.reaches(len(load.warm) + len(load.bodies), patience_s)
    except OSError as error:
        raise InputError(f"127.0.0.1:{port}: the edge cannot be reached ({error.strerror or error})") from error
    finally:
        answered.over = True
        for client in clients.values():
            client.close()
    found = [answered.of[key] for key in zip(load.client.tolist(), load.sequence.tolist(), strict=True)]
    at_s = np.array([when_s for when_s, _ in found])
    return Offered(begin_s + load.due_s, sent_s, at_s, [status for _, status in found])


@dataclass
class _Answers:
    """Answers of all connections: when each came, and its status, by client and sequence number."""

    of: dict[tuple[int, int], tuple[float, str]] = field(default_factory=dict)
    why: str = ""
    over: bool = False
    _more: asyncio.Event = field(default_factory=asyncio.Event)

    def add(self, answer: Answer) -> None:
        self.of[answer.client, answer.sequence] = asyncio.get_running_loop().time(), answer.status
        self._more.set()

    def lost(self, why: str) -> None:
        """A connection is gone, which it may be when all is over."""
        self.why = self.why or ("" if self.over else why)
        self._more.set()

    def check(self) -> None:
        if self.why:
            raise InputError(f"the edge ended a connection while it was asked ({self.why})")

    async def reaches(self, count: int, patience_s: float) -> None:
        """Wait until so many answers are there."""
        try:
            async with asyncio.timeout(patience_s):
                while len(self.of) < count:
                    self.check()
                    self._more.clear()
                    await self._more.wait()
        except TimeoutError:
            told = f"the edge answered {len(self.of)} of {count} requests within {patience_s:g} s of the last"
            raise InputError(f"{told}; is the machine busy with something else?") from None


class _Client(asyncio.Protocol):
    """One client's connection."""

    def __init__(self, answers: _Answers) -> None:
        self._answers, self._reader, self._greeted = answers, FrameReader(ANSWER_LIMIT_BYTES), False
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        try:
            for body in self._reader.feed(data):
                if self._greeted:
                    self._answers.add(unpack_answer(body))
                self._greeted = True
        except WireError as error:
            self._answers.lost(str(error))

    def connection_lost(self, error: Exception | None) -> None:
        self._answers.lost(str(error or "closed"))

    def send(self, body: bytes) -> None:
        assert self._transport is not None
        self._transport.write(frame(body))

    def close(self) -> None:
        if self._transport is not None:
            self._transport.abort()


@contextmanager
def _undisturbed() -> Iterator[None]:
    """No collection of garbage meanwhile: it would take some milliseconds now and then."""
    enabled = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()

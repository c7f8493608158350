"""A live edge in the test's own loop, on a port that the system chooses, and a plain client to talk to it.

Nothing waits for ever: `run` ends a test that hangs.
"""

import asyncio
import json
from contextlib import asynccontextmanager, suppress

from ovibjax.live.connection import Limits
from ovibjax.live.edge_server import EdgeOptions, EdgeServer
from ovibjax.live.framing import FrameReader, frame
from ovibjax.live.messages import ANSWER_LIMIT_BYTES, unpack_answer, unpack_greeting
from ovibjax.live.pacing import Pace
from ovibjax.live.request_log import RequestLog

LONGEST_S = 60.0


def run(test):
    """Run a test's coroutine, for a minute at most."""

    async def bounded():
        async with asyncio.timeout(LONGEST_S):
            return await test

    return asyncio.run(bounded())


@asynccontextmanager
async def an_edge(model, log=None, port=0, apart=False, **options):
    """A serving edge; its options are those of `EdgeOptions`, `Limits` and `Pace`."""
    paces = {name: options.pop(name) for name in list(options) if name in Pace.__dataclass_fields__}
    limits = {name: options.pop(name) for name in list(options) if name in Limits.__dataclass_fields__}
    with RequestLog(log) as written:
        server = EdgeServer(model, EdgeOptions(pace=Pace(**paces), limits=Limits(**limits), **options), written)
        server.warm_up = lambda: None  # the model is compiled, and choosing compiles when it is needed
        server._apart = apart
        stop, ready = asyncio.Event(), asyncio.Event()
        task = asyncio.create_task(server.serve("127.0.0.1", port, stop, lambda _: ready.set()))
        started = asyncio.create_task(ready.wait())
        await asyncio.wait([task, started], return_when=asyncio.FIRST_COMPLETED)
        try:
            yield server
        finally:
            stop.set()
            await task


class Plain:
    """A client that sends what it is told."""

    def __init__(self, reader, writer):
        self.reader, self.writer = reader, writer
        self.frames, self._parser = [], FrameReader(ANSWER_LIMIT_BYTES)

    async def message(self):
        """The next frame's body; None at the end of the stream."""
        while not self.frames:
            data = b""
            with suppress(ConnectionError):
                data = await self.reader.read(4096)
            if not data:
                return None
            self.frames += self._parser.feed(data)
        return self.frames.pop(0)

    async def answer(self):
        """The next answer; None at the end of the stream."""
        body = await self.message()
        return None if body is None else unpack_answer(body)

    def send(self, *bodies):
        """Send frames."""
        self.writer.write(b"".join(map(frame, bodies)))

    async def ask(self, *bodies):
        """Send frames, and take as many answers."""
        self.send(*bodies)
        return [await self.answer() for _ in bodies]

    async def gone(self):
        """Whether the other side ended the connection; waits for what it does."""
        return await self.message() is None


@asynccontextmanager
async def a_client(port, **tls):
    """A connected client that has been greeted."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port, **tls)
    client = Plain(reader, writer)
    try:
        body = await client.message()
        client.greeting = None if body is None else unpack_greeting(body)
        yield client
    finally:
        writer.close()
        with suppress(Exception):
            await writer.wait_closed()


async def until(condition):
    """Wait until something is so."""
    while not condition():
        await asyncio.sleep(0.01)


def events(path, kind):
    """Events of a kind in a log."""
    return [event for event in map(json.loads, path.read_text().splitlines()) if event["event"] == kind]

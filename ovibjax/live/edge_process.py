"""Edge servers as processes of their own: started side by side, heard until they listen, ended whatever happens."""

import asyncio
import os
import signal
import sys
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from ovibjax.errors import InputError
from ovibjax.live.edge_server import EdgeOptions

_END_S = 15.0
_FIRST_LINE = "listening on "


@dataclass
class EdgeProcess:
    """An edge that serves in a process of its own.

    Attributes:
        options: how it serves; of them rule, pace, expiry and requests in flight are passed on.
        log: its log.
        port: where it listens, on the loopback.
    """

    options: EdgeOptions
    log: Path
    port: int = 0
    _process: asyncio.subprocess.Process | None = None

    async def begin(self, file: Path) -> None:
        """Start it, and wait until it listens.

        Args:
            file: the edge file.

        Raises:
            InputError: it ended before that; the message is what it said.
        """
        self._process = await asyncio.create_subprocess_exec(
            *command_of(file, self.options, self.log),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            env={**os.environ, "NPROC": "1"},
        )
        assert self._process.stdout is not None and self._process.stderr is not None
        line = (await self._process.stdout.readline()).decode(errors="replace")
        if not line.startswith(_FIRST_LINE):
            said = (await self._process.stderr.read()).decode(errors="replace").strip().splitlines()
            code = await self._process.wait()
            raise InputError(f"the edge ended before it listened (code {code}): {said[-1] if said else 'no word'}")
        self.port = int(line.partition(",")[0].rpartition(":")[2])

    async def stop(self) -> None:
        """Let it answer what waits, write its summary and end.

        Raises:
            InputError: it had ended, or did not end well.
        """
        assert self._process is not None
        code = self._process.returncode
        if code is None:
            with suppress(ProcessLookupError):
                self._process.send_signal(signal.SIGTERM)
            try:
                code = await asyncio.wait_for(self._process.wait(), _END_S)
            except TimeoutError:
                raise InputError(f"the edge ({self.options.rule}) does not stop") from None
        if code:
            raise InputError(f"the edge ({self.options.rule}) ended while it served (code {code})")

    async def kill(self) -> None:
        """See that it is over."""
        if self._process is not None and self._process.returncode is None:
            with suppress(ProcessLookupError):
                self._process.kill()
            await self._process.wait()


def command_of(file: Path, options: EdgeOptions, log: Path) -> list[str]:
    """The command line of an edge on a port that the system chooses.

    Args:
        file: the edge file.
        options: how it serves; of them rule, pace, expiry and requests in flight are passed on.
        log: its log.

    Returns:
        Words.
    """
    pace, limits = options.pace, options.limits
    words = [sys.executable, "-m", "ovibjax", "edge", "serve", str(file), "--port", "0", "--rule", options.rule]
    words += ["--service-ms", str(pace.service_ms), "--paper-speed", str(pace.paper_speed), "--log", str(log)]
    return [*words, "--in-flight", str(limits.in_flight), *(() if options.expire else ("--serve-late",))]


@asynccontextmanager
async def edges_running(file: Path, edges: Sequence[EdgeProcess], start_s: float = 300.0) -> AsyncIterator[None]:
    """Edges that all listen when the block begins, and are all ended when it is left, by an error or Ctrl-C too.

    Args:
        file: the edge file.
        edges: the edges, not begun.
        start_s: how long they may take to begin.

    Raises:
        InputError: one of them does not begin, or had ended before it was told to.
    """
    try:
        try:
            async with asyncio.timeout(start_s):
                await asyncio.gather(*(edge.begin(file) for edge in edges))
        except TimeoutError:
            raise InputError(f"an edge did not begin within {start_s:g} s") from None
        yield
        await asyncio.gather(*(edge.stop() for edge in edges))
    finally:
        for edge in edges:
            await edge.kill()

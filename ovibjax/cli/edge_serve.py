"""The command `ovibjax edge serve`: an edge server on a TCP port."""

import asyncio
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from ovibjax.cli.processor import one_thread
from ovibjax.errors import InputError, doubt

if TYPE_CHECKING:
    from ovibjax.live.edge_server import EdgeOptions, EdgeServer


@dataclass(frozen=True)
class EdgeServe:
    """Serve robots: receive codes, decode, retrieve, answer positions, one request at a time in the order of a rule.

    Everything is compiled before the port opens. Ctrl-C and SIGTERM answer what waits, print a summary and stop.

    Example: ovibjax edge serve edge.npz --rule voi_lyapunov --log edge.jsonl
    """

    file: tyro.conf.Positional[Path]
    """Edge file, from `ovibjax edge export`."""
    rule: str = "voi_lyapunov"
    """Whom to serve next: fifo, edf, maxweight, base_dpp, voi_lyapunov."""
    host: str = "127.0.0.1"
    """Address to listen at. The default can be reached from this machine alone; 0.0.0.0 is every address."""
    port: int = 7747
    """Port; 0 lets the system choose one, which is printed."""
    log: Path | None = None
    """File for a line of JSON per request; continued if it exists."""
    serve_late: bool = False
    """Compute requests past their deadline too; by default they are answered `expired`."""
    service_ms: float = 0.0
    """Least time to spend on a request: makes this edge as slow as another, for load tests."""
    paper_speed: float = 0.0
    """Take as long over a request as the paper's edge, 14 to 20 ms, so many times as fast: 1 for its own speed, 6 for
    robots of edge drive --speed 6; 0 for no such thing."""
    key_file: Path | None = None
    """File with a shared key: robots must prove that they have it (HMAC-SHA256 of a challenge)."""
    tls_cert: Path | None = None
    """Certificate chain (PEM): speak TLS."""
    tls_key: Path | None = None
    """Its private key, if that is in a file of its own."""
    tls_ca: Path | None = None
    """Who signs the robots' certificates (PEM): robots without one are refused."""
    connections: int = 1024
    """Most connections at a time."""
    in_flight: int = 4
    """Most requests of a robot that wait; further ones are answered `busy`."""
    frame_s: float = 5.0
    """Time from the first byte of a request to its last; slower connections are dropped."""
    idle_s: float = 300.0
    """Time after which a connection without requests is dropped."""

    def run(self) -> None:
        """Run the command."""
        one_thread()
        from ovibjax.live.edge_file import load_edge
        from ovibjax.live.edge_model import EdgeModel
        from ovibjax.live.edge_server import EdgeServer
        from ovibjax.live.request_log import RequestLog

        options = self._options()
        model = EdgeModel(load_edge(self.file))
        _allow_files(self.connections + 64)
        with RequestLog(self.log) as log:
            server = EdgeServer(model, options, log)
            asyncio.run(self._serve(server))
        told = ", ".join(f"{name} {value:.4g}" for name, value in server.summary().items() if value == value)
        print(f"summary: {told}", flush=True)

    async def _serve(self, server: "EdgeServer") -> None:
        stop = asyncio.Event()
        with stopped_by_signals(stop.set):

            def ready(port: int) -> None:
                print(f"listening on {self.host}:{port}, rule {self.rule}; Ctrl-C stops", flush=True)

            await server.serve(self.host, self.port, stop, ready)

    def _options(self) -> "EdgeOptions":
        """What was typed, checked."""
        from ovibjax.live.connection import Limits
        from ovibjax.live.edge_server import EdgeOptions
        from ovibjax.live.pacing import Pace
        from ovibjax.live.trust import is_loopback, read_key, server_tls
        from ovibjax.scheduling.rules import POLICIES

        if self.rule not in POLICIES:
            raise InputError(f"--rule {self.rule}: rules are {', '.join(POLICIES)}")
        if not 0 <= self.port <= 65535:
            raise InputError(f"--port {self.port} is not 0 to 65535")
        for name in ("connections", "in_flight", "frame_s", "idle_s"):
            if not 0 < getattr(self, name) < float("inf"):
                raise InputError(f"--{name.replace('_', '-')} {getattr(self, name)} is not positive")
        if not 0 <= self.service_ms <= 60_000:
            raise InputError(f"--service-ms {self.service_ms} is not 0 to 60000")
        if not 0 <= self.paper_speed <= 1000:
            raise InputError(f"--paper-speed {self.paper_speed} is not 0 to 1000")
        key, tls = read_key(self.key_file), server_tls(self.tls_cert, self.tls_key, self.tls_ca)
        if not is_loopback([self.host]) and key is None and tls is None:
            doubt(f"--host {self.host}", "anybody who reaches this port may ask; see --key-file and --tls-cert")
        limits = Limits(self.connections, self.in_flight, frame_s=self.frame_s, idle_s=self.idle_s)
        pace = Pace(self.service_ms, self.paper_speed)
        return EdgeOptions(self.rule, not self.serve_late, pace, key, tls, limits)


@contextmanager
def stopped_by_signals(stop: Callable[[], None]) -> Iterator[None]:
    """Call a function on Ctrl-C and SIGTERM while the block runs, inside a running loop."""
    loop, before = asyncio.get_running_loop(), {}
    for number in (signal.SIGINT, signal.SIGTERM):
        before[number] = signal.getsignal(number)
        if before[number] is not signal.SIG_IGN:
            loop.add_signal_handler(number, stop)
    try:
        yield
    finally:
        for number, handler in before.items():
            loop.remove_signal_handler(number)
            signal.signal(number, handler)


def _allow_files(count: int) -> None:
    """Let the process open so many files, if the system allows it."""
    with suppress(ImportError, ValueError, OSError):
        import resource

        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        if soft < count:
            resource.setrlimit(resource.RLIMIT_NOFILE, (min(count, hard), hard))

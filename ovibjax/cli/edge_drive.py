"""The command `ovibjax edge drive`: robots that ask a live edge."""

import asyncio
import os
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from ovibjax.cli.edge_serve import stopped_by_signals
from ovibjax.cli.processor import one_thread
from ovibjax.errors import InputError
from ovibjax.runtime.progress import console

if TYPE_CHECKING:
    from ovibjax.live.fleet import FleetResult
    from ovibjax.live.robot_link import EdgeAddress
    from ovibjax.live.robot_process import RobotJob


@dataclass(frozen=True)
class EdgeDrive:
    """Drive robots through the scene of an edge file: they dead-reckon, and ask a live edge where they are.

    Each robot has a route, an odometry that drifts, a belief and a controller of its own, as in `ovibjax replay`; its
    requests go through an uplink as slow as the profile says. A robot that loses its edge goes on and comes back.

    Example: ovibjax edge drive edge.npz --clients 30 --profile 4 --policy voi --seconds 60
    """

    file: tyro.conf.Positional[Path]
    """Edge file, the same that the edge serves."""
    host: str = "127.0.0.1"
    """Address of the edge."""
    port: int = 7747
    """Its port."""
    clients: int = 30
    """Robots."""
    profile: float = 4.0
    """Mean uplink throughput in KB/s, with block fading around it; the paper's profiles are 4, 8 and 12."""
    policy: str = "voi"
    """When a robot asks: voi, voi_gap, periodic, fixed_front, uncertainty."""
    seconds: float = 60.0
    """How long they drive, in the world's time."""
    budget: float | None = None
    """Payload allowed to a robot over the drive, KB; by default in proportion to the paper's 2.1 KB in 296.5 s."""
    speed: float = 1.0
    """How much faster than ours the world's time runs, its links too."""
    processes: int | None = None
    """Processes that the robots are dealt out to; by default one per core."""
    seed: int = 100
    """Of everything that is drawn: odometry, fading, urgencies, deadlines, places on the routes."""
    trace: Path | None = None
    """A measured throughput trace instead of the profile, see `ovibjax replay`; each robot begins elsewhere in it."""
    code: str = "float32"
    """How prefixes are sent: float32 as in the paper, int8, int4 or entropy, as far as the file has tables for them."""
    compact: bool = False
    """Send them under a header of about 12 bytes instead of 20 and 4 per view."""
    adapt: Literal["none", "innovation", "reported"] = "none"
    """Correct what robots expect of an answer while they drive, from the risks that answers report or from how far
    they lie from the estimate; with the policies voi and voi_gap."""
    log: Path | None = None
    """File for a line of JSON per question; continued if it exists."""
    key_file: Path | None = None
    """File with the shared key that the edge asks for."""
    tls_ca: Path | None = None
    """Who signs the edge's certificate (PEM): speak TLS."""
    tls_cert: Path | None = None
    """The robots' certificate chain (PEM), where the edge wants one."""
    tls_key: Path | None = None
    """Its private key, if that is in a file of its own."""

    def run(self) -> None:
        """Run the command."""
        one_thread()
        from ovibjax.live.edge_file import load_edge
        from ovibjax.live.request_log import RequestLog
        from ovibjax.live.robot_process import adaptation_of, sending_of

        job = self._job()
        file = load_edge(self.file)
        sending_of(job, file)  # refused before any process begins
        adaptation_of(job, file)
        address = job.address(file)
        with RequestLog(self.log) as log:
            log.write("start", side="robots", version=1, fingerprint=address.fingerprint.hex(), **self._told())
            result = asyncio.run(self._drive(job, address))
            log.write("summary", gone=result.gone, ended=dict(result.ended))
        self._print(result)

    def _job(self) -> "RobotJob":
        """What was typed, checked."""
        from ovibjax.link.trace_files import read_trace
        from ovibjax.live.robot import LIVE_POLICIES
        from ovibjax.live.robot_process import RobotJob

        if self.policy not in LIVE_POLICIES:
            raise InputError(f"--policy {self.policy}: robots can follow {', '.join(LIVE_POLICIES)}")
        if not 1 <= self.clients <= 65536:
            raise InputError(f"--clients {self.clients} is not 1 to 65536")
        if self.processes is not None and not 1 <= self.processes <= 256:
            raise InputError(f"--processes {self.processes} is not 1 to 256")
        if not 1 <= self.port <= 65535:
            raise InputError(f"--port {self.port} is not 1 to 65535")
        for name in ("profile", "seconds", "speed", "budget"):
            value = getattr(self, name)
            if value is not None and not 0 < value < float("inf"):
                raise InputError(f"--{name} {value} is not a positive number")
        if not 0 <= self.seed < 1 << 31:
            raise InputError(f"--seed {self.seed} is not 0 to 2147483647")
        if self.trace is not None:
            read_trace(self.trace)
        job = RobotJob(str(self.file), self.host, self.port, tuple(range(self.clients)), self.policy)
        job = replace(job, profile_kb_per_s=self.profile, seconds=self.seconds, speed=self.speed, seed=self.seed)
        job = replace(job, budget_kb=self.budget, code=self.code, compact=self.compact, adapt=self.adapt)
        job = replace(job, trace=_text(self.trace), log=_text(self.log), key_file=_text(self.key_file))
        tls = (_text(self.tls_ca), _text(self.tls_cert), _text(self.tls_key))
        return replace(job, tls_ca=tls[0], tls_cert=tls[1], tls_key=tls[2])

    async def _drive(self, job: "RobotJob", address: "EdgeAddress") -> "FleetResult":
        from ovibjax.live.fleet import drive_fleet
        from ovibjax.live.robot_link import check_edge

        stop = asyncio.Event()
        with stopped_by_signals(stop.set), console.status("starting the robots") as status:
            await check_edge(address)

            def told(ended: Counter[str], error_m: float | None) -> None:
                words = ", ".join(f"{count} {name}" for name, count in ended.most_common())
                status.update(f"{self.clients} robots; {words or 'no question yet'}; error {error_m or 0.0:.2f} m")

            return await drive_fleet(job, self.processes or os.cpu_count() or 1, stop, told)

    def _told(self) -> dict[str, object]:
        """The drive, for the log."""
        names = ("clients", "policy", "profile", "seconds", "speed", "seed", "budget", "code", "compact", "adapt")
        return {name: getattr(self, name) for name in names} | {"trace": self.trace and str(self.trace)}

    def _print(self, result: "FleetResult") -> None:
        from ovibjax.live.fleet import summary_of

        for name, value in summary_of(result).items():
            print(f"{name}: {value}")
        if result.gone:
            raise InputError(f"{len(result.gone)} of {self.clients} robots are gone: their process was ended")


def _text(path: Path | None) -> str | None:
    return None if path is None else str(path)

"""Requests per second that an edge carries, beside a bare asyncio echo server and gRPC's Python server, in one run.

    python tests/benchmarks/edge_server.py edge.npz

Needs the `bench` extra, and an edge file (`ovibjax edge export`). Each server is a process of its own on the loopback.
The load is an open loop: requests leave at Poisson times whatever the server does, and a latency counts from the time
at which its request should have left, so that a server that falls behind cannot hide it. A server carries a load if
95 % of what is offered comes back within `--within-ms`; it is offered more until it does not. The echo server sends
every frame back as it came; gRPC's handler unpacks, decodes, retrieves and packs with the same functions as the edge,
in the order of arrival, in one thread as the edge has one. Servers take turns at every load, so that a busy moment of
the machine falls on all. Last comes the ratio of what the edge carries, first in, first out, to what gRPC does. To see
that it runs: `--per-s 100 200 --seconds 1`.
"""

import argparse
import asyncio
import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
os.environ.setdefault("NPROC", "1")

import grpc
import numpy as np

from ovibjax.link.payload import Request, pack
from ovibjax.live.edge_file import load_edge
from ovibjax.live.edge_model import EdgeModel
from ovibjax.live.framing import FrameReader, frame
from ovibjax.live.messages import Answer, RobotState, pack_answer, pack_request, unpack_request

METHOD = "/ovibjax.Edge/Ask"
SERVERS = ("echo", "edge fifo", "edge voi_lyapunov", "grpc")
HERE = str(Path(__file__).resolve())
LIMIT_BYTES = 4096
LOADS_PER_S = [250, 350, 500, 700, 1000, 1400, 2000, 2800, 4000, 5600, 8000]


def bodies(count: int) -> list[bytes]:
    """Requests, all different; sequence numbers are put in by the sender."""
    rng = np.random.default_rng(0)
    state = RobotState(6.0, 0.5, 20.0, 1.0)
    return [
        pack_request(
            pack(Request("FS", rng.normal(size=16), float(rng.uniform(0, 6)), 60_000, 0, number % 65536)), state
        )
        for number in range(count)
    ]


def numbered(body: bytes, sequence: int) -> bytes:
    """A request with another sequence number."""
    request, state = unpack_request(body)
    return pack_request(pack(replace(request, sequence=sequence)), state)


async def serve_echo() -> None:
    """Send every frame back."""

    class Echo(asyncio.Protocol):
        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            self.transport, self.reader = transport, FrameReader(LIMIT_BYTES)

        def data_received(self, data: bytes) -> None:
            for body in self.reader.feed(data):
                self.transport.write(frame(body))

    server = await asyncio.get_running_loop().create_server(Echo, "127.0.0.1", 0)
    print(f"listening on 127.0.0.1:{server.sockets[0].getsockname()[1]},", flush=True)
    await server.serve_forever()


def serve_grpc(path: str) -> None:
    """The same work behind gRPC."""
    model = EdgeModel(load_edge(path))
    model.warm_up()

    def ask(body: bytes, _: grpc.ServicerContext) -> bytes:
        request, _state = unpack_request(body)
        action = model.action_of(request.mode, len(request.prefix))
        row, distinctness = model.retrieved(action, model.decoded(action, request.prefix))
        found = model.residual_m(action, distinctness), model.position_m(row)
        answer = Answer("ok", request.client, request.sequence, residual_m=found[0], position_m=found[1])
        return pack_answer(answer)

    server = grpc.server(ThreadPoolExecutor(1))
    handlers = {"Ask": grpc.unary_unary_rpc_method_handler(ask)}
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler("ovibjax.Edge", handlers),))
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    print(f"listening on 127.0.0.1:{port},", flush=True)
    server.wait_for_termination()


@contextmanager
def running(server: str, path: str):
    """A server's process; yields its port."""
    if server.startswith("edge"):
        command = ["-m", "ovibjax", "edge", "serve", path, "--port", "0", "--rule", server.split()[1]]
        command += ["--in-flight", "4096"]
    else:
        command = [HERE, path, "--serve", server]
    with subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, text=True) as process:
        try:
            said = re.search(r":(\d+),", process.stdout.readline())
            if said is None:
                sys.exit(f"{server} does not start: {' '.join(command)}")
            yield int(said[1])
        finally:
            process.kill()


class Raw(asyncio.Protocol):
    """One connection of the load; its answers carry the sequence numbers of its requests."""

    def __init__(self, offset: int) -> None:
        self.reader, self.offset, self.due_s, self.latencies_s = FrameReader(LIMIT_BYTES), offset, {}, []
        self.sequence = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport, self.loop = transport, asyncio.get_running_loop()

    def ask(self, body: bytes, due_s: float) -> None:
        self.due_s[int.from_bytes(body[14:16], "little")] = due_s
        self.transport.write(frame(body))

    def again(self, body: bytes, due_s: float) -> None:
        """Ask with the next sequence number of this connection."""
        self.sequence = (self.sequence + 1) % 65536
        self.ask(numbered(body, self.sequence), due_s)

    def data_received(self, data: bytes) -> None:
        now_s = self.loop.time()
        for body in self.reader.feed(data):
            if body[:2] != b"OG":
                sequence = int.from_bytes(body[self.offset : self.offset + 2], "little")
                self.latencies_s.append(now_s - self.due_s.pop(sequence))


async def offered(server: str, port: int, per_s: float, seconds: float, connections: int) -> np.ndarray:
    """Latencies of the requests that were answered while a load lasted, and a second longer."""
    loop, rng = asyncio.get_running_loop(), np.random.default_rng(1)
    due_s = np.cumsum(rng.exponential(1.0 / per_s, int(per_s * seconds)))
    made = bodies(len(due_s))
    latencies_s: list[float] = []
    if server == "grpc":
        channels = [grpc.aio.insecure_channel(f"127.0.0.1:{port}") for _ in range(connections)]
        calls = [channel.unary_unary(METHOD) for channel in channels]
        tasks = set()

        async def one(number: int, at_s: float) -> None:
            await calls[number % connections](made[number])
            latencies_s.append(loop.time() - at_s)

        def ask(number: int, at_s: float) -> None:
            task = loop.create_task(one(number, at_s))
            tasks.add(task)
            task.add_done_callback(tasks.discard)

        await asyncio.gather(*(channel.channel_ready() for channel in channels))
    else:
        place = 14 if server == "echo" else 6
        raw = [(await loop.create_connection(lambda: Raw(place), "127.0.0.1", port))[1] for _ in range(connections)]

        def ask(number: int, at_s: float) -> None:
            raw[number % connections].ask(made[number], at_s)

    begin_s, number = loop.time() + 0.1, 0
    while number < len(due_s):
        while number < len(due_s) and begin_s + due_s[number] <= loop.time():
            ask(number, begin_s + due_s[number])
            number += 1
        await asyncio.sleep(0.0005)
    await asyncio.sleep(1.0)
    if server == "grpc":
        for task in list(tasks):
            task.cancel()
        for channel in channels:
            await channel.close()
    else:
        for one_of in raw:
            latencies_s += one_of.latencies_s
            one_of.transport.abort()
    return np.array(latencies_s)


def main() -> None:
    """Rising loads, all servers at each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file")
    parser.add_argument("--serve", choices=("echo", "grpc"), help=argparse.SUPPRESS)
    parser.add_argument("--per-s", type=float, nargs="+", default=LOADS_PER_S)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--connections", type=int, default=20)
    parser.add_argument("--within-ms", type=float, default=50.0)
    options = parser.parse_args()
    if options.serve == "echo":
        asyncio.run(serve_echo())
    elif options.serve == "grpc":
        serve_grpc(options.file)
    else:
        compare(options)


def compare(options: argparse.Namespace) -> None:
    """Print a line per server and load."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    print(f"{cores} cores, load average {os.getloadavg()[0]:.1f}; {options.connections} connections", flush=True)
    print(f"{'server':<18} {'offered/s':>9} {'in time':>9} {'p50 ms':>8} {'p99 ms':>8}")
    left, carried = list(SERVERS), dict.fromkeys(SERVERS, 0.0)
    for per_s in options.per_s:
        for server in list(left):
            with running(server, options.file) as port:
                found = 1000.0 * asyncio.run(offered(server, port, per_s, options.seconds, options.connections))
            share = (found <= options.within_ms).sum() / int(per_s * options.seconds)
            numbers = np.percentile(found, [50, 99]) if len(found) else [np.nan, np.nan]
            print(f"{server:<18} {per_s:9.0f} {share:9.1%} {numbers[0]:8.2f} {numbers[1]:8.2f}", flush=True)
            if share < 0.95:
                left.remove(server)
            else:
                carried[server] = per_s
    for server, per_s in carried.items():
        print(f"{server} carries {per_s:.0f} requests per second{'' if server not in left else ' or more'}")
    print(f"ratio: {carried['edge fifo'] / carried['grpc'] if carried['grpc'] else np.inf:.2f}")


if __name__ == "__main__":
    main()

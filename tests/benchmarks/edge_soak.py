"""An edge for minutes at half of what it can carry, among clients that do not behave: is it the same at the end?

    python tests/benchmarks/edge_soak.py edge.npz --minutes 10 --per-s 500

Needs an edge file (`ovibjax edge export`). Beside the load come, all the time, connections of garbage, of one byte a
second, of half a frame and then silence, and robots that go in the middle of a frame. Every ten seconds a line: memory
of the edge's process (resident, MB), open files, threads, answered requests, p50 and p99 of the load. At the end, of
the second half of the lines against the first: memory must be within 5 % and the median latency no more than a quarter
larger, and no connection, file or thread be left over. The edge keeps a log, which `ovibjax edge report` reads. To see
that it runs: `--minutes 0.7 --per-s 100`.
"""

import argparse
import asyncio
import re
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

from ovibjax.live.framing import frame
from tests.benchmarks.edge_server import Raw, bodies

EVERY_S = 10.0
WARM_LINES = 2


def seen(pid: int) -> tuple[float, int, int]:
    """Resident memory in MB, open files and threads of a process."""
    status = Path(f"/proc/{pid}/status").read_text()
    resident_kb, threads = (int(re.search(rf"{name}:\s+(\d+)", status)[1]) for name in ("VmRSS", "Threads"))
    return resident_kb / 1024, len(list(Path(f"/proc/{pid}/fd").iterdir())), threads


async def misbehave(port: int, kind: int) -> None:
    """One connection after another that a server must survive."""
    rng = np.random.default_rng(kind)
    good = frame(bodies(1)[0])
    while True:
        with suppress(OSError):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            if kind == 0:
                writer.write(rng.bytes(200))
            elif kind == 1:
                for byte in good[:8]:
                    writer.write(bytes([byte]))
                    await asyncio.sleep(1.0)
            elif kind == 2:
                writer.write(good[:-5])
            else:
                writer.write(good + good[:40])
            async with asyncio.timeout(8.0):
                while kind != 3 and await reader.read(4096):
                    pass
            writer.transport.abort()
        await asyncio.sleep(0.05)


async def load(port: int, per_s: float, connections: int, latencies_s: list[float]) -> None:
    """An open loop for ever."""
    loop, rng, made = asyncio.get_running_loop(), np.random.default_rng(1), bodies(500)
    raw = [(await loop.create_connection(lambda: Raw(6), "127.0.0.1", port))[1] for _ in range(connections)]
    for one in raw:
        one.latencies_s = latencies_s
    due_s, number = loop.time(), 0
    try:
        while True:
            while due_s <= loop.time():
                raw[number % connections].again(made[number % len(made)], due_s)
                due_s += rng.exponential(1.0 / per_s)
                number += 1
            await asyncio.sleep(0.001)
    finally:
        for one in raw:
            one.transport.abort()


async def soak(pid: int, port: int, options: argparse.Namespace) -> list[tuple[float, ...]]:
    """Lines, one every ten seconds."""
    latencies_s: list[float] = []
    tasks = [asyncio.create_task(misbehave(port, kind)) for kind in range(4)]
    tasks.append(asyncio.create_task(load(port, options.per_s, options.connections, latencies_s)))
    lines = []
    for _ in range(max(4, round(60 * options.minutes / EVERY_S))):
        await asyncio.sleep(EVERY_S)
        taken, latencies_s[:] = 1000.0 * np.array(latencies_s), []
        lines.append((*seen(pid), len(taken), *(np.percentile(taken, [50, 99]) if len(taken) else (np.nan, np.nan))))
        print("{:8.1f} MB {:5d} files {:4d} threads {:7d} answered  p50 {:7.2f}  p99 {:7.2f} ms".format(*lines[-1]))
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    await asyncio.sleep(6.0)
    lines.append((*seen(pid), 0, np.nan, np.nan))
    return lines


def main() -> None:
    """Serve, load, misbehave, look."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--per-s", type=float, default=500.0)
    parser.add_argument("--connections", type=int, default=20)
    parser.add_argument("--log", default="edge_soak.jsonl")
    options = parser.parse_args()
    command = [sys.executable, "-m", "ovibjax", "edge", "serve", options.file, "--port", "0", "--log", options.log]
    with subprocess.Popen([*command, "--in-flight", "4096"], stdout=subprocess.PIPE, text=True) as process:
        port = int(re.search(r":(\d+),", process.stdout.readline())[1])
        before = seen(process.pid)
        lines = asyncio.run(soak(process.pid, port, options))
        process.terminate()
        said = process.stdout.read().strip()
        code = process.wait(30)
    middle = WARM_LINES + (len(lines) - 1 - WARM_LINES) // 2
    first, second = np.array(lines[WARM_LINES:middle]), np.array(lines[middle:-1])
    growth = second[:, 0].mean() / first[:, 0].mean() - 1.0
    print(said)
    print(f"memory: {growth:+.1%} from the first half to the second (must be within 5 %)")
    print(f"p50: {first[:, 4].mean():.2f} ms, then {second[:, 4].mean():.2f} ms")
    print(f"open files: {before[1]} before anybody came, {lines[-1][1]} after all had gone; exit code {code}")
    print(f"threads: {lines[0][2]} after {EVERY_S:g} s, {lines[-1][2]} after all had gone")
    left_over = lines[-1][1] > before[1] or lines[-1][2] > lines[0][2]
    flat = second[:, 4].mean() < 1.25 * first[:, 4].mean()
    sys.exit(not (abs(growth) < 0.05 and flat and not left_over and code == 0))


if __name__ == "__main__":
    main()

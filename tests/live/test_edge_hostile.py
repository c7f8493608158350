"""Everything that comes over a wire at once, against an edge in a process of its own, while a robot goes on asking."""

import asyncio
import signal
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from ovibjax.live.framing import frame
from tests.live.edges import a_client, events, run
from tests.live.test_edge_processes import a_process
from tests.live.test_edge_robustness import WHOLE, mutations, verifies
from tests.live.test_edge_server import FAR_MS, packet

CONNECTIONS, FRAME_S = 16, 2.0


def open_files(pid):
    """Open files of a process, where the system tells."""
    folder = Path(f"/proc/{pid}/fd")
    return len(list(folder.iterdir())) if folder.is_dir() else None


async def one_by_one(port, sent, answered):
    """Each of these on a connection of its own, some at a time; answers with what they were given to."""
    left = iter(sent)

    async def attack():
        for data in left:
            async with a_client(port) as client:
                with suppress(ConnectionError):
                    client.writer.write(data)
                    client.writer.write_eof()
                while (body := await client.message()) is not None:
                    answered.append((data, body))

    await asyncio.gather(*(attack() for _ in range(CONNECTIONS)))


async def drip(port):
    """A request in single bytes, too slow; whether the edge ended it."""
    async with a_client(port) as client:
        for byte in frame(WHOLE):
            with suppress(ConnectionError):
                client.writer.write(bytes([byte]))
            await asyncio.sleep(4.0 * FRAME_S / len(WHOLE))
        return await client.gone()


async def half(port):
    """Half a request and then silence; whether the edge ended it."""
    async with a_client(port) as client:
        client.writer.write(frame(WHOLE)[:-5])
        return await client.gone()


async def vanish(port):
    """A connection that ends without a word in the middle of a request, by a reset."""
    async with a_client(port) as client:
        client.writer.write(frame(WHOLE) + frame(WHOLE)[:20])
        client.writer.transport.abort()


async def asking(port, attacks):
    """A robot that asks until the attacks are over: how often, and how often it was answered."""
    asked, fine = 0, 0
    async with a_client(port) as robot:
        while not attacks.done():
            (answer,) = await robot.ask(packet(asked % 65536, client=9, deadline_ms=FAR_MS))
            asked, fine = asked + 1, fine + (answer is not None and answer.status == "ok")
            await asyncio.sleep(0.005)
    return asked, fine


@pytest.mark.parametrize(
    ("frames", "garbage", "others"),
    [pytest.param(300, 50, 8, marks=pytest.mark.slow), pytest.param(20_000, 1000, 100, marks=pytest.mark.long)],
)
def test_an_edge_outlives_whatever_comes(frames, garbage, others, edge_path, tmp_path, monkeypatch):
    monkeypatch.setattr("tests.live.edges.LONGEST_S", 900.0)
    log, rng = tmp_path / "edge.jsonl", np.random.default_rng(frames)
    noise = [rng.bytes(int(size)) for size in rng.integers(1, 3000, garbage)]
    answered = []

    async def test(edge):
        before = open_files(edge.pid)

        async def attacks():
            await asyncio.gather(
                one_by_one(edge.port, [*mutations(frames, frames), *noise], answered),
                *(vanish(edge.port) for _ in range(others)),
            )
            return await asyncio.gather(*(kind(edge.port) for kind in (drip, half) for _ in range(others)))

        attacking = asyncio.create_task(attacks())
        asked, fine = await asking(edge.port, attacking)
        assert fine == asked > 0
        assert all(attacking.result())
        for _ in range(100):
            if open_files(edge.pid) == before:
                break
            await asyncio.sleep(0.1)
        assert open_files(edge.pid) == before

    with a_process(edge_path, log, 0, "--frame-s", str(FRAME_S)) as edge:
        run(test(edge))
        assert edge.poll() is None
        edge.send_signal(signal.SIGTERM)
        assert edge.wait(30) == 0
        said = edge.stdout.read()
    assert "Traceback" not in said and "summary: " in said
    assert [data for data, _ in answered if not verifies(data)] == []
    (summary,) = events(log, "summary")
    assert summary["ok"] + summary.get("gone", 0) == summary["requests"]
    assert summary["refused"] >= garbage * 0.9

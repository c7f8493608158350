"""Whatever comes over the wire costs the connection that it came on, and nobody else."""

import asyncio
import contextlib
import socket
import struct

import numpy as np
import pytest

from ovibjax.live.framing import FrameReader, WireError, frame
from ovibjax.live.messages import REQUEST_LIMIT_BYTES, RobotState, pack_request, unpack_request
from tests.live.edges import a_client, an_edge, events, run, until
from tests.live.test_edge_server import FAR_MS, packet

WHOLE = pack_request(packet(), RobotState(4.0, 0.5, 20.0, 1.5))


def wrong_version(body):
    return body[:2] + bytes([body[2] ^ 0x20]) + body[3:]


BAD = {
    "garbage": (lambda: b"\x30\0\0\0" + bytes(range(48)), "first byte 0x00 begins no packet"),
    "HTTP": (lambda: b"GET / HTTP/1.1\r\n\r\n", "frame of"),
    "a length of gigabytes": (lambda: struct.pack("<I", 2**32 - 1), "frame of 4294967295 bytes"),
    "an empty frame": (lambda: struct.pack("<I", 0), "frame of 0 bytes"),
    "wrong version": (lambda: frame(wrong_version(packet())), "version"),
    "truncated": (lambda: frame(WHOLE[:-1]), "behind the packet"),
    "too short": (lambda: frame(b"OV"), "shorter than any request"),
    "old sequence": (lambda: frame(packet(9)) + frame(packet(8)), "sequence 8 does not follow 9"),
    "same sequence": (lambda: frame(packet(9)) + frame(packet(9)), "sequence 9 does not follow 9"),
    "two clients": (lambda: frame(packet(9)) + frame(packet(10, client=4)), "client 4 on the connection of client 3"),
}


@pytest.mark.parametrize("bad", BAD)
def test_what_is_wrong_costs_its_own_connection(bad, edge_model, tmp_path):
    data, why = BAD[bad]
    log = tmp_path / "log.jsonl"

    async def test():
        async with an_edge(edge_model, log) as server, a_client(server.port) as good:
            async with a_client(server.port) as client:
                client.writer.write(data())
                while await client.message() is not None:
                    pass
            (answer,) = await good.ask(packet(client=5))
            return answer, server.counts

    answer, counts = run(test())
    assert answer.status == "ok"
    assert counts["refused"] == 1
    (line,) = events(log, "refused")
    assert why in line["why"]


def test_sequence_numbers_wrap_on_one_connection(edge_model):
    async def test():
        async with an_edge(edge_model) as server, a_client(server.port) as client:
            return await client.ask(*(packet(i) for i in (65534, 65535, 0, 1)))

    assert [answer.status for answer in run(test())] == ["ok"] * 4


def test_a_frame_in_single_bytes_is_read(edge_model):
    async def test():
        async with an_edge(edge_model) as server, a_client(server.port) as client:
            for byte in frame(WHOLE):
                client.writer.write(bytes([byte]))
                await client.writer.drain()
                await asyncio.sleep(0)
            return await client.answer()

    assert run(test()).status == "ok"


def test_slow_drips_and_silence_are_dropped(edge_model, tmp_path):
    log = tmp_path / "log.jsonl"

    async def drip(client):
        for byte in frame(WHOLE):
            client.writer.write(bytes([byte]))
            await asyncio.sleep(0.05)

    async def test():
        async with an_edge(edge_model, log, frame_s=0.3, idle_s=1.0) as server:
            async with a_client(server.port) as slow, a_client(server.port) as half, a_client(server.port) as silent:
                dripping = asyncio.create_task(drip(slow))
                half.writer.write(frame(WHOLE)[:-1])
                assert await slow.gone()
                assert await half.gone()
                assert await silent.gone()
                dripping.cancel()
            return server.counts

    counts = run(test())
    assert counts["requests"] == 0
    assert sorted(line["why"] for line in events(log, "refused")) == ["a frame took too long"] * 2 + ["idle"]


def test_who_does_not_read_is_dropped(edge_model, tmp_path):
    """Answers that nobody takes do not pile up."""
    log = tmp_path / "log.jsonl"

    async def test():
        async with an_edge(edge_model, log) as server:
            deaf = socket.socket()
            deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
            deaf.setblocking(False)
            loop = asyncio.get_running_loop()
            await loop.sock_connect(deaf, ("127.0.0.1", server.port))
            many = b"".join(frame(packet(i % 65536, k=1)) for i in range(20_000))
            sending = asyncio.create_task(loop.sock_sendall(deaf, many))
            await until(lambda: server.counts["refused"])
            sending.cancel()
            deaf.close()

    run(test())
    assert [line["why"] for line in events(log, "refused")] == ["does not read its answers"]


def test_no_more_connections_than_allowed(edge_model, tmp_path):
    log = tmp_path / "log.jsonl"

    async def test():
        async with an_edge(edge_model, log, connections=2) as server, a_client(server.port) as one:
            async with a_client(server.port):
                async with a_client(server.port) as third:
                    assert third.greeting is None
                (answer,) = await one.ask(packet())
            await until(lambda: server.counts["connections"] == 2)
            async with a_client(server.port) as fourth:
                assert fourth.greeting is not None
            return answer

    assert run(test()).status == "ok"
    assert [line["why"] for line in events(log, "refused")] == ["too many connections"]


def test_refusals_do_not_fill_the_disk(edge_model, tmp_path):
    log = tmp_path / "log.jsonl"

    async def test():
        async with an_edge(edge_model, log) as server:
            for _ in range(300):
                async with a_client(server.port) as client:
                    client.writer.write(struct.pack("<I", 0))
                    await client.gone()
            return server.counts, len(asyncio.all_tasks())

    counts, tasks = run(test())
    lines = events(log, "refused")
    assert counts["refused"] == 300
    assert sum(1 + line.get("untold", 0) for line in lines) <= 300
    assert tasks < 8


def mutations(seed, count):
    """Frames that differ from a good one: bits, bytes, lengths, cuts, two of them spliced."""
    rng = np.random.default_rng(seed)
    good = frame(WHOLE)
    for _ in range(count):
        bad = bytearray(good)
        kind = rng.integers(5)
        if kind == 0:
            bad[rng.integers(len(bad))] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            for at in rng.integers(4, len(bad), rng.integers(1, 9)):
                bad[at] = int(rng.integers(256))
        elif kind == 2:
            bad[:4] = struct.pack("<I", int(rng.integers(0, 2 * len(bad))))
        elif kind == 3:
            at = int(rng.integers(4, len(bad)))
            bad = bad[:at]
            bad[:4] = struct.pack("<I", len(bad) - 4)
        else:
            a, b = sorted(rng.integers(4, len(bad), 2))
            bad[a:b] = bad[4 : 4 + b - a]
        if bytes(bad) != good:
            yield bytes(bad)


def verifies(data):
    """Whether a client would rightly be answered: a cut may leave a request without its state, which is one."""
    with contextlib.suppress(WireError):
        for body in FrameReader(REQUEST_LIMIT_BYTES).feed(data):
            unpack_request(body)
            return True
    return False


async def attacked(model, log, bad, connections):
    """Send each frame on a connection of its own, some at a time, beside a robot that goes on asking."""
    async with an_edge(model, log) as server, a_client(server.port) as robot:
        answered, left = [], iter(bad)

        async def attack():
            for data in left:
                async with a_client(server.port) as client:
                    client.writer.write(data)
                    client.writer.write_eof()
                    while (body := await client.message()) is not None:
                        answered.append((data, body))

        attacks = [asyncio.create_task(attack()) for _ in range(connections)]
        sequence, fine = 0, 0
        while not all(task.done() for task in attacks):
            (answer,) = await robot.ask(packet(sequence % 65536, client=9, deadline_ms=FAR_MS))
            sequence, fine = sequence + 1, fine + (answer.status == "ok")
        await asyncio.gather(*attacks)
        assert fine == sequence > 0
        return answered, server.counts


@pytest.mark.parametrize("count", [400, pytest.param(20_000, marks=pytest.mark.long)])
def test_mutated_frames_get_no_answer(count, edge_model, tmp_path, monkeypatch):
    monkeypatch.setattr("tests.live.edges.LONGEST_S", 600.0)
    bad = list(mutations(count, count))
    assert len(bad) > 0.95 * count
    answered, counts = run(attacked(edge_model, tmp_path / "log.jsonl", bad, 16))
    assert [data for data, _ in answered if not verifies(data)] == []
    assert counts["ok"] == counts["requests"]

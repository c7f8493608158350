"""A robot's link: every question ends, and after every failure it comes back."""

import asyncio
from contextlib import asynccontextmanager, suppress

import pytest

from ovibjax.errors import InputError
from ovibjax.live.framing import frame
from ovibjax.live.messages import Greeting, pack_greeting
from ovibjax.live.robot_link import EdgeAddress, RobotLink, check_edge
from tests.live.edges import an_edge, run, until
from tests.live.test_edge_server import packet

KEY = b"a shared key of the tests"


def address_of(server, model, **changes):
    return EdgeAddress(**{"host": "127.0.0.1", "port": server.port, "fingerprint": model.file.fingerprint} | changes)


@asynccontextmanager
async def a_link(address, client=3):
    """A link that is kept up."""
    link = RobotLink(address, client)
    task = asyncio.create_task(link.stay_connected())
    try:
        yield link
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task


async def ask(link, timeout_s=30.0, pause_s=lambda _: 0.0, **fields):
    await until(lambda: link.connected)
    sequence = link.next_sequence()
    return await link.ask(sequence, packet(sequence, **fields), pause_s, timeout_s)


@pytest.mark.parametrize("key", [None, KEY])
def test_questions_are_answered(edge_model, key):
    async def test():
        async with an_edge(edge_model, key=key) as server, a_link(address_of(server, edge_model, key=key)) as link:
            ended = [await ask(link) for _ in range(3)]
            assert ended[0].answer.position_m == ended[2].answer.position_m
            return ended, link.counts

    ended, counts = run(test())
    assert [one.status for one in ended] == ["ok"] * 3
    assert all(one.uplink_ms >= 0 for one in ended)
    assert counts == {"connected": 1}


def test_no_answer_in_time_is_a_timeout(edge_model):
    async def test():
        async with (
            an_edge(edge_model, service_ms=300.0) as server,
            a_link(address_of(server, edge_model)) as link,
        ):
            slow = await ask(link, timeout_s=0.05)
            await until(lambda: link.counts["late"])
            return slow, await ask(link)

    slow, fine = run(test())
    assert (slow.status, fine.status) == ("timeout", "ok")


def test_an_edge_that_dies_and_comes_back(edge_model):
    """A question that was under way is lost, not waited for; the link comes back by itself."""

    async def test():
        async with an_edge(edge_model, service_ms=30_000.0, drain_s=0.0) as server:
            address = address_of(server, edge_model)
            keeping = a_link(address)
            link = await keeping.__aenter__()
            asking = asyncio.create_task(ask(link))
            await until(lambda: server.counts["requests"])
            for connection in list(server._connections):
                connection.drop("killed")
            lost = await asking
        again = an_edge(edge_model, port=address.port)
        async with again:
            fine = await ask(link)
            counts = dict(link.counts)
        await keeping.__aexit__(None, None, None)
        return lost, fine, counts

    lost, fine, counts = run(test())
    assert (lost.status, fine.status) == ("lost", "ok")
    assert counts["connected"] >= 2
    assert counts["disconnected"] >= 1


def test_half_a_question_is_never_read_as_the_next_ones_half(edge_model, tmp_path):
    log = tmp_path / "log.jsonl"

    async def test():
        async with an_edge(edge_model, log) as server, a_link(address_of(server, edge_model)) as link:
            pauses_s = iter([0.0, 60.0])
            half = await ask(link, timeout_s=0.1, pause_s=lambda _: next(pauses_s))
            return half, await ask(link), link.counts

    half, fine, counts = run(test())
    assert (half.status, fine.status) == ("unsent", "ok")
    assert counts["connected"] == 2
    assert '"refused"' not in log.read_text()


def test_without_a_connection_nothing_is_sent(edge_model):
    async def test():
        link = RobotLink(EdgeAddress("127.0.0.1", 1, bytes(16)), 3)
        return await link.ask(1, packet(), lambda _: 0.0, 1.0)

    assert run(test()).status == "unsent"


WRONG = {
    "another file": ({}, {"fingerprint": bytes(16)}, "serves another file"),
    "a key is wanted": ({"key": KEY}, {}, "wants a shared key; give --key-file"),
    "no key there": ({}, {"key": KEY}, "cannot prove that it has the shared key"),
    "another key": ({"key": KEY}, {"key": KEY + b"!"}, "refused the proof of the shared key"),
}


@pytest.mark.parametrize("case", WRONG)
def test_an_edge_that_robots_cannot_use_is_said(case, edge_model):
    of_edge, of_robot, why = WRONG[case]

    async def test():
        async with an_edge(edge_model, **of_edge) as server:
            with pytest.raises(InputError, match=why):
                await check_edge(address_of(server, edge_model, **of_robot))

    run(test())


def test_nobody_there_is_said():
    with pytest.raises(InputError, match=r"127\.0\.0\.1:1: no edge there .*ovibjax edge serve"):
        run(check_edge(EdgeAddress("127.0.0.1", 1, bytes(16))))


STRANGE = {
    "nothing": b"",
    "HTTP": b"HTTP/1.1 400 Bad Request\r\n\r\n",
    "zeros": bytes(100),
    "a greeting and garbage": frame(pack_greeting(Greeting(False, bytes(16), bytes(32), 1.0))) + b"\xff" * 50,
}


@pytest.mark.parametrize("strange", STRANGE)
def test_whoever_listens_there_the_robot_goes_on(strange):
    """A server that is no edge never stops a robot; it tries again, and not all the time."""

    async def test():
        async def serve(reader, writer):
            writer.write(STRANGE[strange])
            writer.close()

        server = await asyncio.start_server(serve, "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        async with a_link(EdgeAddress("127.0.0.1", port, bytes(16))) as link:
            await until(lambda: link.counts["disconnected"] >= 2)
            assert not link.connected
            assert link.why
        server.close()

    run(test())

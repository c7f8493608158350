"""An edge answers what it is asked, in the order of its rule, and says what it does not compute."""

import asyncio

import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.live.edge_server import EdgeOptions, EdgeServer
from ovibjax.live.messages import RobotState, pack_request
from ovibjax.live.request_log import RequestLog, read_log
from ovibjax.scheduling.rules import POLICIES
from tests.live.cases import a_packet
from tests.live.edges import a_client, an_edge, events, run, until

SLOW_MS = 40.0
FAR_MS = 60_000


def packet(sequence=1, client=3, **fields):
    return a_packet(sequence, client, **{"deadline_ms": FAR_MS, **fields})


def test_answers_are_the_models(edge_model, tmp_path):
    log = tmp_path / "log.jsonl"

    async def test():
        async with an_edge(edge_model, log) as server, a_client(server.port) as client:
            assert client.greeting.fingerprint == edge_model.file.fingerprint
            assert not client.greeting.wants_key
            (plain,) = await client.ask(packet(1))
            (told,) = await client.ask(pack_request(packet(2), RobotState(4.0, 0.5, 20.0, 1.5)))
            return plain, told

    plain, told = run(test())
    action = edge_model.action_of("FS", 16)
    row, distinctness = edge_model.retrieved(
        action, edge_model.decoded(action, np.sin(np.arange(16, dtype=np.float32)))
    )
    for sequence, answer in ((1, plain), (2, told)):
        assert (answer.status, answer.client, answer.sequence) == ("ok", 3, sequence)
        assert answer.position_m == edge_model.position_m(row)
        assert answer.residual_m == pytest.approx(edge_model.residual_m(action, distinctness))
        assert answer.queue_ms >= 0
        assert answer.service_ms > 0
    first, second = events(log, "request")
    assert (first["risk_m"], first["urgency"], second["risk_m"], second["urgency"]) == (0.0, 1.0, 4.0, 1.5)
    parts = second["decode_ms"] + second["retrieve_ms"]
    assert 0 < parts <= second["service_ms"] + 1e-3
    assert [event["event"] for event in read_log(log)] == ["start", "request", "request", "summary"]
    assert events(log, "summary")[0]["ok"] == 2


@pytest.mark.parametrize("apart", [False, True])
@pytest.mark.parametrize("rule", POLICIES)
def test_every_rule_answers_everybody(edge_model, rule, apart):
    """Whether services are short, or long enough for a thread of their own."""

    async def test():
        async with an_edge(edge_model, rule=rule, in_flight=64, apart=apart) as server, a_client(server.port) as client:
            answers = await client.ask(*(packet(i) for i in range(40)))
            return server.counts, answers

    counts, answers = run(test())
    assert sorted(answer.sequence for answer in answers) == list(range(40))
    assert counts["ok"] == counts["requests"] == 40


def test_the_rule_decides_the_order(edge_model):
    """Three robots ask while a fourth is served; the earliest deadline goes first."""

    async def test():
        order = []

        async def one(port, client, deadline_ms, after):
            async with a_client(port) as robot:
                await after.wait()
                await robot.ask(packet(client=client, deadline_ms=deadline_ms))
                order.append(client)

        async with an_edge(edge_model, rule="edf", service_ms=10 * SLOW_MS) as server:
            at_once, later = asyncio.Event(), asyncio.Event()
            wanted = ((0, 50_000, at_once), (1, 40_000, later), (2, 20_000, later), (3, 30_000, later))
            tasks = [asyncio.create_task(one(server.port, *ask)) for ask in wanted]
            at_once.set()
            await until(lambda: server.counts["requests"] == 1)
            later.set()
            await asyncio.gather(*tasks)
        return order

    assert run(test()) == [0, 2, 3, 1]


def test_too_many_requests_of_one_robot_are_busy(edge_model):
    async def test():
        async with an_edge(edge_model, service_ms=SLOW_MS, in_flight=2) as server, a_client(server.port) as client:
            return server.counts, await client.ask(*(packet(i) for i in range(6)))

    counts, answers = run(test())
    assert [answer.sequence for answer in answers if answer.status == "busy"] == [2, 3, 4, 5]
    assert counts["busy"] == 4
    assert counts["ok"] == 2


@pytest.mark.parametrize("expire", [True, False])
def test_requests_past_their_deadline(edge_model, expire):
    async def test():
        async with (
            an_edge(edge_model, rule="fifo", service_ms=SLOW_MS, expire=expire) as server,
            a_client(server.port) as client,
        ):
            return await client.ask(packet(1), packet(2, deadline_ms=1))

    answers = {answer.sequence: answer for answer in run(test())}
    assert answers[1].status == "ok"
    assert answers[2].status == ("expired" if expire else "ok")
    assert answers[2].queue_ms >= 1.0


def test_what_it_does_not_serve_is_said(edge_model):
    async def test():
        async with an_edge(edge_model) as server, a_client(server.port) as client:
            return await client.ask(packet(1, k=17), packet(2))

    other, served = run(test())
    assert (other.status, served.status) == ("unsupported", "ok")
    assert np.isnan(other.position_m).all()


def test_codes_of_any_size_are_answered(edge_model):
    """Finite numbers that overflow in the network: an answer with the largest residual, or any other, and no crash."""
    from ovibjax.link.payload import Request, pack

    async def test():
        async with an_edge(edge_model) as server, a_client(server.port) as client:
            codes = [np.full(16, 3e38), np.full(16, -3e38), np.zeros(16)]
            packets = [pack(Request("FS", code, 1.0, FAR_MS, 3, i)) for i, code in enumerate(codes)]
            return await client.ask(*packets)

    assert [answer.status for answer in run(test())] == ["ok"] * 3


def test_what_waits_is_answered_before_it_stops(edge_model, tmp_path):
    log = tmp_path / "log.jsonl"

    async def test():
        async with an_edge(edge_model, log, service_ms=SLOW_MS) as server:
            reader = a_client(server.port)
            client = await reader.__aenter__()
            client.send(*(packet(i) for i in range(4)))
            await until(lambda: server.counts["requests"] == 4)
        answers = [await client.answer() for _ in range(4)]
        assert await client.gone()
        await reader.__aexit__(None, None, None)
        return server.counts, answers

    counts, answers = run(test())
    assert [answer.status for answer in answers] == ["ok"] * 4
    assert counts["ok"] == 4
    assert len(events(log, "request")) == 4
    assert not events(log, "refused")


def test_what_cannot_be_answered_in_time_is_told_so(edge_model):
    async def test():
        async with an_edge(edge_model, service_ms=20 * SLOW_MS, drain_s=0.1) as server:
            reader = a_client(server.port)
            client = await reader.__aenter__()
            client.send(packet(1), packet(2))
            await until(lambda: server.counts["requests"] == 2)
        answers = [await client.answer() for _ in range(2)]
        await reader.__aexit__(None, None, None)
        return server.counts, answers

    counts, answers = run(test())
    assert {answer.status for answer in answers} == {"closing"}
    assert counts["closing"] == counts["requests"] == 2


def test_requests_of_a_robot_that_is_gone_are_not_computed(edge_model, tmp_path):
    log = tmp_path / "log.jsonl"

    async def test():
        async with an_edge(edge_model, log, service_ms=SLOW_MS) as server:
            async with a_client(server.port) as client:
                client.send(*(packet(i) for i in range(4)))
                await until(lambda: server.counts["requests"] == 4)
            await until(lambda: server.counts["gone"] == 4)
            async with a_client(server.port) as other:
                (answer,) = await other.ask(packet(client=5))
            return answer

    assert run(test()).status == "ok"
    assert [event["status"] for event in events(log, "request")].count("gone") == 4


def test_a_port_that_is_taken_is_named(edge_model):
    async def test():
        async with an_edge(edge_model) as server:
            other = EdgeServer(edge_model, EdgeOptions(), RequestLog(None))
            other.warm_up = lambda: None
            with pytest.raises(InputError, match=f"--host 127.0.0.1 --port {server.port}: cannot listen there"):
                await other.serve("127.0.0.1", server.port, asyncio.Event(), lambda _: None)

    run(test())

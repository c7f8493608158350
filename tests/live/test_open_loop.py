"""An open loop sends what is due when it is due, and says of every request what became of it."""

import asyncio

import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.live.open_loop import Load, offer
from tests.live.edges import an_edge, events, run
from tests.live.test_edge_server import packet


def load_of(due_s, clients=3):
    count = len(due_s)
    client, sequence = np.arange(count) % clients, 5 + np.arange(count) // clients
    bodies = [packet(int(s), client=int(c)) for c, s in zip(client, sequence, strict=True)]
    return Load(client, sequence, np.asarray(due_s, float), bodies, {c: packet(4, client=c) for c in range(clients)})


def test_requests_leave_when_they_are_due(edge_model, tmp_path):
    log, due_s = tmp_path / "log.jsonl", np.linspace(0.0, 0.6, 24)

    async def test():
        async with an_edge(edge_model, log, service_ms=2.0, in_flight=64) as server:
            return await offer(server.port, load_of(due_s), 30.0)

    found = run(test())
    assert found.status == ["ok"] * 24
    np.testing.assert_allclose(np.diff(found.due_s), np.diff(due_s), atol=1e-9)
    assert (found.late_ms >= 0).all()
    assert (found.answered_s >= found.sent_s + 0.002).all()
    served = events(log, "request")
    assert len(served) == 24 + 3  # and a warm-up of each client, before all others
    assert sorted(event["sequence"] for event in served[:3]) == [4, 4, 4]
    ready_s = {(event["client"], event["sequence"]): event["ready_s"] for event in served}
    noticed_s = np.array([ready_s[i % 3, 5 + i // 3] for i in range(24)])
    # One clock on both sides.
    assert (noticed_s > found.sent_s - 1e-4).all() and (noticed_s < found.answered_s).all()


def test_an_edge_that_goes_is_said(edge_model):
    async def test():
        async with an_edge(edge_model, service_ms=5.0, in_flight=64) as server:
            asking = asyncio.create_task(offer(server.port, load_of(np.linspace(0.0, 20.0, 200)), 30.0))
            while not server.counts["ok"] > 10:
                await asyncio.sleep(0.01)
            for connection in list(server._connections):
                connection.drop("gone")
            with pytest.raises(InputError, match="ended a connection while it was asked"):
                await asking
        with pytest.raises(InputError, match=f"127.0.0.1:{server.port}: the edge cannot be reached"):
            await offer(server.port, load_of([0.0]), 1.0)

    run(test())


def test_an_edge_that_does_not_answer_is_not_waited_for(edge_model):
    async def test():
        async with an_edge(edge_model, service_ms=300.0, in_flight=64, drain_s=0.0) as server:
            with pytest.raises(InputError, match="of 12 requests within 2 s"):
                await offer(server.port, load_of([0.0] * 9), 2.0)

    run(test())

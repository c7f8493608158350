"""Edges started by another process: one line where one fails, and none left whatever ends the block."""

import asyncio
import os
import signal

import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.live.connection import Limits
from ovibjax.live.edge_process import EdgeProcess, command_of, edges_running
from ovibjax.live.edge_server import EdgeOptions
from ovibjax.live.log_report import read_runs
from ovibjax.live.open_loop import offer
from ovibjax.live.pacing import Pace
from tests.live.edges import events, run
from tests.live.test_open_loop import load_of

OPTIONS = EdgeOptions("edf", expire=False, pace=Pace(2.0, 3.0), limits=Limits(in_flight=64))


def pid_of(edge):
    return edge._process.pid


def is_gone(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


@pytest.fixture
def patient(monkeypatch):
    monkeypatch.setattr("tests.live.edges.LONGEST_S", 240.0)


def test_the_command_is_what_the_options_say(tmp_path):
    words = command_of(tmp_path / "edge.npz", OPTIONS, tmp_path / "log")
    assert words[1:6] == ["-m", "ovibjax", "edge", "serve", str(tmp_path / "edge.npz")]
    told = dict(zip(words[6:-1:2], words[7:-1:2], strict=True))
    served = {"--port": "0", "--rule": "edf", "--service-ms": "2.0", "--paper-speed": "3.0"}
    assert told == served | {"--log": str(tmp_path / "log"), "--in-flight": "64"}
    assert words[-1] == "--serve-late"


def test_an_edge_that_does_not_begin_says_why(tmp_path, patient):
    edges = [EdgeProcess(OPTIONS, tmp_path / "log")]

    async def test():
        with pytest.raises(
            InputError, match=r"ended before it listened \(code 2\): ovibjax: .*none\.npz: no such file"
        ):
            async with edges_running(tmp_path / "none.npz", edges):
                pass

    run(test())
    assert is_gone(pid_of(edges[0]))


@pytest.mark.slow
def test_edges_serve_side_by_side_and_end_with_their_summary(edge_path, tmp_path, patient):
    edges = [EdgeProcess(EdgeOptions(rule, pace=Pace(2.0)), tmp_path / rule) for rule in ("fifo", "edf")]

    async def test():
        async with edges_running(edge_path, edges):
            assert edges[0].port != edges[1].port
            for edge in edges:
                await offer(edge.port, load_of(np.linspace(0.0, 0.5, 12)), 30.0)

    run(test())
    for edge in edges:
        (log,) = read_runs([edge.log])
        assert log.finished and log.ended == {"ok": 15} and log.name == edge.options.rule
        assert is_gone(pid_of(edge))
    assert len(events(edges[0].log, "summary")) == 1


@pytest.mark.slow
def test_an_edge_that_was_killed_is_said_and_the_other_is_ended(edge_path, tmp_path, patient):
    edges = [EdgeProcess(OPTIONS, tmp_path / name) for name in ("a", "b")]

    async def test():
        with pytest.raises(InputError, match=r"ended (a connection )?while it was asked"):
            async with edges_running(edge_path, edges):
                asking = asyncio.create_task(offer(edges[0].port, load_of(np.linspace(0.0, 60.0, 600)), 30.0))
                await asyncio.sleep(1.0)
                os.kill(pid_of(edges[0]), signal.SIGKILL)
                await asking

    run(test())
    assert all(is_gone(pid_of(edge)) for edge in edges)


@pytest.mark.slow
def test_a_cancelled_block_leaves_no_edge(edge_path, tmp_path, patient):
    edges = [EdgeProcess(OPTIONS, tmp_path / name) for name in ("a", "b")]

    async def test():
        begun = asyncio.Event()

        async def block():
            async with edges_running(edge_path, edges):
                begun.set()
                await asyncio.sleep(1000.0)

        task = asyncio.create_task(block())
        await begun.wait()
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    run(test())
    assert all(is_gone(pid_of(edge)) for edge in edges)

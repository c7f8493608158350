"""Real processes: killed edges and killed robots, and what both sides' logs say of it."""

import asyncio
import os
import re
import signal
import subprocess
import sys
from collections import Counter
from contextlib import contextmanager

import pytest

from ovibjax.errors import InputError
from ovibjax.live.fleet import drive_fleet, summary_of
from ovibjax.live.robot_process import RobotJob
from tests.live.edges import events, run

pytestmark = pytest.mark.slow


@contextmanager
def a_process(path, log, port=0, *options):
    """`ovibjax edge serve` in a process of its own, listening."""
    command = [sys.executable, "-m", "ovibjax", "edge", "serve", str(path), "--port", str(port), "--log", str(log)]
    with subprocess.Popen([*command, *options], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        try:
            said = process.stdout.readline()
            process.port = int(re.search(r":(\d+),", said)[1])
            yield process
        finally:
            if process.poll() is None:
                process.kill()


def job_of(path, port, log, **changes):
    given = {"policy": "fixed_front", "profile_kb_per_s": 12.0, "seconds": 60.0, "speed": 6.0, "clients": (0, 1, 2, 3)}
    return RobotJob(str(path), "127.0.0.1", port, log=str(log), **given | changes)


async def driven(job, meanwhile, processes=2):
    """Drive a fleet; `meanwhile` runs from the first sign of life on."""
    alive, stop = asyncio.Event(), asyncio.Event()
    fleet = asyncio.create_task(drive_fleet(job, processes, stop, lambda ended, _: alive.set() if ended else None))
    started = asyncio.create_task(alive.wait())
    await asyncio.wait([fleet, started], return_when=asyncio.FIRST_COMPLETED)
    if not fleet.done():
        await meanwhile()
    return await fleet


def account(robots_log, edge_log):
    """Both sides agree on what was asked and answered."""
    questions, requests = events(robots_log, "question"), events(edge_log, "request")
    known = {(r["client"], r["sequence"]): r["status"] for r in requests}
    for q in questions:
        if q["status"] in ("ok", "expired", "busy", "closing"):
            assert known[q["client"], q["sequence"]] == q["status"], q
    asked = {(q["client"], q["sequence"]) for q in questions}
    assert known.keys() <= asked
    return Counter(q["status"] for q in questions)


@pytest.fixture
def logs(tmp_path, monkeypatch):
    monkeypatch.setattr("tests.live.edges.LONGEST_S", 240.0)
    return tmp_path / "edge.jsonl", tmp_path / "robots.jsonl"


def test_a_killed_edge_is_missed_and_found_again(edge_path, logs):
    """SIGKILL while robots drive, three seconds of nothing, and another edge at the same port."""
    edge_log, robots_log = logs

    async def test():
        with a_process(edge_path, edge_log) as first:
            again = []

            async def kill_and_restart():
                first.send_signal(signal.SIGKILL)
                await asyncio.sleep(3.0)
                second = a_process(edge_path, edge_log, first.port)
                again.append((second, await asyncio.to_thread(second.__enter__)))

            try:
                # Long enough for the second edge to compile.
                return await driven(job_of(edge_path, first.port, robots_log, seconds=240.0), kill_and_restart)
            finally:
                for second, process in again:
                    process.send_signal(signal.SIGTERM)
                    assert process.wait(30) == 0
                    second.__exit__(None, None, None)

    result = run(test())
    assert [robot["client"] for robot in result.robots] == [0, 1, 2, 3]
    assert all(robot["connections"]["connected"] >= 2 for robot in result.robots)
    ended = account(robots_log, edge_log)
    assert ended == result.ended
    assert ended["ok"] > 0
    tracks = events(robots_log, "track")
    assert sorted(track["client"] for track in tracks) == [0, 1, 2, 3]
    assert {len(track["errors_m"]) for track in tracks} == {480}
    assert len(events(edge_log, "start")) == 2
    assert "questions" in summary_of(result)


def test_killed_robots_cost_themselves_alone(edge_path, logs):
    edge_log, robots_log = logs

    async def test():
        with a_process(edge_path, edge_log) as edge:

            async def kill_one():
                robots = subprocess.run(
                    ["ps", "-o", "pid=,args=", "--ppid", str(os.getpid())], capture_output=True, text=True, check=True
                ).stdout
                (pid, *_) = re.findall(r"(\d+) .*robot_process", robots)
                os.kill(int(pid), signal.SIGKILL)

            result = await driven(job_of(edge_path, edge.port, robots_log), kill_one)
            edge.send_signal(signal.SIGTERM)
            assert edge.wait(30) == 0
            return result, edge.stdout.read()

    result, said = run(test())
    assert len(result.robots) == len(result.gone) == 2
    assert "summary: " in said
    account(robots_log, edge_log)
    assert not events(edge_log, "refused")


def test_sigterm_with_nobody_there(edge_path, logs):
    with a_process(edge_path, logs[0]) as edge:
        edge.send_signal(signal.SIGTERM)
        assert edge.wait(30) == 0
        assert "summary:" in edge.stdout.read()
    assert [event["event"] for event in (*events(logs[0], "start"), *events(logs[0], "summary"))] == [
        "start",
        "summary",
    ]


def test_a_fleet_that_cannot_begin_says_why(tmp_path):
    path = tmp_path / "none.npz"
    with pytest.raises(InputError, match=r"none\.npz: no such file"):
        run(drive_fleet(RobotJob(str(path), "127.0.0.1", 1, (0, 1)), 2, asyncio.Event()))

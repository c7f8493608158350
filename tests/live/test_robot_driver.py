"""Robots in real time beside an edge in the same loop: all that was asked is accounted for on both sides."""

import asyncio
from collections import Counter
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.live.request_log import RequestLog
from ovibjax.live.robot_driver import RobotDriver, WorldClock
from ovibjax.live.robot_link import RobotLink
from ovibjax.live.robot_process import RobotJob, robot_of, sending_of, world_of
from tests.live.edges import an_edge, events, run
from tests.live.test_robot_link import address_of

SPEED = 10.0


def job_of(path, port, **changes):
    given = {"policy": "uncertainty", "profile_kb_per_s": 12.0, "seconds": 20.0, "speed": SPEED, "clients": (0, 1, 2)}
    return RobotJob(str(path), "127.0.0.1", port, **given | changes)


async def drive(job, address, file, log, meanwhile=None):
    """Drive the robots of a job in this loop."""
    world, loop = world_of(job, file), asyncio.get_running_loop()
    with RequestLog(log) as written:
        made = [robot_of(job, world, number) for number in job.clients]
        robot_of(job, world, 0)[0].warm_up()
        clock, stop = WorldClock(loop.time(), job.speed), asyncio.Event()
        links = [RobotLink(address, number) for number in job.clients]
        keeping = [asyncio.create_task(link.stay_connected()) for link in links]
        while not all(link.connected for link in links):
            await asyncio.sleep(0.01)
        drivers = [
            RobotDriver(robot, link, mission, clock, written, sending_of(job, file))
            for (robot, mission), link in zip(made, links, strict=True)
        ]
        driving = asyncio.gather(*(driver.drive(stop) for driver in drivers))
        if meanwhile is not None:
            await meanwhile(stop)
        driven = await driving
        for task in keeping:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task
    return driven


def test_both_sides_account_for_every_question(edge_model, edge_path, edge_file, tmp_path):
    logs = tmp_path / "edge.jsonl", tmp_path / "robots.jsonl"

    async def test():
        async with an_edge(edge_model, logs[0]) as server:
            job = job_of(edge_path, server.port)
            return server, await drive(job, address_of(server, edge_model), edge_file, logs[1])

    server, driven = run(test())
    ended = sum((one.ended for one in driven), Counter())
    assert ended["ok"] > 0
    assert server.counts["requests"] == ended.total() - ended["unsent"]
    requests, questions = events(logs[0], "request"), events(logs[1], "question")
    asked = {(q["client"], q["sequence"]) for q in questions if q["status"] != "unsent"}
    assert {(r["client"], r["sequence"]) for r in requests} == asked
    assert len(asked) == len(requests)
    for one in driven:
        assert len(one.errors_m) == 40
        assert np.isfinite(one.errors_m).all()
    tracks = events(logs[1], "track")
    assert [track["client"] for track in tracks] and all(len(track["errors_m"]) == 40 for track in tracks)
    answered = [q for q in questions if q["status"] == "ok"]
    expected = {round(float(np.hypot(*r)), 3) for r in edge_file.route_residual_m.reshape(-1, 2)}
    assert {round(q["residual_m"], 3) for q in answered} <= expected
    assert all(q["e2e_ms"] >= q["uplink_ms"] for q in answered)


def test_a_robot_that_loses_its_edge_goes_on(edge_model, edge_path, edge_file, tmp_path):
    """Connections are cut again and again; every robot drives its route to the end with a belief."""
    log = tmp_path / "robots.jsonl"

    async def test():
        async with an_edge(edge_model, service_ms=20.0) as server:

            async def meanwhile(stop):
                for _ in range(6):
                    await asyncio.sleep(0.3)
                    for connection in list(server._connections):
                        connection.drop("cut")

            job = job_of(edge_path, server.port, policy="fixed_front")
            return await drive(job, address_of(server, edge_model), edge_file, log, meanwhile)

    for one in run(test()):
        assert len(one.errors_m) == 40
        assert np.isfinite(one.errors_m).all()
    kinds = {event["status"] for event in events(log, "question")}
    assert kinds <= {"ok", "lost", "unsent", "timeout", "expired"}


def test_told_to_stop_it_stops_and_says_what_became_of_it(edge_model, edge_path, edge_file, tmp_path):
    log = tmp_path / "robots.jsonl"

    async def test():
        async with an_edge(edge_model) as server:

            async def meanwhile(stop):
                await asyncio.sleep(0.3)
                stop.set()

            job = job_of(edge_path, server.port, seconds=10_000.0)
            return await drive(job, address_of(server, edge_model), edge_file, log, meanwhile)

    for one in run(test()):
        assert 1 <= len(one.errors_m) < 2000


def test_a_robots_draws_depend_on_seed_and_number_alone(edge_path, edge_file):
    job = job_of(edge_path, 1)
    world = world_of(job, edge_file)
    (one, mission), (again, same) = robot_of(job, world, 2), robot_of(job_of(edge_path, 2, clients=(2,)), world, 2)
    other, another = robot_of(job_of(edge_path, 1, seed=7), world, 2)
    np.testing.assert_array_equal(one.rows, again.rows)
    np.testing.assert_array_equal(mission.deadlines_ms, same.deadlines_ms)
    assert (mission.urgency, mission.phase_s) == (same.urgency, same.phase_s)
    assert mission.urgency != another.urgency
    assert not np.array_equal(one.draws.rate_bps, other.draws.rate_bps)


def test_the_budget_grows_with_the_drive(edge_path, edge_file):
    def budget_kb(**changes):
        return float(world_of(job_of(edge_path, 1, **changes), edge_file).params.control.budget_bytes) / 1024

    assert budget_kb(seconds=296.5) == pytest.approx(2.1)
    assert budget_kb(seconds=593.0) == pytest.approx(4.2)
    assert budget_kb(seconds=593.0, budget_kb=1.0) == pytest.approx(1.0)


def test_robots_that_adapt_drive_beside_an_edge(edge_model, edge_path, edge_file, tmp_path):
    log = tmp_path / "robots.jsonl"

    async def test():
        async with an_edge(edge_model) as server:
            job = job_of(edge_path, server.port, policy="voi", adapt="reported", budget_kb=50.0, seconds=40.0)
            return await drive(job, address_of(server, edge_model), edge_file, log)

    driven = run(test())
    assert all(len(one.errors_m) == 80 for one in driven)
    answered = [event for event in events(log, "question") if event["status"] == "ok"]
    assert sum(one.ended["ok"] for one in driven) == len(answered) > 0


def test_what_cannot_adapt_is_refused(edge_path, edge_file):
    for changes, words in (
        ({"policy": "uncertainty", "adapt": "reported"}, "uncertainty"),
        ({"policy": "voi", "adapt": "hearsay"}, "none, innovation, reported"),
    ):
        with pytest.raises(InputError, match=words):
            world_of(job_of(edge_path, 1, **changes), edge_file)
    old = replace(edge_file, expected_m={})
    with pytest.raises(InputError, match="edge export"):
        world_of(job_of(edge_path, 1, policy="voi", adapt="reported"), old)
    assert world_of(job_of(edge_path, 1, policy="voi"), old).adapt == "none"

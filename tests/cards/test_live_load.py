"""Loads are what robots would send: the same at every rule, in the order in which it is due, each request once."""

import numpy as np
import pytest

from ovibjax.cards.live_load import all_at_once, poisson_load, recorded_requests
from ovibjax.control.route_replay import replay_draws
from ovibjax.errors import InputError
from ovibjax.live.messages import unpack_request
from ovibjax.live.robot_process import RobotJob, robot_of, world_of
from tests.live.cases import tiny_edge

JOB = RobotJob("none.npz", "127.0.0.1", 1, (0, 1, 2), "periodic", seconds=60.0, budget_kb=5.0)


@pytest.fixture(scope="module")
def file():
    return tiny_edge()


@pytest.fixture(scope="module")
def recorded(file):
    return recorded_requests(JOB, file)


def test_what_is_recorded_is_what_the_replay_sends(file, recorded):
    assert len(recorded) == 3
    world = world_of(JOB, file)
    for number, mine in enumerate(recorded):
        robot, mission = robot_of(JOB, world, number)
        run = replay_draws(robot.draws, robot.route, "periodic", world.params, file.actions)
        slots = np.flatnonzero(run.sent)
        assert len(mine) == len(slots) > 0
        for one, slot in zip(mine, slots, strict=True):
            action = int(run.action[slot])
            assert len(one.prefix) == file.actions.prefix[action]
            assert one.mode == file.actions.modes[action // len(file.actions.prefixes)]
            assert one.voi_m == float(run.voi_m[slot]) and one.state.risk_m == float(run.risk_before_m[slot])
            assert one.state.delay_est_ms == pytest.approx(1000 * float(run.delay_s[slot]))
            assert (one.state.urgency, one.deadline_ms) == (mission.urgency, int(mission.deadlines_ms[slot]))
            sent_ms = 1000 * 8 * float(file.actions.payload_bytes[action]) / (4 * 8192)
            assert 31 < one.uplink_ms - sent_ms < 36


def test_a_load_is_in_order_and_its_bytes_are_the_requests(recorded):
    load, uplink_ms, mode = poisson_load((100, 1), recorded, 50.0, 4.0, 2)
    assert len(load.bodies) == len(mode) == 200
    assert (np.diff(load.due_s) >= 0).all() and load.due_s[0] >= uplink_ms[0] / 1000
    assert load.due_s[-1] == pytest.approx(4.0, rel=0.35)
    for c in range(3):
        mine = np.flatnonzero(load.client == c)
        np.testing.assert_array_equal(load.sequence[mine], 2 * 4096 + 1 + np.arange(len(mine)))
        request, state = unpack_request(load.warm[c])
        assert (request.client, request.sequence) == (c, 2 * 4096)
        taken = []
        for j in mine:
            request, state = unpack_request(load.bodies[j])
            assert (request.client, request.sequence, request.mode) == (c, load.sequence[j], mode[j])
            asked = (request.voi_m, request.deadline_ms, state.risk_m)
            taken.append(
                [(np.float32(o.voi_m), o.deadline_ms, np.float32(o.state.risk_m)) for o in recorded[c]].index(asked)
            )
        # A client asks what its robot asked, in turn, again and again.
        assert set(taken) == set(range(len(recorded[c])))


def test_a_seed_gives_a_load_and_numbers_tell_loads_apart(recorded):
    one, again, other = (
        poisson_load(seed, recorded, 50.0, 1.0, n) for seed, n in (((1, 0), 1), ((1, 0), 1), ((2, 0), 2))
    )
    assert one.load.bodies == again.load.bodies
    assert not set(one.load.sequence) & set(other.load.sequence)
    assert not np.array_equal(one.load.due_s, other.load.due_s)


def test_all_at_once_is_due_at_once(recorded):
    load, _, _ = all_at_once(recorded, 7, 0)
    np.testing.assert_allclose(load.due_s, 0.0, atol=1e-12)
    assert sorted(load.client.tolist()) == [0, 0, 0, 1, 1, 2, 2]


def test_robots_that_ask_nothing_are_no_load(file):
    with pytest.raises(InputError, match="sends no request"):
        recorded_requests(RobotJob("none.npz", "127.0.0.1", 1, (0,), "periodic", seconds=2.0, budget_kb=0.001), file)

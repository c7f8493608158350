"""A robot that is answered when the replay says does what the replay does, slot by slot."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.control.adaptation import ADAPT, make_adaptation
from ovibjax.control.client_state import ControlParams
from ovibjax.control.controller import make_controller
from ovibjax.control.environment import make_environment
from ovibjax.control.route_replay import replay_draws
from ovibjax.live.edge_model import EdgeModel
from ovibjax.live.robot import LIVE_POLICIES, Robot, World
from ovibjax.views import mode_mask

SLOTS = 80


def world_of(file, policy="voi", **changes):
    env = make_environment(file.context_share, 4.0, drift_scale=3.0)._replace(**changes)
    control = make_controller(file.actions, bandwidth_m_per_s=20.0, delay_m_per_s=0.5, budget_kb=50.0)
    return World(file, ControlParams(env, control), policy, SLOTS)


def lived(robot, world):
    """Drive a robot whose answers come as late as the replay has them."""
    draws, env = robot.draws, world.params.env
    timeout_s, slot_s = float(env.timeout_s), float(env.slot_s)
    due, errors, decisions = {}, [], []
    for slot in range(SLOTS):
        for asked, action, lost in due.pop(slot, []):
            if lost:
                robot.given_up(asked)
            else:
                residual_m = np.asarray(robot.route.residual_m)[asked, action]
                robot.corrected(asked, residual_m, robot.route.risk_m[asked, action], slot - 1)
        decided = robot.tick(slot, True, np.asarray(draws.delay_s[slot]))
        decisions.append(decided)
        if decided.send:
            a = decided.action
            size = float(world.file.actions.payload_bytes[a])
            latency_s = np.float32(8 * size) / np.float32(draws.rate_bps[slot]) + np.float32(draws.latency_s[slot, a])
            flight = int(min(latency_s, timeout_s) // slot_s)
            if flight == 0:
                robot.corrected(slot, np.asarray(robot.route.residual_m)[slot, a], robot.route.risk_m[slot, a], slot)
            else:
                due.setdefault(slot + flight, []).append((slot, a, latency_s > timeout_s))
        errors.append(robot.error_m())
    return np.array(errors), decisions


@pytest.mark.parametrize("policy", LIVE_POLICIES)
@pytest.mark.parametrize("queue_ms", [20.0, 900.0, 5000.0])
def test_answers_as_late_as_in_the_replay_give_the_replay(policy, queue_ms, edge_file):
    world = world_of(edge_file, policy, queue_median_ms=jnp.float32(queue_ms))
    robot = Robot(world, 1, jax.random.key(3))
    expected = jax.device_get(replay_draws(robot.draws, robot.route, policy, world.params, edge_file.actions))
    errors, decisions = lived(robot, world)
    sent = np.array([decided.send for decided in decisions])
    np.testing.assert_array_equal(sent, expected.sent)
    assert sent.any()
    np.testing.assert_array_equal(np.array([d.action for d in decisions])[sent], expected.action[sent])
    for name, theirs in (("voi_m", "voi_m"), ("risk_m", "risk_before_m"), ("delay_s", "delay_s")):
        found = np.array([getattr(d, name) for d in decisions])
        mask = sent if name != "risk_m" else slice(None)
        np.testing.assert_allclose(found[mask], getattr(expected, theirs)[mask], rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(errors, expected.error_m, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("adapt", ADAPT[1:])
@pytest.mark.parametrize("queue_ms", [20.0, 900.0])
def test_a_robot_that_adapts_does_what_the_adapted_replay_does(adapt, queue_ms, edge_file):
    world = world_of(edge_file, "voi", queue_median_ms=jnp.float32(queue_ms))
    numbers = make_adaptation(adapt, edge_file.expected_m[adapt], probe_every=4)
    world = replace(world, adapt=adapt, params=world.params._replace(adaptation=numbers))
    robot = Robot(world, 1, jax.random.key(3))
    arguments = robot.draws, robot.route, "voi", world.params, edge_file.actions
    expected, fixed = (jax.device_get(replay_draws(*arguments, adapt=kind)) for kind in (adapt, "none"))
    errors, decisions = lived(robot, world)
    sent = np.array([decided.send for decided in decisions])
    np.testing.assert_array_equal(sent, expected.sent)
    np.testing.assert_array_equal(np.array([d.action for d in decisions])[sent], expected.action[sent])
    np.testing.assert_allclose(errors, expected.error_m, rtol=1e-4, atol=1e-3)
    assert not np.array_equal(expected.action[sent], fixed.action[sent])  # something was learned


def test_robots_have_routes_and_draws_of_their_own(edge_file):
    world = world_of(edge_file)
    robots = [Robot(world, number, jax.random.key(0)) for number in range(4)]
    again = Robot(world, 2, jax.random.key(0))
    assert [set(edge_file.route_number[robot.rows]) for robot in robots] == [{0}, {1}, {0}, {1}]
    rates = {tuple(np.asarray(robot.draws.rate_bps).tolist()) for robot in robots}
    assert len(rates) == 4
    np.testing.assert_array_equal(again.draws.rate_bps, robots[2].draws.rate_bps)


def test_what_is_sent_is_the_code_of_the_frame(edge_file):
    robot, model = Robot(world_of(edge_file), 0, jax.random.key(0)), EdgeModel(edge_file)
    for slot, action in ((0, 0), (7, 3), (11, 7)):
        prefix = robot.encoded(slot, action)
        assert prefix.shape == (edge_file.actions.prefix[action],)
        row, _ = model.retrieved(action, model.decoded(action, prefix))
        found = robot.residual_m(slot, model.position_m(row))
        np.testing.assert_allclose(found, edge_file.route_residual_m[robot.rows[slot], action], atol=1e-4)
        assert mode_mask(edge_file.actions.modes[action // 2], edge_file.arch.n_views).any()


def test_without_a_connection_nothing_is_asked(edge_file):
    robot = Robot(world_of(edge_file, "uncertainty"), 0, jax.random.key(0))
    decisions = [robot.tick(slot, slot >= 60, np.zeros(8, np.float32)) for slot in range(SLOTS)]
    assert not any(decided.send for decided in decisions[:60])
    assert any(decided.send for decided in decisions[60:])


def test_an_answer_to_an_older_question_is_not_used(edge_file):
    robot = Robot(world_of(edge_file, "periodic"), 0, jax.random.key(0))
    sent = [s for s in range(SLOTS) if robot.tick(s, True, np.zeros(8, np.float32)).send]
    assert len(sent) >= 2
    before = robot.error_m()
    robot.corrected(sent[0], (0.0, 0.0), 0.5, SLOTS - 1)
    robot.given_up(sent[0])
    assert robot.error_m() == before
    assert robot.waiting
    robot.corrected(sent[-1], (0.0, 0.0), 0.5, sent[-1])
    assert robot.error_m() == 0.0
    assert not robot.waiting

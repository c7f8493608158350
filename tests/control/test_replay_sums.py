"""Sums without histories: the decisions of the oracle in every slot, and those of the steps that make histories."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.control.actions import ACTIONS, actions_for
from ovibjax.control.client_state import ControlParams
from ovibjax.control.drift import DRIFT_MODELS
from ovibjax.control.environment import draw
from ovibjax.control.planning import FOLLOW_VOI, plan
from ovibjax.control.policies import POLICIES
from ovibjax.control.replay_sums import replaces, replay_sums, sums_by_slots, sums_by_steps
from ovibjax.control.route_summary import score
from tests.control.cases import SLOTS, WORLDS, controller, draw_jit, environment, for_oracle, make_route, world
from tests.oracles import control as oracle

PLAIN = [name for name in WORLDS if bool(replaces(world(name)))]
SEEDS = range(3)
ROUTES = jax.tree.map(lambda *leaves: jnp.stack(leaves), *[make_route(seed) for seed in SEEDS])
KEYS = jax.vmap(jax.random.key)(jnp.arange(len(SEEDS)))


def stacked(trees):
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


def test_what_the_scan_is_for():
    assert set(WORLDS) - set(PLAIN) == {"kalman, weak link", "gate bites", "gate of a replacement"}
    assert len(PLAIN) > 8


OFTEN = ("voi", "random", "oracle_action", "uncertainty")


@pytest.mark.parametrize("policy", [p if p in OFTEN else pytest.param(p, marks=pytest.mark.long) for p in POLICIES])
def test_equals_the_oracle_in_every_slot(policy):
    params = stacked([world(name) for name in PLAIN])

    @jax.jit
    def run(params, planned):
        def one(key, route, params, planned):
            return sums_by_slots(draw(key, route, params.env, ACTIONS), route, policy, planned, params, ACTIONS)

        return jax.vmap(jax.vmap(one, (0, 0, None, 0)), (None, None, 0, 0))(KEYS, ROUTES, params, planned)

    want, planned = {}, np.zeros((len(PLAIN), len(SEEDS), SLOTS), bool)
    for w, name in enumerate(PLAIN):
        for s, seed in enumerate(SEEDS):
            route, here = make_route(seed), world(name)
            draws = draw_jit(jax.random.key(seed), route, here.env, ACTIONS)
            arguments = for_oracle(draws, route, here)
            voi = oracle.replay("voi", *arguments)["sent"] if policy in FOLLOW_VOI else np.zeros(SLOTS, bool)
            planned[w, s] = plan(draws, policy, here, jnp.asarray(voi))
            want[w, s] = oracle.replay(policy, *arguments)
    found = jax.tree.map(np.asarray, run(params, planned))
    for (w, s), one in want.items():
        action = np.where(one["sent"], one["action"], -1)
        np.testing.assert_array_equal(found.action[w, s], action, err_msg=f"{PLAIN[w]}, seed {s}")
        assert found.requests[w, s] == one["sent"].sum() and found.sent_bytes[w, s] == one["payload"].sum()
        np.testing.assert_allclose(found.error_m[w, s], one["error"].sum(), rtol=1e-4)
        np.testing.assert_allclose(found.risk_m[w, s], one["risk"].sum(), rtol=1e-4)


LANES = 24


def random_params(rng):
    """A world and a controller that do something, corrections that replace the estimate or are taken always."""

    def log(low, high):
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    env = environment(
        model=str(rng.choice(list(DRIFT_MODELS))),
        rate_m_per_s=rng.uniform(0.1, 3.0, 3),
        initial_risk_m=rng.uniform(0.5, 9.0),
        mean_kb_per_s=log(0.1, 10.0),
        rician_k_factor=rng.choice([0.0, 6.0]),
        snr=log(0.05, 10.0),
        queue_median_ms=log(10.0, 900.0),
        timeout_s=rng.uniform(0.3, 6.0),
        slot_s=rng.choice([0.25, 0.5, 1.0]),
    )
    control = controller(
        prices={
            "bandwidth_m_per_s": rng.choice([0.0, log(0.01, 30.0)]),
            "delay_m_per_s": rng.choice([0.0, log(0.01, 30.0)]),
            "energy_m_per_j": rng.uniform(0.0, 2.0),
        },
        threshold_m=rng.uniform(-1.0, 5.0),
        min_gap_s=rng.choice([0.0, 0.5, 3.0]),
        budget_bytes=rng.choice([0.0, 300.0, 2150.4, np.inf]),
        energy_j=rng.integers(0, 9, 8) / 4.0,
        energy_budget_j=rng.choice([3.0, 20.0, np.inf]),
        available=rng.random(8) < 0.9,
        correction=int(rng.integers(0, 2)),
        rules={
            "fixed_front_risk_m": rng.uniform(1.0, 8.0),
            "fixed_front_gap_s": rng.uniform(0.0, 3.0),
            "uncertainty_risk_m": rng.uniform(1.0, 8.0),
            "uncertainty_gap_s": rng.uniform(0.0, 3.0),
        },
    )
    return ControlParams(env, control)


def of_kind(params, kind):
    """Nothing runs out, payload alone, or whatever it is: what the scan tells apart."""
    control = params.control
    if kind != "any":
        zero, all_of_them = jnp.zeros_like(control.energy_j), jnp.ones_like(control.available)
        control = control._replace(energy_j=zero, available=all_of_them)
    if kind == "unlimited":
        control = control._replace(budget_bytes=jnp.full_like(control.budget_bytes, jnp.inf))
    return params._replace(control=control)


def compared(policy):
    """Both scans, mapped over routes, seeds and parameters."""

    def one(key, route, params, scheduled):
        draws = draw(key, route, params.env, ACTIONS)
        arguments = draws, route, policy, scheduled, params, ACTIONS
        return sums_by_slots(*arguments), sums_by_steps(*arguments)

    return jax.jit(jax.vmap(one))


COMPARED = {policy: compared(policy) for policy in ("voi_gap", "oracle_action", "random", "uncertainty")}


@pytest.mark.parametrize("policy", ["voi_gap", *(pytest.param(p, marks=pytest.mark.long) for p in list(COMPARED)[1:])])
@settings(max_examples=20, deadline=None, derandomize=True)
@given(seed=st.integers(0, 1 << 20), kind=st.sampled_from(["unlimited", "payload", "any"]))
def test_scans_agree(policy, seed, kind):
    rng = np.random.default_rng(seed)
    params = of_kind(stacked([random_params(rng) for _ in range(LANES)]), kind)
    routes = stacked([make_route(int(rng.integers(0, 1 << 30)), 40) for _ in range(LANES)])
    keys = jax.vmap(jax.random.key)(jnp.asarray(rng.integers(0, 1 << 30, LANES)))
    scheduled = rng.random((LANES, 40)) < rng.uniform(0.0, 0.6, (LANES, 1))
    slots, steps = jax.tree.map(np.asarray, COMPARED[policy](keys, routes, params, scheduled))
    np.testing.assert_array_equal(slots.action, steps.action)
    np.testing.assert_array_equal(slots.requests, (steps.action >= 0).sum(axis=1))
    np.testing.assert_array_equal(slots.sent_bytes, steps.sent_bytes)
    np.testing.assert_allclose(slots.error_m, steps.error_m, rtol=1e-4)
    np.testing.assert_allclose(slots.risk_m, steps.risk_m, rtol=1e-4)


def test_any_correction_goes_by_the_scan_that_knows_it():
    names = ["weak link", "always", "gate bites", "gate of a replacement", "kalman, weak link"]

    @jax.jit
    def run(params, key):
        route = make_route(3)
        return replay_sums(draw(key, route, params.env, ACTIONS), route, "voi", jnp.zeros(SLOTS, bool), params, ACTIONS)

    together = jax.tree.map(np.asarray, jax.jit(jax.vmap(run, (0, None)))(stacked([world(n) for n in names]), KEYS[2]))
    for w, name in enumerate(names):
        route, here = make_route(3), world(name)
        want = oracle.replay("voi", *for_oracle(draw_jit(KEYS[2], route, here.env, ACTIONS), route, here))
        alone = jax.tree.map(np.asarray, run(here, KEYS[2]))
        for found in (alone, jax.tree.map(lambda leaf, w=w: leaf[w], together)):
            np.testing.assert_array_equal(found.action, np.where(want["sent"], want["action"], -1))
            np.testing.assert_allclose(
                [found.error_m, found.risk_m], [want["error"].sum(), want["risk"].sum()], rtol=1e-4
            )


@pytest.mark.parametrize("policy", ["random", pytest.param("budgeted_periodic", marks=pytest.mark.long)])
def test_score_of_a_policy_that_follows_voi_control(policy):
    route, here = make_route(1), world("tight budget")
    draws = draw_jit(KEYS[1], route, here.env, ACTIONS)
    found = jax.jit(score, static_argnames="policy")(draws, route, policy, here)
    want = oracle.replay(policy, *for_oracle(draws, route, here))
    assert int(found.requests) == want["sent"].sum() > 2
    np.testing.assert_allclose([found.mean_m, found.risk_m], [want["error"].mean(), want["risk"].mean()], rtol=1e-4)


def test_six_actions_and_one_slot():
    actions = actions_for(4, ACTIONS)
    control = controller(actions, threshold_m=0.5, min_gap_s=0.0)
    here = ControlParams(environment(initial_risk_m=9.0), control)
    for slots in (1, 30):
        route = make_route(4, slots, actions=6)
        draws = draw_jit(KEYS[0], route, here.env, actions)
        run = jax.jit(sums_by_slots, static_argnames=("policy", "actions"))
        found = run(draws, route, "voi_gap", jnp.zeros(slots, bool), here, actions)
        want = oracle.replay("voi_gap", *for_oracle(draws, route, here, actions))
        np.testing.assert_array_equal(found.action, np.where(want["sent"], want["action"], -1))
        assert found.requests > 0
        np.testing.assert_allclose(found.error_m, want["error"].sum(), rtol=1e-4)

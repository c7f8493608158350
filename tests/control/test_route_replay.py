"""The compiled replay against the NumPy loop, slot by slot, and its edges."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.control import route_replay as replay
from ovibjax.control.actions import ACTIONS, actions_for
from ovibjax.control.client_state import ControlParams
from ovibjax.control.planning import FOLLOW_VOI
from ovibjax.control.policies import POLICIES
from tests.control.cases import (
    BUSY,
    EAGER,
    QUICK_RULES,
    SLOTS,
    WEAK,
    WORLDS,
    assert_equal,
    both,
    controller,
    draw_jit,
    environment,
    make_route,
    simulate,
    world,
)

SEEDS = range(4)


@pytest.mark.parametrize("policy", POLICIES)
def test_equals_the_oracle_in_every_slot(policy):
    seen = dict.fromkeys(("sent", "lost", "superseded", "accepted", "late", "refused"), 0)
    for name in WORLDS:
        requests = 0
        for seed in SEEDS:
            found, expected = both(policy, jax.random.key(seed), make_route(seed), world(name))
            assert_equal(found, expected)
            requests += expected["sent"].sum()
            for kind in ("sent", "lost", "superseded", "accepted"):
                seen[kind] += expected[kind].sum()
            seen["late"] += ((expected["flight"] > 1) & ~expected["lost"]).sum()
            seen["refused"] += (expected["sent"] & ~expected["accepted"] & ~expected["lost"]).sum()
        assert requests > 0 or (policy, name) == ("fixed_front", "paper"), name
    # The worlds are hard enough: each thing that can happen to a request has happened.
    needs = {"sent", "lost", "accepted", "late", "refused"}
    if policy in ("periodic", "random"):
        needs.add("superseded")
    assert all(seen[kind] > 2 for kind in needs), seen


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.integers(0, 3000), st.floats(0.0, 1.0), st.sampled_from([0.15, 0.5, 8.0]))
def test_budgets_are_kept_and_counts_are_those_of_voi_control(seed, budget, price, mean_kb_per_s):
    env = environment(**(BUSY | WEAK | {"mean_kb_per_s": mean_kb_per_s}))
    control = controller(**(EAGER | {"rules": QUICK_RULES, "budget_bytes": float(budget)}))
    prices = control.prices._replace(bandwidth_m_per_s=jnp.float32(price))
    params, route = ControlParams(env, control._replace(prices=prices)), make_route(seed)
    draws = draw_jit(jax.random.key(seed), route, env, ACTIONS)
    sent = {}
    for policy in POLICIES:
        result = simulate(draws, route, policy, params)
        sent[policy] = np.flatnonzero(result.sent)
        if policy != "oracle_action":
            assert float(result.payload_bytes.sum()) <= budget
    # A front-only request is 8 bytes smaller than the fixed one of the rivals: the budget may hold fewer of those.
    count = min(len(sent["voi"]), budget // 96)
    assert len(sent["budgeted_periodic"]) == len(sent["random"]) == count
    assert np.array_equal(sent["oracle_action"], sent["voi"])
    if count == len(sent["voi"]) and count > 1:
        gaps = np.diff(sent["budgeted_periodic"])
        assert gaps.max() - gaps.min() <= 1
        ends = sent["budgeted_periodic"][0] + 1, SLOTS - sent["budgeted_periodic"][-1]
        assert max(ends) <= gaps.max() // 2 + 2


@pytest.mark.parametrize("policy", POLICIES)
def test_nothing_can_be_bought(policy):
    route, key = make_route(1), jax.random.key(1)
    busy = environment(**BUSY)
    for changes in ({"budget_bytes": 0.0}, {"available": [False] * 8}, {"energy_j": [1.0] * 8, "energy_budget_j": 0.5}):
        params = ControlParams(busy, controller(**(EAGER | {"rules": QUICK_RULES} | changes)))
        found, expected = both(policy, key, route, params)
        assert_equal(found, expected)
        # The bound ignores the payload budget, but asks only where VOI-Control does.
        assert not found.sent.any()
        np.testing.assert_allclose(np.diff(found.risk_m**2) > 0, True)


@pytest.mark.parametrize("policy", POLICIES)
def test_a_dead_link_loses_everything(policy):
    env = environment(**(BUSY | {"mean_kb_per_s": 0.0}))
    found, expected = both(policy, jax.random.key(2), make_route(2), ControlParams(env, controller(**EAGER)))
    assert_equal(found, expected)
    assert not np.any(found.sent) or policy in ("periodic", "uncertainty", "fixed_front")
    assert np.all(np.diff(found.risk_m) > 0)  # no correction ever comes
    assert np.all(np.isinf(found.latency_s[found.sent]))


def test_residuals_above_the_risk_are_not_worth_asking_for():
    route = make_route(3)
    route = route._replace(predicted_m=jnp.full_like(route.predicted_m, 500.0))
    control = controller(threshold_m=-1.0, min_gap_s=0.0, prices={"bandwidth_m_per_s": 0.0, "delay_m_per_s": 0.0})
    for policy in ("voi", *FOLLOW_VOI):
        found, expected = both(policy, jax.random.key(3), route, ControlParams(environment(**BUSY), control))
        assert_equal(found, expected)
        assert not found.sent.any()


def test_one_slot():
    route = make_route(0, slots=1)
    env = environment(**(BUSY | {"initial_risk_m": 9.0}))
    params = ControlParams(env, controller(**(EAGER | {"rules": QUICK_RULES | {"period_s": 0.5}})))
    for policy in ("voi", "budgeted_periodic"):
        found, expected = both(policy, jax.random.key(0), route, params)
        assert found.sent.shape == (1,) and found.sent.all()
        assert_equal(found, expected)


def test_ground_vehicle():
    actions = actions_for(4, ACTIONS)
    assert actions.names == ("F-C", "F-R", "FS-C", "FS-R", "H4-C", "H4-R")
    params = ControlParams(environment(**BUSY), controller(actions, **(EAGER | {"rules": QUICK_RULES})))
    for policy in ("voi", "oracle_action"):
        found, expected = both(policy, jax.random.key(4), make_route(4, actions=6), params, actions)
        assert_equal(found, expected)
        assert expected["sent"].sum() > 3


LEAVES = {
    "correction": [0, 1, 2],
    "budget_bytes": [0.0, 400.0, 2150.0],
    "gate_sigma": [0.5, 3.0, np.inf],
    "bandwidth_m_per_s": [0.0, 3.0, 30.0],
    "energy_m_per_j": [0.0, 1.0, 9.0],
    "delay_m_per_s": [0.0, 3.0, 30.0],
}


def with_leaf(control, name, value):
    if name in control.prices._fields:
        return control._replace(prices=control.prices._replace(**{name: value}))
    return control._replace(**{name: value})


def test_vmap_equals_loop_for_keys_and_every_swept_leaf():
    # One mapped program over rows; each row changes one leaf, or the key.
    env = environment(**(BUSY | {"mean_kb_per_s": 0.5}))
    base = controller(**(EAGER | {"energy_j": [0.25] * 8, "energy_budget_j": 100.0}))
    route = make_route(5)
    rows = [(0, with_leaf(base, name, jnp.asarray(value))) for name, values in LEAVES.items() for value in values]
    rows += [(seed, base) for seed in range(1, 4)]
    keys = jnp.stack([jax.random.key(seed) for seed, _ in rows])
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *[control for _, control in rows])
    mapped = jax.jit(jax.vmap(lambda key, control: replay.replay(key, route, "voi", ControlParams(env, control))))(
        keys, stacked
    )
    results = []
    for i, (seed, control) in enumerate(rows):
        draws = draw_jit(jax.random.key(seed), route, env, ACTIONS)
        single = simulate(draws, route, "voi", ControlParams(env, control))
        for name, one in single._asdict().items():
            np.testing.assert_allclose(np.asarray(getattr(mapped, name))[i], one, rtol=1e-4, atol=1e-4, err_msg=name)
        results.append(np.asarray(single.error_m))
    for i, name in enumerate(LEAVES):  # each leaf matters
        assert not np.array_equal(results[3 * i], results[3 * i + 2]), name


def test_simulate_replays_voi_control_first():
    params, route = world("gate bites"), make_route(9)
    draws = draw_jit(jax.random.key(9), route, params.env, ACTIONS)
    whole = jax.jit(replay.simulate, static_argnames="policy")(draws, route, "random", params)
    jax.tree.map(np.testing.assert_array_equal, whole, simulate(draws, route, "random", params))
    assert whole.sent.sum() == simulate(draws, route, "voi", params).sent.sum() > 3


def test_policies_that_share_a_seed_share_the_world():
    params, route = world("paper"), make_route(7)
    draws = draw_jit(jax.random.key(7), route, params.env, ACTIONS)
    runs = [simulate(draws, route, policy, params) for policy in POLICIES]
    for other in runs[1:]:
        before = min(np.flatnonzero(r.sent)[0] if r.sent.any() else SLOTS for r in (runs[0], other))
        np.testing.assert_array_equal(runs[0].error_m[:before], other.error_m[:before])
        np.testing.assert_array_equal(runs[0].risk_m[:before], other.risk_m[:before])

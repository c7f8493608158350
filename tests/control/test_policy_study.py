"""Search and comparison in one program: equal to the oracle, compiled once for any seeds, settings and candidates."""

import logging

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.control import policy_study as module
from ovibjax.control.actions import ACTIONS
from ovibjax.control.client_state import ControlParams
from ovibjax.control.policies import POLICIES
from ovibjax.control.policy_search import candidates, take
from ovibjax.control.policy_study import RoutesAndSeeds, Setting, seeds_to_keys, stack_routes, study
from tests.control.cases import QUICK_RULES, controller, draw_jit, environment, for_oracle, make_route
from tests.oracles import control as oracle

SLOTS, TUNING, HELD_OUT, COUNT = 12, [0, 1], [100, 101, 102], 4
ENV = {"drift_m2_per_s": [4.0137, 12.0219, 25.0341], "initial_risk_m": 5.0123}


def inputs(seed, tuning, held_out, scales, budgets):
    tried = candidates(jax.random.key(seed), COUNT, ACTIONS)
    tried = tried._replace(threshold_m=0.4 * tried.threshold_m, min_gap_s=0.2 * tried.min_gap_s)
    prices = tried.prices._replace(bandwidth_m_per_s=jnp.full(COUNT, 0.1) + jnp.arange(4.0))
    return (
        Setting(*(jnp.asarray(x, jnp.float32) for x in (scales, budgets, [8.0, 2.0]))),
        environment(**ENV),
        tried._replace(prices=prices),
        controller(rules=QUICK_RULES).rules,
        RoutesAndSeeds(stack_routes([make_route(seed + i, SLOTS + i) for i in range(2)]), seeds_to_keys(tuning)),
        RoutesAndSeeds(stack_routes([make_route(seed + 10 + i, SLOTS) for i in range(3)]), seeds_to_keys(held_out)),
        ACTIONS,
    )


@pytest.fixture(scope="module")
def found():
    arguments = inputs(0, TUNING, HELD_OUT, [1.0, 2.0], [2.1, 0.3])
    return arguments, jax.device_get(study(*arguments))


def at(arguments, setting):
    """Environment and candidates at one setting, written out."""
    settings, env, tried = arguments[:3]
    env = env._replace(
        drift_m2_per_s=env.drift_m2_per_s * settings.drift_scale[setting],
        mean_kb_per_s=settings.mean_kb_per_s[setting],
    )
    return env, tried._replace(budget_bytes=jnp.full(COUNT, 1024.0 * settings.budget_kb[setting]))


def run_oracle(policy, key, route, env, control):
    draws = draw_jit(key, route, env, ACTIONS)
    return oracle.replay(policy, *for_oracle(draws, route, ControlParams(env, control)))


@pytest.mark.parametrize("setting", [0, 1])
def test_search_equals_the_oracle_and_takes_the_lowest_risk(found, setting):
    arguments, outcome = found
    env, tried = at(arguments, setting)
    training, keys = arguments[4]
    risks, by_rule = np.zeros((2, 2, 2, COUNT))
    for r in range(2):
        route = jax.tree.map(lambda leaf, r=r: leaf[r], training)
        for s in range(2):
            for c in range(COUNT):
                one = run_oracle("voi", keys[s], route, env, take(tried, c))
                risks[r, s, c] = one["risk"].mean()
                for name, want in (
                    ("mean_m", one["error"].mean()),
                    ("requests", one["sent"].sum()),
                    ("kb", one["payload"].sum() / 1024),
                ):
                    np.testing.assert_allclose(getattr(outcome.searched, name)[setting, r, s, c], want, rtol=1e-3)
                by_rule[r, s, c] = run_oracle("uncertainty", keys[s], route, env, take(tried, c))["risk"].mean()
    np.testing.assert_allclose(outcome.searched.risk_m[setting], risks, rtol=1e-3)
    best = risks.mean(axis=(0, 1)).argmin()
    assert outcome.best[setting] == best
    chosen = jax.tree.map(lambda leaf: leaf[setting], outcome.control)
    for name in ("threshold_m", "min_gap_s", "budget_bytes"):
        assert getattr(chosen, name) == getattr(tried, name)[best]
    assert chosen.rules == jax.device_get(arguments[3])
    rule = int(by_rule.mean(axis=(0, 1)).argmin())
    assert outcome.tuned.uncertainty_risk_m[setting] == tried.rules.uncertainty_risk_m[rule]
    assert outcome.tuned.uncertainty_gap_s[setting] == tried.rules.uncertainty_gap_s[rule]
    assert outcome.searched.requests[setting].max() > 0


@pytest.mark.parametrize("setting", [0, 1])
def test_held_out_policies_equal_the_oracle(found, setting):
    arguments, outcome = found
    env, _ = at(arguments, setting)
    held_out, keys = arguments[5]
    assert tuple(sorted(outcome.held_out)) == tuple(sorted((*POLICIES, "tuned_uncertainty")))
    control = jax.tree.map(lambda leaf: jnp.asarray(leaf[setting]), outcome.control)
    tuned = jax.tree.map(lambda leaf: jnp.asarray(leaf[setting]), outcome.tuned)
    for policy, summary in outcome.held_out.items():
        of_rule = control._replace(rules=tuned) if policy == "tuned_uncertainty" else control
        for i in range(len(HELD_OUT)):
            route = jax.tree.map(lambda leaf, i=i: leaf[i], held_out)
            one = run_oracle(policy.removeprefix("tuned_"), keys[i], route, env, of_rule)
            assert summary.requests[setting, i] == one["sent"].sum(), policy
            np.testing.assert_allclose(summary.mean_m[setting, i], one["error"].mean(), rtol=1e-3)
            np.testing.assert_allclose(summary.p95_m[setting, i], np.percentile(one["error"], 95), rtol=1e-3)
            if policy in outcome.histories:
                history = outcome.histories[policy]
                np.testing.assert_array_equal(history.sent[setting, i], one["sent"])
                np.testing.assert_allclose(history.risk_m[setting, i], one["risk"], rtol=1e-3)
    assert set(outcome.histories) == set(module.SHOWN)


def test_other_seeds_settings_and_candidates_compile_nothing(found, caplog):
    others = inputs(50, [7, 8], [900, 901, 902], [0.5, 3.0], [1.0, 4.2])
    jax.block_until_ready(others[:-1])
    caplog.set_level(logging.DEBUG, "jax")
    outcome = jax.block_until_ready(study(*others))
    assert not [r.getMessage() for r in caplog.records if "Finished XLA compilation" in r.getMessage()]
    assert study._cache_size() == 1
    caplog.clear()
    jax.jit(lambda x: x + 1)(jnp.arange(3))
    assert any("Finished XLA compilation" in r.getMessage() for r in caplog.records)  # the log would have said so
    before = found[1]
    assert not np.array_equal(outcome.searched.risk_m, before.searched.risk_m)
    assert not np.array_equal(outcome.held_out["periodic"].mean_m, before.held_out["periodic"].mean_m)


def test_candidates_do_not_depend_on_their_number():
    few, many = candidates(jax.random.key(3), 5, ACTIONS), candidates(jax.random.key(3), 300, ACTIONS)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b[:5], rtol=1e-6), few, many)
    assert many.prices.bandwidth_m_per_s.min() >= 0.1 and many.prices.bandwidth_m_per_s.max() <= 1000
    assert many.threshold_m.min() >= 0 and many.threshold_m.max() <= 8 and many.available.all()
    assert len(np.unique(many.rules.uncertainty_risk_m)) > 290


def test_routes_are_cut_to_the_shortest_and_dealt_in_turn():
    routes = [make_route(i, 20 + 5 * i) for i in range(3)]
    stacked = stack_routes(routes)
    assert stacked.context.shape == (3, 20)
    np.testing.assert_array_equal(stacked.residual_m[2], routes[2].residual_m[:20])

    class Held:
        held_out = routes

    dealt = module.routes_for_seeds(Held, [5, 6, 7, 8])
    np.testing.assert_array_equal(dealt.context[3], stacked.context[0])
    assert np.array_equal(jax.random.key_data(seeds_to_keys([4]))[0], jax.random.key_data(jax.random.key(4)))

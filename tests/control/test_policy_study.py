"""Search and comparison in one program: equal to the oracle, compiled once for any seeds, settings and candidates."""

import logging

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.control import policy_study as module
from ovibjax.control import protocols
from ovibjax.control.actions import ACTIONS
from ovibjax.control.client_state import ControlParams
from ovibjax.control.drift import make_drift
from ovibjax.control.policies import POLICIES
from ovibjax.control.policy_search import candidates, lowest_risk, take
from ovibjax.control.policy_study import RoutesAndSeeds, Setting, StudySize, study
from ovibjax.control.protocols import in_turn, paper_route, routes_of, seeds_to_keys, stack_routes
from ovibjax.control.route_summary import Summary
from ovibjax.control.scene import Scene
from ovibjax.features.frames import CONTEXTS
from tests.control.cases import QUICK_RULES, controller, draw_jit, environment, for_oracle, make_route
from tests.oracles import control as oracle

SLOTS, TUNING, HELD_OUT, COUNT = 12, [[0, 1], [2, 3]], [100, 101, 102], 4
RATES = [0.8137, 2.4219, 5.0341]


def inputs(seed, tuning, held_out, points):
    """Arguments of `study`; a point is a drift model, a factor on the rates, and a budget, by protocol."""
    models, scales, budgets = zip(*points, strict=True)
    tried = candidates(jax.random.key(seed), COUNT, ACTIONS)
    tried = tried._replace(threshold_m=0.4 * tried.threshold_m, min_gap_s=0.2 * tried.min_gap_s)
    prices = tried.prices._replace(bandwidth_m_per_s=jnp.full(COUNT, 0.1) + 40.0 * jnp.arange(4.0))
    drifts = [make_drift(scale * np.array(RATES), 5.0, model) for model, scale in zip(models, scales, strict=True)]
    return (
        Setting(
            jax.tree.map(lambda *leaves: jnp.stack(leaves), *drifts),
            *(jnp.asarray(x, jnp.float32) for x in (budgets, [8.0, 2.0])),
            jnp.array([0, 1]),
            jnp.array([0, 2]),
            jnp.float32([jnp.inf, 2.0]),
        ),
        environment(initial_risk_m=5.0123),
        tried._replace(prices=prices),
        controller(rules=QUICK_RULES).rules,
        of_protocols(lambda n: [make_route(seed + 50 * n + i, SLOTS + i) for i in range(2)], np.array(tuning)),
        of_protocols(lambda n: [make_route(seed + 50 * n + 10 + i, SLOTS) for i in range(3)], held_out),
        ACTIONS,
    )


def of_protocols(routes, seeds):
    """Routes and seeds of two protocols, which differ in both."""
    both = [
        RoutesAndSeeds(stack_routes(routes(n)), jax.vmap(jax.random.key)(jnp.asarray(seeds).ravel() + 7 * n))
        for n in range(2)
    ]
    both = [one._replace(keys=one.keys.reshape(np.shape(seeds))) for one in both]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *both)


@pytest.fixture(scope="module")
def found():
    arguments = inputs(0, TUNING, HELD_OUT, [("rate", 1.0, 1.7), ("random_walk", 2.0, 0.6)])
    return arguments, jax.device_get(study(*arguments))


def at(arguments, setting):
    """Environment and candidates at one setting, written out."""
    settings, env, tried = arguments[:3]
    drift = jax.tree.map(lambda leaf: leaf[setting], settings.drift)
    env = env._replace(drift=drift, mean_kb_per_s=settings.mean_kb_per_s[setting])
    handled = {name: jnp.full(COUNT, getattr(settings, name)[setting]) for name in ("correction", "gate_sigma")}
    return env, tried._replace(**handled), float(settings.budget_kb[setting])


def uncapped(control):
    return control._replace(budget_bytes=jnp.float32(jnp.inf))


def lowest_feasible(risks, kb, budget_kb):
    """Lowest mean risk among the candidates that keep the budget on every route and seed."""
    most = kb.max(axis=(0, 1))
    kept = [c for c in range(len(most)) if most[c] <= budget_kb]
    return min(kept, key=lambda c: risks[:, :, c].mean()) if kept else int(most.argmin())


def run_oracle(policy, key, route, env, control):
    draws = draw_jit(key, route, env, ACTIONS)
    return oracle.replay(policy, *for_oracle(draws, route, ControlParams(env, control)))


@pytest.mark.parametrize("setting", [0, 1])
def test_search_equals_the_oracle_and_takes_the_lowest_risk_within_the_budget(found, setting):
    arguments, outcome = found
    env, tried, budget_kb = at(arguments, setting)
    training, keys = jax.tree.map(lambda leaf: leaf[setting], arguments[4])
    best = {}
    for policy in ("voi", "voi_gap", "uncertainty"):
        risks, kb = np.zeros((2, 2, 2, COUNT))
        for r, s, c in np.ndindex(2, 2, COUNT):
            route = jax.tree.map(lambda leaf, r=r: leaf[r], training)
            one = run_oracle(policy, keys[r, s], route, env, uncapped(take(tried, c)))
            risks[r, s, c], kb[r, s, c] = one["risk"].mean(), one["payload"].sum() / 1024
            if policy == "voi":
                for name, want in (("mean_m", one["error"].mean()), ("requests", one["sent"].sum())):
                    np.testing.assert_allclose(getattr(outcome.searched, name)[setting, r, s, c], want, rtol=1e-3)
        if policy == "voi":
            np.testing.assert_allclose(outcome.searched.risk_m[setting], risks, rtol=1e-3)
            np.testing.assert_allclose(outcome.searched.kb[setting], kb, rtol=1e-6)
            assert (kb.max(axis=(0, 1)) <= budget_kb).any() and kb.max() > budget_kb  # the budget has a say
        best[policy] = lowest_feasible(risks, kb, budget_kb)
    assert outcome.best[setting] == best["voi"]
    for name, chosen in (("voi", outcome.control), ("voi_gap", outcome.gap_control)):
        chosen = jax.tree.map(lambda leaf: leaf[setting], chosen)
        for field in ("threshold_m", "min_gap_s"):
            assert getattr(chosen, field) == getattr(tried, field)[best[name]]
        assert chosen.prices == jax.device_get(take(tried, best[name]).prices)
        assert chosen.budget_bytes == np.float32(1024.0) * np.float32(budget_kb)
        assert chosen.rules == jax.device_get(arguments[3])
    assert outcome.tuned.uncertainty_risk_m[setting] == tried.rules.uncertainty_risk_m[best["uncertainty"]]
    assert outcome.tuned.uncertainty_gap_s[setting] == tried.rules.uncertainty_gap_s[best["uncertainty"]]


@pytest.mark.parametrize("setting", [0, 1])
def test_held_out_policies_equal_the_oracle(found, setting):
    arguments, outcome = found
    env = at(arguments, setting)[0]
    held_out, keys = jax.tree.map(lambda leaf: leaf[setting], arguments[5])
    assert tuple(sorted(outcome.held_out)) == tuple(sorted((*POLICIES, "tuned_uncertainty")))
    control, gap_control, tuned = (
        jax.tree.map(lambda leaf: jnp.asarray(leaf[setting]), part)
        for part in (outcome.control, outcome.gap_control, outcome.tuned)
    )
    others = {"tuned_uncertainty": control._replace(rules=tuned), "voi_gap": gap_control}
    for policy, summary in outcome.held_out.items():
        of_rule = others.get(policy, control)
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
    for i in range(len(HELD_OUT)):
        route = jax.tree.map(lambda leaf, i=i: leaf[i], held_out)
        free = run_oracle("voi", keys[i], route, env, uncapped(control))["payload"].sum() / 1024
        assert outcome.free_kb[setting, i] == pytest.approx(free, rel=1e-6)


def test_without_a_feasible_candidate_the_cheapest_is_taken():
    risk, kb = jnp.array([[[3.0, 1.0, 2.0]]]), jnp.array([[[2.0, 9.0, 5.0]]])
    searched = Summary(risk, risk, risk, kb, kb)
    assert [int(lowest_risk(searched, limit)) for limit in (10.0, 6.0, 3.0, 1.0)] == [1, 2, 0, 0]


def test_other_seeds_settings_and_candidates_compile_nothing(found, caplog):
    others = inputs(50, [[7, 8], [9, 10]], [900, 901, 902], [("integrated", 0.5, 1.0), ("rate", 3.0, 4.2)])
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


def test_a_search_stands_while_the_budget_alone_changes():
    same = ("rate", 1.0, 1.7)
    settings = inputs(0, TUNING, HELD_OUT, [same, ("random_walk", 2.0, 0.6)])[0]
    rows = [0, 0, 1, 1, 0]
    settings = jax.tree.map(lambda leaf: leaf[jnp.array(rows)], settings)._replace(budget_kb=jnp.arange(5.0))
    assert module.searched_before(settings).tolist() == [False, True, False, True, False]
    other = settings._replace(correction=settings.correction.at[1].set(1))
    assert module.searched_before(other).tolist() == [False, False, False, True, False]


def test_one_search_serves_several_budgets(found):
    arguments, outcome = found
    settings = arguments[0]
    twice = jax.tree.map(lambda leaf: leaf[jnp.array([0, 0])], settings)
    twice = twice._replace(budget_kb=jnp.array([9.0, settings.budget_kb[0]], jnp.float32))
    both = jax.device_get(study(twice, *arguments[1:]))
    assert study._cache_size() == 1
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(a[1], b[0]), both, outcome)
    jax.tree.map(lambda leaf: np.testing.assert_array_equal(leaf[0], leaf[1]), both.searched)
    assert both.control.budget_bytes[0] != both.control.budget_bytes[1]


def test_candidates_do_not_depend_on_their_number():
    few, many = candidates(jax.random.key(3), 5, ACTIONS), candidates(jax.random.key(3), 300, ACTIONS)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b[:5], rtol=1e-6), few, many)
    assert (
        many.prices.bandwidth_m_per_s.min() >= 0.1
        and 100 < many.prices.delay_m_per_s.max() <= 1000 < many.prices.bandwidth_m_per_s.max() <= 10_000
    )
    assert many.threshold_m.min() >= 0 and many.threshold_m.max() <= 8 and many.available.all()
    assert len(np.unique(many.rules.uncertainty_risk_m)) > 290


def test_routes_are_cut_to_the_shortest_and_dealt_in_turn():
    routes = [make_route(i, 20 + 5 * i) for i in range(3)]
    stacked = stack_routes(routes)
    assert stacked.context.shape == (3, 20)
    np.testing.assert_array_equal(stacked.residual_m[2], routes[2].residual_m[:20])

    dealt = in_turn(routes, 4)
    np.testing.assert_array_equal(dealt.context[3], stacked.context[0])
    assert np.array_equal(jax.random.key_data(seeds_to_keys([4]))[0], jax.random.key_data(jax.random.key(4)))


def test_protocols_share_no_seed_and_the_paper_has_one_route():
    mixes = ([0.9, 0.05, 0.05], [0.6, 0.2, 0.2], [0.3, 0.4, 0.3])
    held_out = []
    for i, mix in enumerate(mixes):
        context = np.repeat(np.arange(3), (100 * np.array(mix)).round().astype(int)).astype(np.int32)
        held_out.append(make_route(i, 100)._replace(context=context))
    scene = Scene([make_route(8), make_route(9)], held_out, np.ones((3, 8)), np.ones(3) / 3, CONTEXTS, ACTIONS)
    assert paper_route(scene) == 1
    tuned, judged = routes_of(scene, "paper")
    assert len(tuned) == 2 and all(route is held_out[1] for route in (*tuned, *judged))
    assert routes_of(scene, "transfer") == (scene.training, scene.held_out)


def test_a_training_route_longer_than_the_held_out_one_is_cut(monkeypatch):
    """Somebody's own frames are one sequence, 60 % of it the training route: both protocols must be equally long."""
    seen = []
    monkeypatch.setattr(protocols, "study", lambda *arguments: seen.append(arguments))
    scene = Scene([make_route(0, 30)], [make_route(1, 20)], np.ones((3, 8)), np.ones(3) / 3, CONTEXTS, ACTIONS)
    protocols.run_study([scene], None, StudySize(candidates=2, tuning_seeds=2, held_out_seeds=3), 100)
    ((*_, tuning, judged, _),) = seen
    assert tuning.routes.context.shape == (2, 1, 20) and tuning.keys.shape == (2, 1, 2)
    assert judged.routes.context.shape == (2, 3, 20) and judged.keys.shape == (2, 3)
    np.testing.assert_array_equal(tuning.routes.residual_m[1, 0], scene.training[0].residual_m[:20])
    np.testing.assert_array_equal(tuning.routes.residual_m[0, 0], scene.held_out[0].residual_m)

"""Tune the controller on tuning seeds and training routes, compare every policy on held-out ones: one compiled call.

The search replays VOI-Control for every candidate on every training route and tuning seed, see `policy_search`. The
winner and the paper's fixed rules then run on held-out routes and seeds. Settings (drift, budget) are mapped in turn
around all of it, so that a sensitivity study is the same program. Nothing that is swept is baked in: other seeds,
prices or budgets compile nothing.
"""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.control.actions import ActionSet
from ovibjax.control.client_state import ControlParams
from ovibjax.control.controller import Controller, FixedRules, make_controller
from ovibjax.control.environment import Environment, Route, draw, make_environment
from ovibjax.control.planning import plan
from ovibjax.control.policies import POLICIES
from ovibjax.control.policy_search import candidates, lowest_risk, search, take
from ovibjax.control.route_replay import RouteResult, replay_schedule
from ovibjax.control.route_summary import Summary, summarize
from ovibjax.control.scene import Scene

SHOWN = ("voi", "budgeted_periodic")
"""Policies whose slots are kept: those that figures draw over time, and whose requests are scheduled."""


@dataclass(frozen=True)
class StudySize:
    """How much is replayed.

    Attributes:
        candidates: configurations of VOI-Control tried.
        tuning_seeds: seeds 0, 1, ... they are tried on.
        held_out_seeds: seeds they are judged on.
    """

    candidates: int
    tuning_seeds: int
    held_out_seeds: int


class Setting(NamedTuple):
    """One point of the sensitivity study; fields [settings].

    Attributes:
        drift_scale: factor on every drift rate.
        budget_kb: payload per route, KB.
        mean_kb_per_s: link profile, KB/s.
    """

    drift_scale: jax.Array
    budget_kb: jax.Array
    mean_kb_per_s: jax.Array


class RoutesAndSeeds(NamedTuple):
    """What controllers are tried on.

    Attributes:
        routes: [R, T, ...] routes.
        keys: [S] keys of seeds.
    """

    routes: Route
    keys: jax.Array


class Outcome(NamedTuple):
    """What a study found, with leading axis [settings].

    Attributes:
        searched: VOI-Control on tuning seeds, fields [routes, seeds, candidates].
        best: position of the chosen candidate.
        control: the chosen configuration of VOI-Control.
        tuned: rules whose uncertainty threshold and gap were searched as VOI-Control's prices are.
        held_out: result of each policy by name, fields [seeds]; `tuned_uncertainty` follows `tuned`.
        histories: the replays of the policies in `SHOWN`, fields [seeds, T].
    """

    searched: Summary
    best: jax.Array
    control: Controller
    tuned: FixedRules
    held_out: dict[str, Summary]
    histories: dict[str, RouteResult]


@partial(jax.jit, static_argnames="actions")
def study(
    settings: Setting,
    env: Environment,
    tried: Controller,
    rules: FixedRules,
    tuning: RoutesAndSeeds,
    held_out: RoutesAndSeeds,
    actions: ActionSet,
) -> Outcome:
    """Search and compare, for every setting, in one program.

    Args:
        settings: [settings] drift, budget and link.
        env: the environment at drift scale 1.
        tried: [C] candidate controllers.
        rules: numbers of the fixed rules, the paper's.
        tuning: training routes and tuning seeds; every route is replayed with every seed.
        held_out: a held-out route for each held-out seed.
        actions: the action set (static).

    Returns:
        The outcome.
    """

    def one(setting: Setting) -> Outcome:
        world = env._replace(
            drift_m2_per_s=env.drift_m2_per_s * setting.drift_scale, mean_kb_per_s=setting.mean_kb_per_s
        )
        budgeted = tried._replace(budget_bytes=jnp.full_like(tried.budget_bytes, 1024.0) * setting.budget_kb)
        # Every route with every tuning seed; drawn once for both searches.
        draws = jax.vmap(lambda route: jax.vmap(lambda key: draw(key, route, world, actions))(tuning.keys))(
            tuning.routes
        )
        searched = search(draws, tuning.routes, world, budgeted, "voi", actions)
        best = lowest_risk(searched)
        by_rule = search(draws, tuning.routes, world, budgeted, "uncertainty", actions)
        tuned = take(budgeted, lowest_risk(by_rule)).rules
        control = take(budgeted, best)._replace(rules=rules)
        histories = compare(ControlParams(world, control), tuned, held_out, actions)
        summaries = {name: summarize(history) for name, history in histories.items()}
        return Outcome(searched, best, control, tuned, summaries, {name: histories[name] for name in SHOWN})

    return jax.lax.map(one, settings)


def compare(
    params: ControlParams, tuned: FixedRules, held_out: RoutesAndSeeds, actions: ActionSet
) -> dict[str, RouteResult]:
    """Every policy on paired routes and seeds.

    Args:
        params: the environment; VOI-Control's configuration, and the paper's rules.
        tuned: rules with the searched uncertainty threshold and gap.
        held_out: a route for each seed.
        actions: the action set (static).

    Returns:
        Histories [L, T] by policy, and `tuned_uncertainty`.
    """

    def one(route: Route, key: jax.Array) -> dict[str, RouteResult]:
        return replay_every_policy(key, route, params, tuned, actions)

    return jax.vmap(one)(*held_out)


def replay_every_policy(
    key: jax.Array, route: Route, params: ControlParams, tuned: FixedRules, actions: ActionSet
) -> dict[str, RouteResult]:
    """`compare` on one route and seed."""
    env, control = params
    draws = draw(key, route, env, actions)
    none = jnp.zeros(draws.rate_bps.shape, bool)
    results = {"voi": replay_schedule(draws, route, "voi", none, params, actions)}
    sent = results["voi"].sent

    def by_name(names: tuple[str, ...], histories: RouteResult) -> dict[str, RouteResult]:
        return {name: jax.tree.map(lambda h, i=i: h[i], histories) for i, name in enumerate(names)}

    # The three that send one fixed action at planned slots are one scan.
    together = ("periodic", "budgeted_periodic", "random")
    planned = jnp.stack([plan(draws, policy, params, sent) for policy in together])
    histories = jax.vmap(lambda slots: replay_schedule(draws, route, "random", slots, params, actions))(planned)
    results |= by_name(together, histories)
    for policy in ("fixed_front", "oracle_action"):
        results[policy] = replay_schedule(draws, route, policy, plan(draws, policy, params, sent), params, actions)

    def by_uncertainty(rules: FixedRules) -> RouteResult:
        with_rules = ControlParams(env, control._replace(rules=rules))
        return replay_schedule(draws, route, "uncertainty", none, with_rules, actions)

    both = jax.tree.map(lambda *leaves: jnp.stack(leaves), control.rules, tuned)
    results |= by_name(("uncertainty", "tuned_uncertainty"), jax.vmap(by_uncertainty)(both))
    return {policy: results[policy] for policy in (*POLICIES, "tuned_uncertainty")}


def run_study(scene: Scene, settings: Setting, size: StudySize, first_seed: int) -> Outcome:
    """`study` on a scene with the project's seeds: tuning seeds 0, 1, ..., held-out seeds from `first_seed` on."""
    held = [first_seed + i for i in range(size.held_out_seeds)]
    return study(
        settings,
        make_environment(scene.context_share),
        candidates(jax.random.key(0), size.candidates, scene.actions),
        make_controller(scene.actions).rules,
        RoutesAndSeeds(stack_routes(scene.training), seeds_to_keys(list(range(size.tuning_seeds)))),
        RoutesAndSeeds(routes_for_seeds(scene, held), seeds_to_keys(held)),
        scene.actions,
    )


def stack_routes(routes: list[Route]) -> Route:
    """Routes of equal length with a leading axis; longer ones are cut to the shortest."""
    slots = min(len(route.context) for route in routes)
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf[:slots]) for leaf in leaves]), *routes)


def seeds_to_keys(seeds: list[int]) -> jax.Array:
    """One key per seed."""
    return jax.vmap(jax.random.key)(jnp.asarray(seeds, jnp.uint32))


def routes_for_seeds(scene: Scene, seeds: list[int]) -> Route:
    """A held-out route per seed, in turn."""
    stacked = stack_routes(scene.held_out)
    return jax.tree.map(lambda leaf: leaf[np.arange(len(seeds)) % len(scene.held_out)], stacked)

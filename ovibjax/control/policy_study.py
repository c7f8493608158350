"""Tune the controller on tuning seeds, compare every policy on held-out ones: one compiled call.

The search replays VOI-Control for every candidate on every tuning route and seed, see `policy_search`. The winner and
the paper's fixed rules then run on held-out seeds, under a budget that is also a hard cap. Settings (drift, budget) are
mapped in turn around all of it, so that a sensitivity study is the same program; where a setting differs from the one
before it in its budget alone, the search before it stands. Nothing that is swept is baked in: other seeds, drift
models, prices or budgets compile nothing.
"""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.control.actions import ActionSet
from ovibjax.control.controller import Controller, FixedRules
from ovibjax.control.drift import Drift
from ovibjax.control.environment import Draws, Environment, Route, draw
from ovibjax.control.policy_rows import Rules, replay_rows
from ovibjax.control.policy_search import lowest_risk, search, search_variants, take
from ovibjax.control.route_replay import RouteResult
from ovibjax.control.route_summary import Summary, summarize

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
        drift: how the odometry drifts.
        budget_kb: payload per route, KB.
        mean_kb_per_s: link profile, KB/s.
        place: int32, which routes and seeds.
        correction: int32, what corrections do, which of `belief.CORRECTIONS`.
        gate_sigma: innovation above which they are discarded.
    """

    drift: Drift
    budget_kb: jax.Array
    mean_kb_per_s: jax.Array
    place: jax.Array
    correction: jax.Array
    gate_sigma: jax.Array


SEARCHED = ("voi", "voi_gap", "uncertainty")
"""Policies whose numbers are searched."""

Searched = dict[str, Summary]
"""Results of a search by policy, fields [routes, seeds, candidates]."""


class RoutesAndSeeds(NamedTuple):
    """What controllers are tried on.

    Attributes:
        routes: [..., R, T, ...] routes.
        keys: keys of seeds: [..., R, S] where prices are tuned, [..., R] where they are judged.
    """

    routes: Route
    keys: jax.Array


class Outcome(NamedTuple):
    """What a study found, with leading axis [settings].

    Attributes:
        searched: VOI-Control on tuning seeds without a cap, fields [routes, seeds, candidates].
        best: position of the chosen candidate.
        control: the chosen configuration of VOI-Control.
        gap_control: that of its variant with a threshold and a gap.
        tuned: rules whose uncertainty threshold and gap were searched as VOI-Control's prices are.
        free_kb: what VOI-Control would send on held-out seeds if the cap were not there, fields [seeds].
        held_out: result of each policy by name, fields [seeds]; `tuned_uncertainty` follows `tuned`.
        histories: the replays of the policies in `SHOWN`, fields [seeds, T].
    """

    searched: Summary
    best: jax.Array
    control: Controller
    gap_control: Controller
    tuned: FixedRules
    free_kb: jax.Array
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
        env: the environment; its drift and link are the setting's.
        tried: [C] candidate controllers.
        rules: numbers of the fixed rules, the paper's.
        tuning: what prices are tuned on by place, a row of seeds for each route.
        held_out: what policies are judged on by place, a route for each seed.
        actions: the action set (static).

    Returns:
        The outcome.
    """

    def one(found: Searched, repeated: tuple[Setting, jax.Array]) -> tuple[Searched, Outcome]:
        setting, same = repeated
        world = env._replace(drift=setting.drift, mean_kb_per_s=setting.mean_kb_per_s)
        handled = tried._replace(
            correction=jnp.broadcast_to(setting.correction, tried.correction.shape),
            gate_sigma=jnp.broadcast_to(setting.gate_sigma, tried.gate_sigma.shape),
        )
        tuned_on, judged_on = jax.tree.map(lambda leaf: leaf[setting.place], (tuning, held_out))
        found = jax.lax.cond(
            same,
            lambda tuned_on, world, handled: found,
            lambda tuned_on, world, handled: search_every(tuned_on, world, handled, actions),
            *(tuned_on, world, handled),
        )
        budget = jnp.full_like(tried.budget_bytes, 1024.0) * setting.budget_kb
        best = {policy: lowest_risk(result, setting.budget_kb) for policy, result in found.items()}
        chosen = {policy: take(handled._replace(budget_bytes=budget), index) for policy, index in best.items()}
        control, gap_control = (chosen[policy]._replace(rules=rules) for policy in ("voi", "voi_gap"))
        tuned = chosen["uncertainty"].rules
        compared = Rules(control, gap_control, control._replace(rules=tuned))
        histories, free_kb = compare(world, compared, judged_on, actions)
        return found, Outcome(
            found["voi"],
            best["voi"],
            control,
            gap_control,
            tuned,
            free_kb,
            {name: summarize(history) for name, history in histories.items()},
            {name: histories[name] for name in SHOWN},
        )

    shape = (*tuning.keys.shape[1:], *tried.threshold_m.shape)
    number = jnp.zeros(shape, jnp.float32)
    nothing = Summary(number, number, number, jnp.zeros(shape, jnp.int32), number)
    return jax.lax.scan(one, dict.fromkeys(SEARCHED, nothing), (settings, searched_before(settings)))[1]


def searched_before(settings: Setting) -> jax.Array:
    """Whether a setting differs from the one before it in its budget alone, to which a search without a cap is blind.

    Args:
        settings: [settings] settings.

    Returns:
        [settings] bool.
    """
    kept = jax.tree.leaves(settings._replace(budget_kb=settings.place))
    same = [jnp.all((leaf[1:] == leaf[:-1]).reshape(len(leaf) - 1, -1), axis=1) for leaf in kept]
    return jnp.concatenate([jnp.zeros(1, bool), jnp.all(jnp.stack(same), axis=0)])


def search_every(tuned_on: RoutesAndSeeds, world: Environment, handled: Controller, actions: ActionSet) -> Searched:
    """The three searches, on draws made once, without a cap on the payload.

    Args:
        tuned_on: routes [R, T, ...] and keys [R, S].
        world: the environment.
        handled: [C] candidates.
        actions: the action set (static).

    Returns:
        Fields [routes, seeds, candidates] by policy.
    """

    def of_route(route: Route, keys: jax.Array) -> Draws:
        return jax.vmap(lambda key: draw(key, route, world, actions))(keys)

    draws = jax.vmap(of_route)(*tuned_on)
    uncapped = handled._replace(budget_bytes=jnp.full_like(handled.budget_bytes, jnp.inf))
    found = search_variants(draws, tuned_on.routes, world, uncapped, actions)
    return found | {"uncertainty": search(draws, tuned_on.routes, world, uncapped, "uncertainty", actions)}


def compare(
    world: Environment, rules: Rules, held_out: RoutesAndSeeds, actions: ActionSet
) -> tuple[dict[str, RouteResult], jax.Array]:
    """Every policy on paired routes and seeds.

    Args:
        world: the environment.
        rules: numbers of the policies.
        held_out: a route for each seed.
        actions: the action set (static).

    Returns:
        Histories [L, T] by policy and of `tuned_uncertainty`; [L] what VOI-Control would send without a cap, KB.
    """

    def one(route: Route, key: jax.Array) -> dict[str, RouteResult]:
        return replay_rows(draw(key, route, world, actions), route, world, rules, actions)

    histories = jax.vmap(one)(*held_out)
    uncapped = histories.pop("voi_uncapped")
    return histories, jnp.sum(uncapped.payload_bytes, axis=-1) / 1024.0

"""The arms of the study of adaptation: prices for all of them, and every arm in every world on the same seeds."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.control.actions import ActionSet
from ovibjax.control.adaptation import Adaptation
from ovibjax.control.adaptive_replay import scan_adapted
from ovibjax.control.client_state import ControlParams
from ovibjax.control.controller import PAPER_BUDGET_KB, Controller
from ovibjax.control.environment import PAPER_SLOTS, Environment, Route, draw
from ovibjax.control.policy_search import candidates, lowest_risk, take
from ovibjax.control.protocols import seeds_to_keys
from ovibjax.control.replay_sums import sums_by_slots
from ovibjax.control.route_replay import RouteResult, replay_schedule, slots_of
from ovibjax.control.route_summary import Summary

ARMS = ("static", "reported", "innovation", "no_probes", "oracle")
"""What robots expect of an answer: the prior of training, the adapted one (from reported risks, from innovations, from
reported risks without probes), or that of the world as it is."""

SPENT = 2 / 3
"""Share of the budget that prices were searched for: a robot that spends all of it has nothing left for a change."""


class Arms(NamedTuple):
    """Results of one prior; errors [arms, worlds, seeds, T].

    Attributes:
        error_m: route error.
        kb: [arms, worlds, seeds] payload.
        requests: [arms, worlds, seeds].
        factor: [worlds, seeds, T, C, A] what `reported` multiplies the prior by.
    """

    error_m: Any
    kb: Any
    requests: Any
    factor: Any


def search_prices(route: Route, env: Environment, count: int, tuning_seeds: int, actions: ActionSet) -> Controller:
    """Prices that keep a share of the budget along a route on every tuning seed, at the least risk.

    Args:
        route: the training routes, one after another.
        env: the environment.
        count: how many candidates are tried.
        tuning_seeds: on how many seeds, from 0.
        actions: the action set.

    Returns:
        The chosen candidate.
    """
    tried = candidates(jax.random.key(0), count, actions)
    tried = tried._replace(budget_bytes=jnp.full_like(tried.budget_bytes, jnp.inf))
    budget_kb = jnp.float32(SPENT * PAPER_BUDGET_KB * len(route.context) / PAPER_SLOTS)
    return take(tried, _best(seeds_to_keys(range(tuning_seeds)), route, env, tried, budget_kb, actions))


@partial(jax.jit, static_argnames="actions")
def _best(
    keys: jax.Array, route: Route, env: Environment, tried: Controller, budget_kb: jax.Array, actions: ActionSet
) -> jax.Array:
    none = jnp.zeros(route.context.shape, bool)

    def one(key: jax.Array) -> Summary:
        draws = draw(key, route, env, actions)

        def tried_with(control: Controller) -> Summary:
            found = sums_by_slots(draws, route, "voi", none, ControlParams(env, control), actions)
            slots, unknown = len(route.context), jnp.float32(jnp.nan)
            return Summary(
                found.error_m / slots, unknown, found.risk_m / slots, found.requests, found.sent_bytes / 1024
            )

        return jax.vmap(tried_with)(tried)

    return lowest_risk(jax.tree.map(lambda leaf: leaf[None], jax.vmap(one)(keys)), budget_kb)


@partial(jax.jit, static_argnames="actions")
def compare(
    keys: jax.Array,
    drives: Route,
    truth_m: jax.Array,
    params: ControlParams,
    numbers: list[Adaptation],
    actions: ActionSet,
) -> Arms:
    """Every arm in every world on the same seeds.

    Args:
        keys: [S] a key per seed.
        drives: [worlds, T, ...] the drive in each world.
        truth_m: [worlds, T, A] what the oracle expects.
        params: environment and controller.
        numbers: of the three adapting arms.
        actions: the action set (static).

    Returns:
        The results.
    """
    reported, innovation, no_probes = numbers

    def one(key: jax.Array, route: Route, truth_m: jax.Array) -> Arms:
        draws = draw(key, route, params.env, actions)
        none = jnp.zeros(draws.rate_bps.shape, bool)

        def fixed(predicted_m: jax.Array) -> RouteResult:
            return replay_schedule(draws, route._replace(predicted_m=predicted_m), "voi", none, params, actions)

        def adapting(adaptation: Adaptation, adapt: str) -> tuple[RouteResult, jax.Array]:
            slots = slots_of(route, draws, none)
            with_it = params._replace(adaptation=adaptation)
            return scan_adapted(draws, slots, route.context, "voi", with_it, actions, adapt)

        both = jax.vmap(fixed)(jnp.stack([route.predicted_m, truth_m]))
        static, oracle = (jax.tree.map(lambda leaf, i=i: leaf[i], both) for i in (0, 1))
        # With probes and without: one program.
        twice = jax.tree.map(lambda *leaves: jnp.stack(leaves), reported, no_probes)
        by_risk, factor = jax.vmap(lambda adaptation: adapting(adaptation, "reported"))(twice)
        probing, quiet = (jax.tree.map(lambda leaf, i=i: leaf[i], by_risk) for i in (0, 1))
        runs = (static, probing, adapting(innovation, "innovation")[0], quiet, oracle)
        return Arms(
            error_m=jnp.stack([run.error_m for run in runs]),
            kb=jnp.stack([jnp.sum(run.payload_bytes) for run in runs]) / 1024.0,
            requests=jnp.stack([jnp.sum(run.sent.astype(jnp.int32)) for run in runs]),
            factor=factor[0],
        )

    found = jax.vmap(jax.vmap(one, (0, None, None)), (None, 0, 0))(keys, drives, truth_m)
    first = {name: jnp.moveaxis(getattr(found, name), 2, 0) for name in ("error_m", "kb", "requests")}
    return found._replace(**first)

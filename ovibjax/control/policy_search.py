"""Which numbers suit VOI-Control: many candidate controllers, each replayed on every route and seed.

This is the search on tuning seeds of the paper's Section "View-Rate Selection", whose "tuning seeds select the
lowest-risk feasible configuration". Feasible is a configuration that keeps the budget by its own prices on every tuning
seed; no true error is looked at.
"""

import jax
import jax.numpy as jnp

from ovibjax.control.actions import ActionSet
from ovibjax.control.client_state import ControlParams
from ovibjax.control.controller import Controller, make_controller
from ovibjax.control.environment import Draws, Environment, Route
from ovibjax.control.policies import as_written
from ovibjax.control.route_summary import Summary, score
from ovibjax.control.voi import Prices


def candidates(key: jax.Array, count: int, actions: ActionSet) -> Controller:
    """Random configurations: prices of VOI-Control; threshold and gap of its variant and of the uncertainty rule.

    Args:
        key: random key.
        count: how many.
        actions: the action set.

    Returns:
        A controller whose leaves have leading axis [count]; prices log-uniform, up to some that keep the budget where
        many answers are not found (10,000 and 1,000 m/s), the rest uniform.
    """

    def one(index: jax.Array) -> Controller:
        u = jax.random.uniform(jax.random.fold_in(key, index), (6,))
        base = make_controller(actions)
        rules = base.rules._replace(uncertainty_risk_m=2.0 + 8.0 * u[4], uncertainty_gap_s=10.0 * u[5])
        return base._replace(
            prices=Prices(10.0 ** (5.0 * u[0] - 1.0), jnp.float32(0.0), 10.0 ** (4.0 * u[1] - 1.0)),
            threshold_m=8.0 * u[2],
            min_gap_s=10.0 * u[3],
            rules=rules,
        )

    return jax.vmap(one)(jnp.arange(count))


def search(
    draws: Draws, routes: Route, env: Environment, tried: Controller, policy: str, actions: ActionSet
) -> Summary:
    """Replay every candidate on every route and seed.

    Args:
        draws: [R, S, ...] a realization per route and seed.
        routes: [R, T, ...] routes.
        env: the environment.
        tried: [C] candidates.
        policy: the policy that is searched (static).
        actions: the action set (static).

    Returns:
        Fields [routes, seeds, candidates].
    """

    def one(draws: Draws, route: Route) -> Summary:
        return jax.vmap(lambda control: score(draws, route, policy, ControlParams(env, control), actions))(tried)

    return jax.vmap(jax.vmap(one, (0, None)))(draws, routes)


def search_variants(
    draws: Draws, routes: Route, env: Environment, tried: Controller, actions: ActionSet
) -> dict[str, Summary]:
    """`search` of VOI-Control and of its variant with a threshold and a gap, in one scan.

    Args:
        draws: [R, S, ...] a realization per route and seed.
        routes: [R, T, ...] routes.
        env: the environment.
        tried: [C] candidates.
        actions: the action set (static).

    Returns:
        Fields [routes, seeds, candidates] by policy.
    """
    both = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), as_written(tried), tried)
    found = search(draws, routes, env, both, "voi_gap", actions)
    halves = jax.tree.map(lambda leaf: tuple(jnp.split(leaf, 2, axis=-1)), found)
    return {name: Summary(*(pair[i] for pair in halves)) for i, name in enumerate(("voi", "voi_gap"))}


def lowest_risk(searched: Summary, budget_kb: jax.Array) -> jax.Array:
    """Position of the candidate with the lowest mean local risk among those that keep the budget on every replay.

    Args:
        searched: replays that no budget cuts short, fields [routes, seeds, candidates].
        budget_kb: payload per route.

    Returns:
        int32; where no candidate keeps the budget, the one that spends least.
    """
    most_kb = jnp.max(searched.kb, axis=(0, 1))
    risk_m = jnp.mean(searched.risk_m, axis=(0, 1))
    feasible = most_kb <= budget_kb
    least = jnp.where(jnp.any(feasible), jnp.argmin(jnp.where(feasible, risk_m, jnp.inf)), jnp.argmin(most_kb))
    return least.astype(jnp.int32)


def take(tried: Controller, index: jax.Array) -> Controller:
    """One candidate."""
    return jax.tree.map(lambda leaf: leaf[index], tried)

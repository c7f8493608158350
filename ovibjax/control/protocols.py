"""On which routes and seeds request control is tuned, and on which it is judged.

Two protocols: `paper` tunes and judges on one held-out route with disjoint seeds, as the paper does; `transfer` tunes
on training routes and judges on the held-out ones, in turn. Both are data of one program, see `policy_study`.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.control.controller import make_controller
from ovibjax.control.environment import Route, make_environment
from ovibjax.control.policy_search import candidates
from ovibjax.control.policy_study import Outcome, RoutesAndSeeds, Setting, StudySize, study
from ovibjax.control.scene import Scene

PROTOCOLS = ("paper", "transfer")
"""Protocols by name; see `place_of`."""

PAPER_CONTEXT_MIX = (0.63, 0.20, 0.17)
"""Corridor, intersection, repetitive. The paper does not state its route's mix; at this one its upload shares of 0.5,
5.7 and 14.0 % come to its 22 requests in 593 slots (22.7)."""


def place_of(reading: int, protocol: str) -> int:
    """`policy_study.Setting.place` of a scene's number among those given to `run_study`, and a protocol."""
    return reading * len(PROTOCOLS) + PROTOCOLS.index(protocol)


def run_study(scenes: Sequence[Scene], settings: Setting, size: StudySize, first_seed: int) -> Outcome:
    """`study` on a scene with the project's seeds: tuning seeds 0, 1, ..., held-out seeds from `first_seed` on.

    Args:
        scenes: one scene in several readings, see `scene.Reading`.
        settings: [settings] drift, budget, link and place.
        size: candidates and seeds.
        first_seed: first held-out seed.

    Returns:
        The outcome.
    """
    held = [first_seed + i for i in range(size.held_out_seeds)]
    scene = scenes[0]
    routes = [routes_of(read, protocol) for read in scenes for protocol in PROTOCOLS]
    count = len(scene.training)
    # A seed of its own for each route and repetition, so that one route repeated is more seeds of it.
    seeds = jnp.arange(count * size.tuning_seeds).reshape(count, size.tuning_seeds)
    # Protocols stand side by side in one program, so that their routes are equally long.
    tuned_on, judged_on = (shortest([one for part in parts for one in part]) for parts in zip(*routes, strict=True))
    keys = jax.vmap(seeds_to_keys)(seeds)
    tuning = [RoutesAndSeeds(stack_routes(tuned, tuned_on), keys) for tuned, _ in routes]
    judged = [RoutesAndSeeds(in_turn(held_out, len(held), judged_on), seeds_to_keys(held)) for _, held_out in routes]
    return study(
        settings,
        make_environment(scene.context_share),
        candidates(jax.random.key(0), size.candidates, scene.actions),
        make_controller(scene.actions).rules,
        *(jax.tree.map(lambda *leaves: jnp.stack(leaves), *parts) for parts in (tuning, judged)),
        scene.actions,
    )


def routes_of(scene: Scene, protocol: str) -> tuple[list[Route], list[Route]]:
    """Routes that prices are tuned on, and those that policies are judged on.

    Args:
        scene: routes.
        protocol: `paper`: one held-out route, see `paper_route`, for both; `transfer`: training and held-out routes.

    Returns:
        The two lists; the first is equally long under both protocols.
    """
    if protocol == "transfer":
        return scene.training, scene.held_out
    route = scene.held_out[paper_route(scene)]
    return [route] * len(scene.training), [route]


def paper_route(scene: Scene) -> int:
    """The held-out route whose mix of contexts is nearest to the paper's route, by the sum of absolute differences."""
    known = len(PAPER_CONTEXT_MIX)
    mixes = [np.bincount(route.context, minlength=known)[:known] / len(route.context) for route in scene.held_out]
    return int(np.argmin([np.abs(mix - np.array(PAPER_CONTEXT_MIX)).sum() for mix in mixes]))


def shortest(routes: list[Route]) -> int:
    """Slots of the shortest of some routes."""
    return min(len(route.context) for route in routes)


def stack_routes(routes: list[Route], slots: int | None = None) -> Route:
    """Routes of equal length with a leading axis; longer ones are cut to so many slots, or to the shortest."""
    most = shortest(routes) if slots is None else slots
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf[:most]) for leaf in leaves]), *routes)


def seeds_to_keys(seeds: Sequence[int] | np.ndarray | jax.Array) -> jax.Array:
    """One key per seed."""
    return jax.vmap(jax.random.key)(jnp.asarray(seeds, jnp.uint32))


def in_turn(routes: list[Route], count: int, slots: int | None = None) -> Route:
    """So many routes, those that are given in turn, with a leading axis; cut as `stack_routes` does."""
    return jax.tree.map(lambda leaf: leaf[np.arange(count) % len(routes)], stack_routes(routes, slots))

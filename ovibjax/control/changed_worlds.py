"""Routes through a scene that, from some slot on, behaves otherwise than the training routes did; ours.

What changes is what the edge answers: its realised residuals and the risks that it reports with them. They are taken
from real answers, of other actions, of other frames, or of features with noise; none is made up.
"""

from collections.abc import Sequence

import numpy as np

from ovibjax.control.actions import ActionSet
from ovibjax.control.environment import Route

NOISE = {"degraded": 0.5, "failing": 0.7}
"""Length of the noise on a view's feature of unit length where a backbone degrades, and where it all but fails."""


def from_slot(route: Route, changed: Route, slot: int) -> Route:
    """A route whose answers are those of another from a slot on.

    Args:
        route: fields [T, ...].
        changed: the same route in another world.
        slot: the first slot that is changed.

    Returns:
        The route.
    """
    after = np.arange(len(route.context)) >= slot
    return route._replace(
        residual_m=np.where(after[:, None, None], changed.residual_m, route.residual_m),
        risk_m=np.where(after[:, None], changed.risk_m, route.risk_m),
    )


def front_as_good_as_all(route: Route, actions: ActionSet) -> Route:
    """The front view, at any prefix, brings what all views at the longest prefix bring on the same frame."""
    front = np.array([mode == "F" for mode in actions.modes for _ in actions.prefixes])
    return route._replace(
        residual_m=np.where(front[None, :, None], route.residual_m[:, -1:], route.residual_m),
        risk_m=np.where(front[None], route.risk_m[:, -1:], route.risk_m),
    )


def no_longer_repetitive(route: Route, contexts: Sequence[str]) -> Route:
    """Every frame of a repetitive block is answered as some frame of a corridor on the same route, drawn at random.

    Args:
        route: fields [T, ...].
        contexts: names of the contexts.

    Returns:
        The route; as it was if it has no corridor.
    """
    blocks, corridor = (np.flatnonzero(route.context == contexts.index(name)) for name in ("repetitive", "corridor"))
    rows = np.arange(len(route.context))
    if len(corridor):
        rows[blocks] = np.random.default_rng(0).choice(corridor, len(blocks))
    return route._replace(residual_m=route.residual_m[rows], risk_m=route.risk_m[rows])


def noisy(features: np.ndarray, noise: float) -> np.ndarray:
    """Features of a backbone that degrades.

    Args:
        features: [N, M, d] unit-norm view features.
        noise: length of the noise that is added to each.

    Returns:
        [N, M, d] of unit norm again.
    """
    normal = np.random.default_rng(0).standard_normal(features.shape, np.float32)
    mixed = features + np.float32(noise / np.sqrt(features.shape[-1])) * normal
    unit: np.ndarray = mixed / np.linalg.norm(mixed, axis=-1, keepdims=True)
    return unit


def one_after_another(routes: Sequence[Route], rounds: int = 1) -> Route:
    """One long route along several, so many times."""
    parts = [np.asarray(getattr(route, name)) for name in Route._fields for route in routes]
    count = len(routes)
    joined = [np.concatenate(parts[i : i + count] * rounds) for i in range(0, len(parts), count)]
    return Route(*joined)


def true_prior_m(prior_of: np.ndarray, context: np.ndarray, slot: int) -> np.ndarray:
    """What an oracle expects in each slot.

    Args:
        prior_of: [2, C, A] the prior as fitted on the route's own world before the change, and after it.
        context: [T] contexts.
        slot: the first slot that is changed.

    Returns:
        [T, A] metres.
    """
    after = (np.arange(len(context)) >= slot).astype(int)
    return prior_of[after, context]

"""What an answer's distinctness says of its error: the calibrated residual that comes with a correction.

The edge knows how much nearer the best match is than the most similar reference in another place. Of gross mismatches
that is little, so that the answers fall into two populations, found and not found, and one spread for both is wrong for
either. On training routes the mean squared error is fitted as a function of the distinctness that never rises, an
isotonic regression on levels of equally many frames. The fit keeps the mean of every level that it pools: of what the
levels claim and what training routes showed, the means are equal.

This is how we read the calibration; the paper states what the prediction before a request is, see `predictor`, and that
"the median reduces the effect of rare high-residual views", which a risk held after a correction may not do. Of the
similarity, its difference to the best elsewhere, and the ratio of distances, the last told the two populations apart
best on training routes: at 18 m and compact prefixes of all views, 3 gross errors in the better half against 18 and 8.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

LEVELS = 16
"""Levels that are told apart, with equally many training frames each; a choice of ours."""


class Calibration(NamedTuple):
    """Mean squared error by level of the distinctness, for each action.

    Attributes:
        edges: [A, LEVELS - 1] ascending, at which a level begins, from the second on.
        mean_square_m2: [A, LEVELS] mean squared residual, not rising, m^2.
    """

    edges: jax.Array
    mean_square_m2: jax.Array


def fit_calibration(distinctness: jax.Array, squared_m2: jax.Array, known: jax.Array) -> Calibration:
    """Fit the mean squared residual by distinctness, on training routes.

    Args:
        distinctness: [F, A] how distinct the answers are, see `edge.retrieval.Match`.
        squared_m2: [F, A] squared residuals, m^2.
        known: [F] frames of training routes, at least `LEVELS` of them; others do not matter.

    Returns:
        The calibration; traceable.
    """
    count = jnp.sum(known.astype(jnp.int32))
    rank = jnp.arange(known.shape[0])
    # Frames that are not known are sorted to the end and belong to no level.
    level = jnp.where(rank < count, rank * LEVELS // count, LEVELS)
    first = -(-jnp.arange(1, LEVELS) * count // LEVELS)

    def one(distinctness: jax.Array, squared_m2: jax.Array) -> Calibration:
        order = jnp.argsort(jnp.where(known, distinctness, jnp.inf))
        summed = jax.ops.segment_sum(squared_m2[order], level, LEVELS + 1)[:LEVELS]
        sizes = jax.ops.segment_sum(jnp.ones_like(squared_m2), level, LEVELS + 1)[:LEVELS]
        return Calibration(distinctness[order][first], not_rising(summed / sizes, sizes))

    return jax.vmap(one, (1, 1))(distinctness, squared_m2)


def not_rising(values: jax.Array, weights: jax.Array) -> jax.Array:
    """The nearest sequence, by weighted squares, that never rises (isotonic regression).

    Args:
        values: [B] numbers.
        weights: [B] positive weights.

    Returns:
        [B], by the min-max formula: the least over starts up to here of the largest mean up to an end from here on.
    """
    places = np.arange(values.shape[0])
    start, end = places[:, None], places[None, :]
    # Every run is summed by itself: differences of running sums would drown small values behind large ones.
    member = jnp.asarray((places >= start[..., None]) & (places <= end[..., None]), values.dtype)
    mean = jnp.where(start <= end, (member @ (values * weights)) / jnp.maximum(member @ weights, 1e-30), -jnp.inf)
    largest = jax.lax.cummax(mean, axis=1, reverse=True)  # [start, k]: over ends from k on
    return jnp.min(jnp.where(start <= end, largest, jnp.inf), axis=0)


def calibrated_risk_m(calibration: Calibration, distinctness: jax.Array) -> jax.Array:
    """The risk that comes with an answer: root of the mean squared residual of answers as distinct as this one.

    Args:
        calibration: fitted on training routes.
        distinctness: [F, A] how distinct answers are.

    Returns:
        [F, A] metres.
    """

    def one(calibration: Calibration, distinctness: jax.Array) -> jax.Array:
        return jnp.sqrt(calibration.mean_square_m2[jnp.searchsorted(calibration.edges, distinctness, side="right")])

    return jax.vmap(one, (0, 1), 1)(calibration, distinctness)

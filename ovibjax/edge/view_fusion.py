"""How much each view counts in uncompressed retrieval: weights calibrated on spatial folds of the references (paper,
"Real-Scene Multi-Platform Evaluation").

A query is compared with a reference by s = sum_m w_m <q_m, r_m> over its views m, with weights on the simplex. They
minimise a smooth stand-in for the retrieval error of each fold against the other folds: the position error averaged
over the references by a softmax of their similarity. This is the one module that uses jaxopt, which is unmaintained.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxopt import ProjectedGradient
from jaxopt.projection import projection_simplex

from ovibjax.edge.localize import errors

FOLDS = 5
"""Spatial folds of the paper."""

TEMPERATURES = (0.03, 0.1, 0.3)
"""Of the softmax, in standard deviations of the similarity under equal weights; calibration tries each."""

_STEPS = 200
_BLOCK_FRAMES = 4
_EXCLUDED = -1e9


def spatial_folds(positions: np.ndarray, n: int = FOLDS) -> np.ndarray:
    """Deal out compact blocks of neighbouring positions to n folds of nearly equal size.

    Positions are halved along their longer side until a block holds about four frames; neighbouring blocks go to
    different folds. A frame is then localized from other folds about as far as a query is from the references.

    Args:
        positions: [N, 2 or 3] metres, N >= n; the height is ignored.
        n: number of folds.

    Returns:
        [N] int32 fold of each frame, each of 0 ... n-1 present; a function of the positions alone.

    Raises:
        ValueError: fewer positions than folds.
    """
    xy = np.asarray(positions, np.float64)[:, :2]
    if not 1 <= n <= len(xy):
        raise ValueError(f"{len(xy)} positions cannot be dealt to {n} folds")
    count = n * max(1, round(len(xy) / (_BLOCK_FRAMES * n)))
    # Block b holds ends[b + 1] - ends[b] frames: sizes differ by one at most.
    ends = np.arange(count + 1) * len(xy) // count
    blocks: list[np.ndarray] = []

    def halve(rows: np.ndarray, first: int, stop: int) -> None:
        if stop - first == 1:
            blocks.append(rows)
            return
        side = int(np.argmax(np.ptp(xy[rows], axis=0)))
        # Equal coordinates keep the order of the frames.
        ordered = rows[np.lexsort((rows, xy[rows, 1 - side], xy[rows, side]))]
        middle = (first + stop) // 2
        cut = ends[middle] - ends[first]
        halve(ordered[:cut], first, middle)
        halve(ordered[cut:], middle, stop)

    halve(np.arange(len(xy)), 0, count)
    folds = np.empty(len(xy), np.int32)
    for number, rows in enumerate(blocks):
        # Turned by one in each round, as the smaller blocks recur in step with the folds.
        folds[rows] = (number + number // n) % n
    return folds


def kept_weights(weights: jax.Array, view_mask: jax.Array) -> jax.Array:
    """Weights of a view mode: those of the kept views, scaled to sum to one.

    Args:
        weights: [M] on the simplex.
        view_mask: [M] binary mask of the mode.

    Returns:
        [M]; equal weights where every kept view has weight zero.
    """
    kept = weights * view_mask
    total = jnp.sum(kept)
    return jnp.where(total > 1e-6, kept / jnp.maximum(total, 1e-6), view_mask / jnp.sum(view_mask))


def fused_descriptor(features: jax.Array, weights: jax.Array) -> jax.Array:
    """Descriptor whose inner product is the fused similarity.

    Args:
        features: [N, M, d] unit-norm features.
        weights: [M] on the simplex.

    Returns:
        [N, M d] of unit norm.
    """
    scaled = features * jnp.sqrt(weights)[None, :, None]
    return scaled.reshape(features.shape[0], -1)


def fold_similarity(features: jax.Array, folds: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Similarity of each pair of references by view, and which pairs are in different folds.

    Args:
        features: [N, M, d] unit-norm features.
        folds: [N] fold of each.

    Returns:
        [M, N, N] float32, and [N, N] bool.
    """
    similarity = jnp.einsum("imd,jmd->mij", features, features)
    return similarity, folds[:, None] != folds[None, :]


def surrogate_m(
    weights: jax.Array, similarity: jax.Array, allowed: jax.Array, distance_m: jax.Array, temperature: jax.Array
) -> jax.Array:
    """Mean over references of the position error averaged by a softmax of the fused similarity.

    Args:
        weights: [M].
        similarity: [M, N, N] of query i and reference j.
        allowed: [N, N] whether j may be retrieved for i.
        distance_m: [N, N] between their positions.
        temperature: of the softmax.

    Returns:
        Scalar, metres.
    """
    fused = jnp.tensordot(weights, similarity, axes=1) / temperature
    share = jax.nn.softmax(jnp.where(allowed, fused, _EXCLUDED), axis=1)
    return jnp.mean(jnp.sum(share * distance_m, axis=1))


def fold_error_m(weights: jax.Array, similarity: jax.Array, allowed: jax.Array, distance_m: jax.Array) -> jax.Array:
    """Mean error of retrieving each reference from the other folds; arguments as in `surrogate_m`."""
    fused = jnp.where(allowed, jnp.tensordot(weights, similarity, axes=1), -jnp.inf)
    nearest = jnp.argmax(fused, axis=1)
    return jnp.mean(jnp.take_along_axis(distance_m, nearest[:, None], axis=1))


def calibrate(features: jax.Array, positions: jax.Array, folds: jax.Array) -> jax.Array:
    """Non-negative view-fusion weights that sum to one, calibrated on spatial folds of the references.

    Projected gradient on the simplex from equal weights, once per temperature. Of the results and the equal weights,
    those with the lowest mean retrieval error on the folds are returned, so that calibration never does worse there.

    Args:
        features: [N, M, d] unit-norm features of the references.
        positions: [N, 3] metres.
        folds: [N] fold of each reference, at least two different ones.

    Returns:
        [M] float32 weights. Pure; runs under `jit` and `vmap`.
    """
    n_views = features.shape[1]
    similarity, allowed = fold_similarity(features, folds)
    distance_m = errors(positions[:, None], positions[None])
    uniform = jnp.full(n_views, 1.0 / n_views, jnp.float32)
    spread = jnp.std(jnp.tensordot(uniform, similarity, axes=1))

    def solve(scale: jax.Array) -> jax.Array:
        data = (similarity, allowed, distance_m, jnp.maximum(scale * spread, 1e-6))
        # Its line search mixes number types that strict promotion (our tests') refuses.
        with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
            solver = ProjectedGradient(surrogate_m, projection_simplex, maxiter=_STEPS, implicit_diff=False)
            found = solver.run(uniform, None, *data).params
        # The projection is exact up to rounding.
        found = jnp.maximum(found, 0.0)
        return found / jnp.sum(found)

    found = jax.vmap(solve)(jnp.array(TEMPERATURES, jnp.float32))
    candidates = jnp.concatenate([uniform[None], jnp.where(jnp.isfinite(found), found, uniform[None])])
    error_m = jax.vmap(lambda weights: fold_error_m(weights, similarity, allowed, distance_m))(candidates)
    return candidates[jnp.argmin(error_m)]

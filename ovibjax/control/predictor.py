"""How far off an edge correction will be, by route context and action, from residuals on training routes.

The predictor g_psi is their median (paper, eq. "edge_risk"); the spread, their root mean square, is the local risk
that a correction leaves. Both are fitted on the host, and inside a compiled program, where the training frames are a
mask; the two agree.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np


def fit_predictor(residual_m: np.ndarray, context: np.ndarray, n_contexts: int) -> np.ndarray:
    """g_psi: median residual on training routes by context and action (paper, eq. "edge_risk").

    Args:
        residual_m: [N, A] realised residuals of training frames, m.
        context: [N] context of each.
        n_contexts: number of contexts.

    Returns:
        [n_contexts, A] metres; a context that training never met has the median over all.
    """
    return _by_context(residual_m, context, n_contexts, lambda rows: np.median(rows, axis=0))


def fit_spread(residual_m: np.ndarray, context: np.ndarray, n_contexts: int) -> np.ndarray:
    """Root mean square of the residuals; arguments and result as in `fit_predictor`."""
    return _by_context(residual_m, context, n_contexts, lambda rows: np.sqrt(np.mean(rows.astype(float) ** 2, axis=0)))


def _by_context(
    residual_m: np.ndarray, context: np.ndarray, n_contexts: int, statistic: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    rows = [residual_m[context == c] for c in range(n_contexts)]
    return np.stack([statistic(r if len(r) else residual_m) for r in rows]).astype(np.float32)


def predictor_of_known(
    residual_m: jax.Array, context: jax.Array, known: jax.Array, n_contexts: int
) -> tuple[jax.Array, jax.Array]:
    """`fit_predictor` and `fit_spread` of the frames that a mask selects, traceable.

    Args:
        residual_m: [F, A] residuals.
        context: [F] contexts.
        known: [F] frames of training routes.
        n_contexts: number of contexts (static).

    Returns:
        [n_contexts, A] medians and root mean squares in metres; a context that training never met has those of all.
    """

    def one(c: jax.Array) -> tuple[jax.Array, jax.Array]:
        mine = known & (context == c)
        mine = jnp.where(jnp.any(mine), mine, known)
        ascending = jnp.sort(jnp.where(mine[:, None], residual_m, jnp.inf), axis=0)
        count = jnp.sum(mine.astype(jnp.int32))
        median_m = 0.5 * (ascending[(count - 1) // 2] + ascending[count // 2])
        return median_m, jnp.sqrt(jnp.mean(residual_m**2, axis=0, where=mine[:, None]))

    return jax.vmap(one)(jnp.arange(n_contexts))

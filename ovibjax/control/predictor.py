"""The predictor g_psi: how far off an edge correction will be, by route context and action (paper, eq. "edge_risk").

"g_psi returns the median edge residual observed on training routes for the same context and action", and "the median
reduces the effect of rare high-residual views and stabilizes action ranking" (same section). Two functions fit it, one
on the host and one inside a compiled program, where the training frames are a mask; they agree.

A variant of ours expects what comes with the answer, the calibrated risk of `calibration`, by its mean: see `PRIORS`.
"""

import jax
import jax.numpy as jnp
import numpy as np

PRIORS = ("median", "calibrated")
"""What an action is expected to leave: the paper's median residual, or the mean calibrated risk (ours)."""


def fit_predictor(residual_m: np.ndarray, context: np.ndarray, n_contexts: int) -> np.ndarray:
    """g_psi: median residual on training routes by context and action (paper, eq. "edge_risk").

    Args:
        residual_m: [N, A] realised residuals of training frames, m.
        context: [N] context of each.
        n_contexts: number of contexts.

    Returns:
        [n_contexts, A] metres; a context that training never met has the median over all.
    """
    rows = [residual_m[context == c] for c in range(n_contexts)]
    return np.stack([np.median(r if len(r) else residual_m, axis=0) for r in rows]).astype(np.float32)


def fit_calibrated_prior(risk_m: np.ndarray, context: np.ndarray, n_contexts: int) -> np.ndarray:
    """Mean calibrated risk on training routes by context and action; ours, see `PRIORS`.

    Args:
        risk_m: [N, A] calibrated risks of training frames, m.
        context: [N] context of each.
        n_contexts: number of contexts.

    Returns:
        [n_contexts, A] metres; a context that training never met has the mean over all.
    """
    rows = [risk_m[context == c] for c in range(n_contexts)]
    return np.stack([np.mean(r if len(r) else risk_m, axis=0) for r in rows]).astype(np.float32)


def predictor_of_known(residual_m: jax.Array, context: jax.Array, known: jax.Array, n_contexts: int) -> jax.Array:
    """`fit_predictor` of the frames that a mask selects, traceable.

    Args:
        residual_m: [F, A] residuals.
        context: [F] contexts.
        known: [F] frames of training routes.
        n_contexts: number of contexts (static).

    Returns:
        [n_contexts, A] metres; a context that training never met has the median over all.
    """

    def one(c: jax.Array) -> jax.Array:
        mine = known & (context == c)
        mine = jnp.where(jnp.any(mine), mine, known)
        ascending = jnp.sort(jnp.where(mine[:, None], residual_m, jnp.inf), axis=0)
        count = jnp.sum(mine.astype(jnp.int32))
        return 0.5 * (ascending[(count - 1) // 2] + ascending[count // 2])

    return jax.vmap(one)(jnp.arange(n_contexts))

"""From a regressed and a retrieved position to one estimate, and its error in metres (paper, "System Architecture" and
"Experimental Setup").
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

ETAS = tuple(i / 20 for i in range(21))
"""Mixing weights that validation chooses among."""


class ErrorSummary(NamedTuple):
    """Localization error over a set of frames; arrays share the leading axes of the input.

    Attributes:
        mean_m: mean error.
        median_m: median error.
        p90_m: 90th percentile.
        p95_m: 95th percentile.
        recall: share of frames within the given radius.
    """

    mean_m: jax.Array
    median_m: jax.Array
    p90_m: jax.Array
    p95_m: jax.Array
    recall: jax.Array


def mix(reg: jax.Array, ret: jax.Array, eta: jax.Array) -> jax.Array:
    """Estimate eta * regression + (1 - eta) * retrieval.

    Args:
        reg: [..., 3] regressed positions, m.
        ret: [..., 3] positions of the retrieved references, m.
        eta: scalar in [0, 1].

    Returns:
        [..., 3] estimated positions, m.
    """
    return eta * reg + (1.0 - eta) * ret


def errors(est: jax.Array, truth: jax.Array) -> jax.Array:
    """Euclidean distance between estimates [..., 3] and ground truth [..., 3], in metres."""
    return jnp.sqrt(jnp.sum((est - truth) ** 2, axis=-1))


def select_eta(reg: jax.Array, ret: jax.Array, truth: jax.Array) -> jax.Array:
    """Mixing weight with the lowest mean error on validation data; ties go to the smaller weight.

    Args:
        reg: [N, 3] regressed positions, m.
        ret: [N, 3] retrieved positions, m.
        truth: [N, 3] true positions, m.

    Returns:
        eta, one of `ETAS`.
    """
    etas = jnp.array(ETAS, jnp.float32)
    means = jax.vmap(lambda eta: jnp.mean(errors(mix(reg, ret, eta), truth)))(etas)
    return etas[jnp.argmin(means)]


def summarize(error_m: jax.Array, recall_m: float = 5.0) -> ErrorSummary:
    """Mean, median, tail percentiles and recall of errors [..., N] over the last axis.

    Args:
        error_m: [..., N] errors in metres.
        recall_m: radius within which a frame counts as localized.

    Returns:
        The summary, each field [...].
    """
    return ErrorSummary(
        mean_m=jnp.mean(error_m, axis=-1),
        median_m=jnp.median(error_m, axis=-1),
        p90_m=jnp.percentile(error_m, 90.0, axis=-1),
        p95_m=jnp.percentile(error_m, 95.0, axis=-1),
        recall=jnp.mean((error_m <= recall_m).astype(jnp.float32), axis=-1),
    )

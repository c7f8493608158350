"""Product quantisation: a rival that sends one byte per group of principal coordinates, the number of a centroid.

As in Jégou, Douze and Schmid, "Product quantization for nearest neighbor search", 2011, with groups that share the
variance evenly (Ge, He, Ke and Sun, "Optimized product quantization", 2013). A code of M bytes cannot be cut to fewer:
every size is a code of its own.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.encoder.pca import fit_pca

CENTROIDS = 256
"""Centroids of a group: what a byte can name."""

_ROUNDS = 25


class ProductQuantiser(NamedTuple):
    """A fitted quantiser.

    Attributes:
        axes: [M, D, d] principal directions of each group.
        centroids: [M, C, d] centroids in the coordinates of each group.
    """

    axes: jax.Array
    centroids: jax.Array


def fit_product_quantiser(key: jax.Array, x: jax.Array, n_bytes: int, latent: int = 128) -> ProductQuantiser:
    """Fit centroids of every group by k-means, from random training frames.

    Args:
        key: random key.
        x: [N, ...] centred training features, D numbers each.
        n_bytes: groups M, at most `latent` and D.
        latent: principal coordinates that are shared out.

    Returns:
        The quantiser.
    """
    x = x.reshape(x.shape[0], -1)
    components = fit_pca(x, latent).components
    variance = np.asarray(jnp.var(x @ components, axis=0))
    axes = jnp.stack([components[:, group] for group in shared_out(variance, n_bytes)])
    grouped = jnp.einsum("nd,mdk->mnk", x, axes)
    count = min(CENTROIDS, x.shape[0])
    start = jnp.stack([grouped[m, jax.random.permutation(k, x.shape[0])[:count]] for m, k in _numbered(key, n_bytes)])
    return ProductQuantiser(axes, _lloyd(grouped, start))


def shared_out(variance: np.ndarray, groups: int) -> np.ndarray:
    """Coordinates dealt out to groups of equal size, largest variance first, to where the product is smallest so far.

    Args:
        variance: [K] descending.
        groups: how many, at most K.

    Returns:
        [groups, K // groups] indices, ascending in each group; what cannot be shared out evenly is left out.
    """
    size = len(variance) // groups
    variance = variance[: size * groups]
    members: list[list[int]] = [[] for _ in range(groups)]
    total = np.zeros(groups)
    for j, log_variance in enumerate(np.log(np.maximum(variance, 1e-12) / max(variance[-1], 1e-12))):
        free = [g for g in range(groups) if len(members[g]) < size]
        chosen = min(free, key=lambda g: (total[g], g))
        members[chosen].append(j)
        total[chosen] += log_variance
    return np.array(members)


def quantised(quantiser: ProductQuantiser, x: jax.Array) -> jax.Array:
    """Features that are left of features [B, D] when each group is replaced by its nearest centroid: [B, D]."""
    grouped = jnp.einsum("nd,mdk->mnk", x, quantiser.axes)
    chosen = jax.vmap(_nearest)(grouped, quantiser.centroids)
    received = jnp.take_along_axis(quantiser.centroids, chosen[..., None], axis=1)
    return jnp.einsum("mnk,mdk->nd", received, quantiser.axes)


def _numbered(key: jax.Array, count: int) -> list[tuple[int, jax.Array]]:
    return list(enumerate(jax.random.split(key, count)))


def _nearest(x: jax.Array, centroids: jax.Array) -> jax.Array:
    """[N] nearest of centroids [C, d] to rows [N, d]."""
    return jnp.argmin(jnp.sum(centroids**2, axis=-1)[None] - 2.0 * x @ centroids.T, axis=-1)


@jax.jit
def _lloyd(x: jax.Array, centroids: jax.Array) -> jax.Array:
    """Centroids [M, C, d] after some rounds of k-means on rows [M, N, d]; one without rows stays where it is."""
    one = jnp.ones(x.shape[1], jnp.float32)

    def moved(x: jax.Array, centroids: jax.Array) -> jax.Array:
        member = _nearest(x, centroids)
        total, count = (jax.ops.segment_sum(of_row, member, centroids.shape[0]) for of_row in (x, one))
        return jnp.where(count[:, None] > 0, total / jnp.maximum(count, 1.0)[:, None], centroids)

    # Group by group: all distances of one fit the caches.
    def group(given: tuple[jax.Array, jax.Array]) -> jax.Array:
        rows, begin = given
        return jax.lax.fori_loop(0, _ROUNDS, lambda _, c: moved(rows, c), begin)

    return jax.lax.map(group, (x, centroids))

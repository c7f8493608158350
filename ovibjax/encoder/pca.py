"""Linear baseline: principal components of the joint multi-view feature at the same number of floats."""

from typing import NamedTuple

import jax
import jax.numpy as jnp


class PCA(NamedTuple):
    """A nested linear code of flattened, masked features.

    Attributes:
        components: [D, K] orthonormal columns, most energetic first.
    """

    components: jax.Array


def fit_pca(x: jax.Array, latent: int) -> PCA:
    """Principal components of features, the best linear code of every length.

    Args:
        x: [N, ...] centred features, D numbers each.
        latent: number of components K; at most min(N, D) are kept.

    Returns:
        The code.
    """
    x = x.reshape(len(x), -1)
    _, vectors = jnp.linalg.eigh(x.T @ x)
    return PCA(vectors[:, ::-1][:, : min(latent, *x.shape)])


def pca_coordinates(pca: PCA, x: jax.Array) -> jax.Array:
    """Principal coordinates [B, K] of features [B, D]."""
    return x @ pca.components


def pca_decode(pca: PCA, coordinates: jax.Array, prefix: jax.Array) -> jax.Array:
    """Features [B, D] that the first k principal coordinates stand for.

    Args:
        pca: a fitted code.
        coordinates: [B, K] principal coordinates.
        prefix: [K] binary prefix mask; what is beyond the code's length is not used.

    Returns:
        [B, D] reconstruction.
    """
    return (coordinates * prefix[None, : pca.components.shape[1]]) @ pca.components.T

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


def pca_reconstruct(pca: PCA, x: jax.Array, prefix: jax.Array) -> jax.Array:
    """Reconstruction [B, D] of features [B, D] from their first k principal coordinates.

    Args:
        pca: a fitted code.
        x: [B, D] features.
        prefix: [K] binary prefix mask.

    Returns:
        [B, D] reconstruction.
    """
    return ((x @ pca.components) * prefix[None, : pca.components.shape[1]]) @ pca.components.T

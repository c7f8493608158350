"""The linear code against NumPy's singular vectors."""

import jax.numpy as jnp
import numpy as np

from ovibjax.encoder.pca import fit_pca, pca_coordinates, pca_decode


def test_pca_is_numpys() -> None:
    x = np.random.default_rng(0).normal(size=(60, 12)).astype(np.float32) * np.linspace(3, 0.3, 12, dtype=np.float32)
    pca = fit_pca(jnp.asarray(x), 10)
    assert pca.components.shape == (12, 10)
    _, _, vt = np.linalg.svd(x.astype(np.float64), full_matrices=False)
    for k in (1, 4, 10):
        prefix = jnp.asarray((np.arange(16) < k).astype(np.float32))
        np.testing.assert_allclose(
            pca_decode(pca, pca_coordinates(pca, jnp.asarray(x)), prefix), x @ vt[:k].T @ vt[:k], atol=2e-4
        )

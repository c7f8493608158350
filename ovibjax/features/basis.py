"""Principal components of each view: centre the features of a view and keep r coordinates of them.

The reconstruction loss in an orthonormal basis equals the full one up to the energy left out, and the view mask
keeps its meaning: a masked view is the zero vector, here the view's mean. With r = d nothing is left out.
"""

from typing import NamedTuple

import numpy as np

from ovibjax.runtime.threads import one_blas_thread


class ViewBasis(NamedTuple):
    """An affine map per view, fitted on training features only.

    Attributes:
        mean: [M, d] mean feature of each view.
        axes: [M, d, r] orthonormal columns.
        scale: scalar; coordinates are divided by it, so that their overall variance is one.
        energy_kept: [M] share of each view's variance inside the basis.
    """

    mean: np.ndarray
    axes: np.ndarray
    scale: np.ndarray
    energy_kept: np.ndarray


def fit_basis(features: np.ndarray, rank: int | None) -> ViewBasis:
    """Fit the basis on training features.

    Args:
        features: [N, M, d] unit-norm features.
        rank: coordinates r per view; None or anything not below min(N, d) keeps all d dimensions.

    Returns:
        The basis.
    """
    n, m, d = features.shape
    mean = features.mean(axis=0)
    centred = features - mean
    if rank is None or rank >= min(n, d):
        axes = np.broadcast_to(np.eye(d, dtype=np.float32), (m, d, d)).copy()
        kept = np.ones(m)
    else:
        parts, kept = [], np.empty(m)
        with one_blas_thread():
            for view in range(m):
                values, vectors = np.linalg.eigh((centred[:, view].T @ centred[:, view]).astype(np.float64))
                parts.append(vectors[:, ::-1][:, :rank])
                kept[view] = values[::-1][:rank].sum() / max(values.sum(), 1e-30)
        axes = np.stack(parts).astype(np.float32)
    scale = np.float32(np.sqrt(np.mean(_per_view(centred, axes) ** 2)))
    return ViewBasis(mean.astype(np.float32), axes, np.maximum(scale, np.float32(1e-8)), kept.astype(np.float32))


def project(basis: ViewBasis, features: np.ndarray) -> np.ndarray:
    """Coordinates [N, M, r] of features [N, M, d]."""
    return (_per_view(features - basis.mean, basis.axes) / basis.scale).astype(np.float32)


def _per_view(features: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """One matrix product per view: [N, M, d] by [M, d, r] to [N, M, r]."""
    with one_blas_thread():
        return np.stack([features[:, view] @ axes[view] for view in range(len(axes))], axis=1)

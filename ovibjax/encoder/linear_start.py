"""A network that begins as principal component analysis: its linear paths, and where they start."""

from typing import Any

import jax
import jax.numpy as jnp

from ovibjax.encoder.model import Architecture, Params


def linear_start(params: Params, x: jax.Array, arch: Architecture) -> Params:
    """Initial parameters whose linear paths hold the principal directions of the training features.

    Args:
        params: initial parameters, of `model.init`.
        x: [N, M, r] centred training features.
        arch: widths of the network; without linear paths nothing changes.

    Returns:
        The parameters, with L and D the leading directions and W the first K rows of the identity.
    """
    if not arch.linear:
        return params
    axes = principal_axes(x.reshape(x.shape[0], -1), max(arch.last_hidden, arch.rank))
    by_view = axes.reshape(arch.n_views, arch.view_dim, -1)
    tree = dict(params["params"])
    for view in range(arch.n_views):
        tree[f"direct_{view}"] = {"kernel": by_view[view, :, : arch.last_hidden]}
        tree[f"principal_{view}"] = {"kernel": by_view[view, :, : arch.rank].T}
    tree["mean"] = tree["mean"] | {"kernel": jnp.eye(arch.last_hidden, arch.latent, dtype=jnp.float32)}
    return {"params": tree}


def principal_axes(x: jax.Array, count: int) -> jax.Array:
    """Leading principal directions of centred rows, largest variance first, each with its largest entry positive.

    Args:
        x: [N, D] centred features.
        count: directions wanted.

    Returns:
        [D, count] orthonormal columns; columns beyond D are zero.
    """
    vectors = jnp.linalg.eigh(x.T @ x / x.shape[0])[1][:, ::-1][:, :count]
    largest = jnp.take_along_axis(vectors, jnp.argmax(jnp.abs(vectors), axis=0)[None], axis=0)
    return jnp.pad(vectors * jnp.sign(largest), ((0, 0), (0, count - vectors.shape[1])))


def linear_paths(params: Params) -> Any:
    """Which parameters belong to the linear paths of encoder and decoder.

    Args:
        params: parameters of a network with linear paths, or their gradients.

    Returns:
        A tree of the same structure: true for L, W and D.
    """
    return _layers(params, ("direct_", "mean", "principal_"))


def principal_encoder(params: Params) -> Any:
    """Which parameters make principal coordinates of features: true for L and W; arguments as for `linear_paths`."""
    return _layers(params, ("direct_", "mean"))


def _layers(params: Params, prefixes: tuple[str, ...]) -> Any:
    def belongs(path: Any, _: jax.Array) -> bool:
        return str(path[1].key).startswith(prefixes)

    return jax.tree_util.tree_map_with_path(belongs, params)

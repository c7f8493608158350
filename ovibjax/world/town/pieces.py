"""Large views cut into pieces of the shape of a batch of small ones.

Compiling the ray-caster takes longer than rendering dozens of large pictures; whoever has rendered a drive has its
programs already, and a piece stays in the processor's cache as a batch of small views does.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

PIECE_PX = 64 * 48
"""Pixels of a small view."""

_PIECE_VIEWS = 8 * 5  # a batch of small ones, as `feature_set` renders them

Rays = tuple[jax.Array, list[jax.Array], jax.Array, jax.Array]
"""Origins [V, 3], rays 3 x [V, P], and the buildings [V, B, A] and trees [V, T, A] of each view."""


def cut(origin: jax.Array, ray: list[jax.Array], boxes: jax.Array, trees: jax.Array) -> Iterator[Rays]:
    """Pieces of views; the last pixel of a view and the last row of all are repeated where there are too few.

    Args:
        origin: [V, 3].
        ray: 3 x [V, P].
        boxes: [V, B, A].
        trees: [V, T, A].

    Yields:
        The same fields, of 40 views of `PIECE_PX` pixels.
    """
    views, pixels = ray[0].shape
    per_view = -(-pixels // PIECE_PX)
    rest = ((0, 0), (0, per_view * PIECE_PX - pixels))
    axes = [np.pad(np.asarray(axis), rest, mode="edge").reshape(-1, PIECE_PX) for axis in ray]
    fields = [np.repeat(np.asarray(field), per_view, axis=0) for field in (origin, boxes, trees)]
    for start in range(0, views * per_view, _PIECE_VIEWS):
        rows = np.minimum(np.arange(start, start + _PIECE_VIEWS), views * per_view - 1)
        starts, near_boxes, near_trees = (jnp.asarray(field[rows]) for field in fields)
        yield starts, [jnp.asarray(axis[rows]) for axis in axes], near_boxes, near_trees


def joined(parts: Sequence[jax.Array], shape: tuple[int, int, int, int]) -> NDArray[Any]:
    """What was rendered in pieces, put together.

    Args:
        parts: [40, `PIECE_PX`, ...] per piece.
        shape: poses, views, rows and columns of the pictures.

    Returns:
        [poses * views, rows * columns, ...].
    """
    views, pixels = shape[0] * shape[1], shape[2] * shape[3]
    per_view = -(-pixels // PIECE_PX)
    rows = np.concatenate([np.asarray(part) for part in parts])[: views * per_view]
    return rows.reshape(views, per_view * PIECE_PX, *rows.shape[2:])[:, :pixels]

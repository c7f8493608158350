"""A database sorted by likeness: blocks of bounded size, a prototype each, and sketches that bound similarities.

Scenes and tiles (`edge.index`) are the paper's; they prune well where places that are close look alike and places that
are far apart do not. Here blocks follow the descriptors themselves, inside of tiles or of nothing.
"""

from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ovibjax.edge.index import NO_ROW, leading_basis
from ovibjax.edge.kmeans import clusters_of_at_most, coarse_groups
from ovibjax.errors import InputError

SKETCH = 32
"""Leading coordinates of a descriptor that its sketch holds."""
NO_BOUND = np.float32(-1e30)
"""Bound of a place in a block that holds no row: below any similarity, and finite, as products with it must be."""
# Rows of a block on average, and the most, over that: a narrower bound cuts more clusters, a wider one is read in vain.
_MEAN_ROWS, _FULL = (16, 256), 1.5
_ROWS_AT_ONCE = 1 << 14
# What float32 may lose of the square of a norm.
_CANCELLED = 4e-6


class ClusterIndex(NamedTuple):
    """A database prepared for `nearest`; a pytree of arrays.

    With c the mean of a descriptor's block, e its difference from it, and U the basis, the sketch holds U'e + U'c,
    the product of what U leaves out of c and of e, and the norm of what it leaves out of e (`edge.host_search` has the
    bound that they give).

    Attributes:
        descriptor: [N + B, d] unit-norm descriptors, block after block; B empty rows, so that no block reads past it.
        row: [N + B] int32 row of the database that stands there; the largest int32 at the end.
        start: [P + 1] int32 where each block begins; it has at most B rows.
        prototype: [P, d] normalised mean of each block's descriptors, by which a query ranks the blocks.
        centre: [P, s + 2] coordinates of the mean itself in `basis`, the squared norm of what these leave out, and the
            mean's norm.
        basis: [d, s] orthonormal directions that hold most of the descriptors.
        sketch: [P, s + 2, B] sketches of a block's descriptors, a column each.
    """

    descriptor: jax.Array
    row: jax.Array
    start: jax.Array
    prototype: jax.Array
    centre: jax.Array
    basis: jax.Array
    sketch: jax.Array


class Sorted(NamedTuple):
    """A database sorted into blocks, on the host.

    Attributes:
        descriptor: [N, d] unit-norm descriptors, in the database's order.
        order: [N] their rows, block after block.
        start: [P + 1] where each block begins.
        mean: [P, d] means of the blocks.
        most: B, rows of a block at most.
    """

    descriptor: NDArray[np.float32]
    order: NDArray[np.int64]
    start: NDArray[np.int64]
    mean: NDArray[np.float32]
    most: int


def build_clusters(
    db: ArrayLike, tile: ArrayLike | None, key: jax.Array | None, rows: int | None = None
) -> ClusterIndex:
    """Sort a database into blocks and sketch it.

    Args:
        db: as in `cluster_search.cluster_index`.
        tile: as in `cluster_search.cluster_index`.
        key: as in `cluster_search.cluster_index`.
        rows: as in `cluster_search.cluster_index`.

    Returns:
        The index.

    Raises:
        InputError: as in `cluster_search.cluster_index`.
    """
    made = sort_into_blocks(db, tile, key, rows)
    n, d = made.descriptor.shape
    descriptor = np.zeros((n + made.most, d), np.float32)
    np.take(made.descriptor, made.order, axis=0, out=descriptor[:n])
    basis = leading_basis(made.descriptor, min(SKETCH, d))
    order, start, mean, most = made[1:]
    del made  # a copy of the database
    return ClusterIndex(
        descriptor=jnp.asarray(descriptor),
        row=jnp.asarray(np.concatenate([order, np.full(most, NO_ROW)]), jnp.int32),
        start=jnp.asarray(start, jnp.int32),
        prototype=jnp.asarray(unit_rows(mean)),
        centre=jnp.asarray(_centres(mean, basis)),
        basis=jnp.asarray(basis),
        sketch=jnp.asarray(_sketches(descriptor[:n], start, mean, basis, most)),
    )


def sort_into_blocks(db: ArrayLike, tile: ArrayLike | None, key: jax.Array | None, rows: int | None) -> Sorted:
    """Cluster a database; arguments and errors are those of `build_clusters`."""
    given = np.asarray(db, np.float32)
    if given.ndim != 2 or 0 in given.shape:
        raise InputError(f"index: descriptors {list(given.shape)}; expected [N, d] with N and d at least 1")
    if rows is not None and rows < 1:
        raise InputError(f"index: {rows} descriptors for a prototype; give at least 1")
    unit = unit_rows(given)
    if not np.isfinite(unit).all():
        raise InputError(f"index: descriptor {np.argmin(np.isfinite(unit).all(axis=1))} is not finite or overflows")
    n = len(unit)
    mean = rows or int(np.clip(n**0.5 / 4, *_MEAN_ROWS))
    most = -(-int(_FULL * mean) // 8) * 8
    seed = np.asarray(jax.random.key_data(jax.random.key(0) if key is None else key))
    rng = np.random.default_rng(seed.astype(np.uint32).tolist())
    if tile is None:
        group = coarse_groups(unit, -(-n // mean), rng)
    else:
        _, group = np.unique(np.asarray(tile), return_inverse=True)
        if group.shape != (n,):
            raise InputError(f"index: {n} descriptors and tiles {list(np.shape(tile))}; expected one per descriptor")
    label = clusters_of_at_most(most, mean, unit, group, rng)
    start = np.concatenate([[0], np.cumsum(np.bincount(label))])
    order = np.argsort(label, kind="stable")
    return Sorted(unit, order, start, _means(unit, order, start), most)


def unit_rows(rows: NDArray[np.float32]) -> NDArray[np.float32]:
    """Rows scaled to unit norm; a zero row stays zero, and one that is no number has no norm."""
    with np.errstate(invalid="ignore", over="ignore"):
        norm: NDArray[np.float32] = np.sqrt(np.einsum("nd,nd->n", rows, rows))
        norm[norm == 0] = 1
        return rows / norm[:, None]


def _means(unit: NDArray[np.float32], order: NDArray[np.int64], start: NDArray[np.int64]) -> NDArray[np.float32]:
    """[P, d] means of the blocks."""
    means = np.empty((len(start) - 1, unit.shape[1]), np.float32)
    for block, (a, b) in enumerate(pairwise(start)):
        means[block] = unit[order[a:b]].mean(axis=0)
    return means


def _centres(mean: NDArray[np.float32], basis: NDArray[np.float32]) -> NDArray[np.float32]:
    """[P, s + 2] coordinates in a basis, the squared norm of the rest, and the norm."""
    leading, square = mean @ basis, np.einsum("pd,pd->p", mean, mean)
    rest = np.maximum(square - np.einsum("ps,ps->p", leading, leading), 0)
    return np.concatenate([leading, rest[:, None], np.sqrt(square)[:, None]], axis=1)


def _sketches(
    descriptor: NDArray[np.float32],
    start: NDArray[np.int64],
    mean: NDArray[np.float32],
    basis: NDArray[np.float32],
    most: int,
) -> NDArray[np.float32]:
    """[P, s + 2, B] sketches; where a block holds no row, one that makes its bound `NO_BOUND`."""
    blocks, size = len(mean), basis.shape[1]
    sketch = np.zeros((blocks, size + 2, most), np.float32)
    sketch[:, size] = NO_BOUND
    block = np.repeat(np.arange(blocks), np.diff(start))
    place = np.arange(len(block)) - start[block]
    for at in range(0, len(block), _ROWS_AT_ONCE):
        part = slice(at, at + _ROWS_AT_ONCE)
        centre = mean[block[part]]
        away = descriptor[part] - centre
        leading, of_centre = away @ basis, centre @ basis
        cross = np.einsum("nd,nd->n", centre, away) - np.einsum("ns,ns->n", of_centre, leading)
        rest = np.einsum("nd,nd->n", away, away) - np.einsum("ns,ns->n", leading, leading)
        rows = (leading + of_centre, cross[:, None], np.sqrt(np.maximum(rest, 0) + _CANCELLED)[:, None])
        sketch[block[part], :, place[part]] = np.concatenate(rows, axis=1)
    return sketch

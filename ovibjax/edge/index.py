"""The geo-tagged database, sorted into scenes and tiles for a fast search (paper, Section "System Architecture").

Descriptors are sorted by scene and tile, so that a search reads contiguous pieces of a fixed number of rows whatever
the sizes of scenes and tiles, and every array has a shape that depends on little more than the database's size.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ovibjax.errors import InputError

ROW_STEP, TILE_STEP = 16, 32
"""Descriptors and tile prototypes read in one piece: fewer take more steps, more are read in vain. Both tables end with
as many empty rows, so that no read goes past the end."""
SKETCH = 32
"""Leading coordinates whose product, with the norms of the rest, bounds a similarity from above."""
NO_ROW = np.iinfo(np.int32).max
_BASIS_ROWS, _BASIS_ROUNDS = 8192, 3


def normalize(rows: jax.Array) -> jax.Array:
    """Rows [..., d] scaled to unit norm; a zero row stays zero."""
    norm = jnp.sqrt(jnp.sum(rows**2, axis=-1, keepdims=True))
    return rows / jnp.where(norm > 0, norm, 1.0)


_normalize = jax.jit(normalize)


class Index(NamedTuple):
    """A database prepared for coarse-to-fine retrieval; a pytree of arrays, all of unit-norm rows.

    The table of tiles is padded, so that databases of one size share their compiled programs whatever their tiles. A
    tile number is a place in that table, which is sorted by scene; a scene number is the rank of its label.

    Attributes:
        descriptor: [N + ROW_STEP, d] descriptors, sorted by tile.
        sketch: [N + ROW_STEP, s + 1] coordinates of the descriptors in `basis`, and the norm of what these leave out.
        basis: [d, s] orthonormal directions that hold most of the descriptors.
        row: [N + ROW_STEP] int32 row of the database that stands there; `NO_ROW` at the end.
        tile_start: [T + 1] int32 where each tile begins; an empty tile begins where the next one does.
        tile_prototype: [T, d] normalised mean of a tile's descriptors, grouped by scene.
        tile_scene: [T] int32 scene of each tile, -1 where the table is padded.
        scene_start: [S + 1] int32 first tile of each scene.
        scene_prototype: [S, d] normalised mean of a scene's descriptors.
        place: [N] int32 where each row of the database stands in `descriptor`.
        row_tile: [N] int32 tile of each row.
        tile_slots: [C] bool, all true; its length C bounds the number of tiles of a scene, which must be static.
    """

    descriptor: jax.Array
    sketch: jax.Array
    basis: jax.Array
    row: jax.Array
    tile_start: jax.Array
    tile_prototype: jax.Array
    tile_scene: jax.Array
    scene_start: jax.Array
    scene_prototype: jax.Array
    place: jax.Array
    row_tile: jax.Array
    tile_slots: jax.Array

    @property
    def tile_size(self) -> jax.Array:
        """[T] int32 descriptors in each tile."""
        return self.tile_start[1:] - self.tile_start[:-1]


def build_index(db: ArrayLike, positions: ArrayLike, scene: ArrayLike, tile_m: float) -> Index:
    """Sort a database into scenes and tiles and average their descriptors.

    Args:
        db: [N, d] reference descriptors; their scale does not matter.
        positions: [N, D] coordinates that are tiled, metres; D = 2 gives squares, D = 3 cubes.
        scene: [N] int32 scene of each row.
        tile_m: edge of a tile.

    Returns:
        The index, of the tiles that hold at least one row.

    Raises:
        InputError: no rows, arrays of unequal length, values that are not finite, or an edge that is not positive.
    """
    where, label = np.asarray(positions, np.float64), np.asarray(scene)
    shape = np.shape(db)
    if len(shape) != 2 or shape[0] == 0 or where.ndim != 2 or not len(where) == len(label) == shape[0]:
        raise InputError(
            f"index: descriptors {list(shape)}, positions {list(where.shape)} and scenes {list(label.shape)}; "
            "expected [N, d], [N, D] and [N] with N at least 1"
        )
    if not (np.isfinite(tile_m) and tile_m > 0):
        raise InputError(f"index: tiles of {tile_m:g} m; give a positive edge")
    if not np.isfinite(where).all():
        raise InputError("index: a position is not finite (NaN or infinity)")
    _, scene_number = np.unique(label, return_inverse=True)
    tile = scene_number.ravel()
    for cells in np.floor(where / tile_m).T:
        # Column by column: each step keeps the order of the one before and stays below N squared.
        values, which = np.unique(cells, return_inverse=True)
        _, tile = np.unique(tile * len(values) + which.ravel(), return_inverse=True)
    return index_of_tiles(db, tile.ravel(), scene_number.ravel())


def index_of_tiles(db: ArrayLike, tile: NDArray[np.integer], scene: NDArray[np.integer]) -> Index:
    """The index of rows whose tile is known, such as the cells of a grid laid out beforehand; cells may be empty.

    Args:
        db: [N, d] reference descriptors.
        tile: [N] tile of each row, from 0; tiles are numbered scene by scene.
        scene: [N] scene of each row, from 0, ascending with the tile.

    Returns:
        The index.

    Raises:
        InputError: a descriptor that is not finite.
    """
    unit = np.asarray(_normalize(jnp.asarray(db, jnp.float32)))
    n, d = unit.shape
    if not np.isfinite(unit).all():
        raise InputError(f"index: descriptor {np.argmin(np.isfinite(unit).all(axis=1))} is not finite or overflows")
    n_scenes, n_tiles = int(scene.max()) + 1, int(tile.max()) + 1
    # A stable sort keeps the rows of a tile in their order: the first of equal places is the lower row.
    order = np.argsort(tile, kind="stable")
    place = np.empty(n, np.int64)
    place[order] = np.arange(n)
    owner = np.zeros(n_tiles, np.int64)
    owner[tile] = scene
    owner = np.maximum.accumulate(owner)  # an empty tile goes with the scene before it
    tiles_of = np.bincount(owner, minlength=n_scenes)
    padded = _round_up(n_tiles + TILE_STEP)
    start = np.concatenate([[0], np.cumsum(np.bincount(tile, minlength=padded))])
    basis = leading_basis(unit, min(SKETCH, d))
    descriptor = np.concatenate([unit[order], np.zeros((ROW_STEP, d), np.float32)])
    return Index(
        descriptor=jnp.asarray(descriptor),
        sketch=jnp.asarray(_sketch(descriptor, basis)),
        basis=jnp.asarray(basis),
        row=jnp.asarray(np.concatenate([order, np.full(ROW_STEP, NO_ROW)]), jnp.int32),
        tile_start=jnp.asarray(start, jnp.int32),
        tile_prototype=_prototypes(unit, tile, padded),
        tile_scene=jnp.asarray(np.concatenate([owner, np.full(padded - n_tiles, -1)]), jnp.int32),
        scene_start=jnp.asarray(np.concatenate([[0], np.cumsum(tiles_of)]), jnp.int32),
        scene_prototype=_prototypes(unit, scene, n_scenes),
        place=jnp.asarray(place, jnp.int32),
        row_tile=jnp.asarray(tile, jnp.int32),
        tile_slots=jnp.ones(_round_up(int(tiles_of.max())), bool),
    )


def leading_basis(unit: NDArray[np.float32], size: int) -> NDArray[np.float32]:
    """[d, size] near the leading singular directions; any orthonormal one gives the same answers, this one sooner."""
    rows = unit[:: -(-len(unit) // _BASIS_ROWS)].astype(np.float64)
    basis = np.random.default_rng(0).normal(size=(unit.shape[1], size))
    for _ in range(_BASIS_ROUNDS):
        basis = np.linalg.qr(rows.T @ (rows @ basis))[0]  # orthonormal also where the rows have fewer directions
    return basis.astype(np.float32)


def _sketch(descriptor: NDArray[np.float32], basis: NDArray[np.float32]) -> NDArray[np.float32]:
    """[N, s + 1] coordinates in a basis, and the norm of the rest, rounded up."""
    leading = descriptor @ basis
    rest = np.sqrt(np.maximum(1.0 - np.sum(leading.astype(np.float64) ** 2, axis=1), 0.0) + 1e-6)
    return np.concatenate([leading, rest[:, None].astype(np.float32)], axis=1)


def _prototypes(unit: NDArray[np.float32], group: NDArray[np.integer], n_groups: int) -> jax.Array:
    """[n_groups, d] normalised means; zero for a group without rows."""
    order = np.argsort(group, kind="stable")
    sums = np.zeros((n_groups, unit.shape[1]))
    present, start = np.unique(group[order], return_index=True)
    for g, a, b in zip(present, start, [*start[1:], len(group)], strict=True):
        sums[g] = unit[order[a:b]].sum(axis=0, dtype=np.float64)
    return _normalize(jnp.asarray(sums, jnp.float32))


def _round_up(count: int) -> int:
    """The next multiple of `TILE_STEP`, or of an eighth of the number's power of two where that is larger."""
    step = max(TILE_STEP, 1 << max(count.bit_length() - 4, 0))
    return -(-count // step) * step

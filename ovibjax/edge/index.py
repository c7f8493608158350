"""The geo-tagged database as an index of scenes and tiles (paper, Section "System Architecture").

Descriptors are sorted by scene and tile and cut into pages of a fixed number of rows, so that a search reads whole
contiguous pages whatever the sizes of the tiles, and an array has one shape whatever the database looks like.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ovibjax.errors import InputError

PAGE_ROWS = 8
"""Descriptors per page. A page is read in one piece: fewer rows cost more steps, more rows more empty places."""
NO_ROW = np.iinfo(np.int32).max
TILE_STEP = 32
"""Tile prototypes read in one piece; the table of tiles ends with as many empty ones, so that no read ends outside."""
_ROUND_PAGES = 64


def normalize(rows: jax.Array) -> jax.Array:
    """Rows [..., d] scaled to unit norm; a zero row stays zero."""
    norm = jnp.sqrt(jnp.sum(rows**2, axis=-1, keepdims=True))
    return rows / jnp.where(norm > 0, norm, 1.0)


_normalize = jax.jit(normalize)


class Index(NamedTuple):
    """A database prepared for coarse-to-fine retrieval; a pytree of arrays, all of unit-norm rows.

    Page, tile and scene tables are padded, so that databases of similar size share their compiled programs. A tile
    number is a place in the table of tiles, which is sorted by scene; a scene number is the rank of its label.

    Attributes:
        pages: [G, P, d] descriptors, sorted by tile; a tile begins with a page of its own.
        page_row: [G, P] int32 row of the database that stands there, `NO_ROW` where none does.
        tile_page: [T + 1] int32 first page of each tile; an empty tile begins where the next one does.
        tile_size: [T] int32 descriptors in each tile.
        tile_prototype: [T, d] normalised mean of a tile's descriptors, grouped by scene.
        tile_scene: [T] int32 scene of each tile, -1 where the table is padded.
        scene_tile: [S + 1] int32 first tile of each scene.
        scene_prototype: [S, d] normalised mean of a scene's descriptors.
        row_place: [N] int32 place of each row of the database in the flattened pages.
        row_tile: [N] int32 tile of each row.
        tile_slots: [C] bool, all true; its length C bounds the number of tiles of a scene, which must be static.
    """

    pages: jax.Array
    page_row: jax.Array
    tile_page: jax.Array
    tile_size: jax.Array
    tile_prototype: jax.Array
    tile_scene: jax.Array
    scene_tile: jax.Array
    scene_prototype: jax.Array
    row_place: jax.Array
    row_tile: jax.Array
    tile_slots: jax.Array


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
    cell = np.floor(where / tile_m)
    _, tile = np.unique(np.column_stack([scene_number.ravel(), cell]), axis=0, return_inverse=True)
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
    count = np.bincount(tile, minlength=n_tiles)
    first_page = np.concatenate([[0], np.cumsum(-(-count // PAGE_ROWS))])

    # A stable sort keeps the rows of a tile in their order: the first of equal places is the lower row.
    order = np.argsort(tile, kind="stable")
    within = np.arange(n) - np.repeat(np.cumsum(count) - count, count)
    place = np.empty(n, np.int64)
    place[order] = first_page[tile[order]] * PAGE_ROWS + within

    n_pages = _round_up(int(first_page[-1]), _ROUND_PAGES)
    pages = np.zeros((n_pages * PAGE_ROWS, d), np.float32)
    pages[place] = unit
    page_row = np.full(n_pages * PAGE_ROWS, NO_ROW, np.int32)
    page_row[place] = np.arange(n)

    owner = np.zeros(n_tiles, np.int64)
    owner[tile] = scene
    owner = np.maximum.accumulate(owner)  # an empty tile goes with the scene before it
    tiles_of = np.bincount(owner, minlength=n_scenes)
    padded = _round_up(n_tiles + TILE_STEP, TILE_STEP)
    tile_page = np.concatenate([first_page, np.full(padded - n_tiles, first_page[-1])])
    return Index(
        pages=jnp.asarray(pages.reshape(n_pages, PAGE_ROWS, d)),
        page_row=jnp.asarray(page_row.reshape(n_pages, PAGE_ROWS)),
        tile_page=jnp.asarray(tile_page, jnp.int32),
        tile_size=jnp.asarray(np.concatenate([count, np.zeros(padded - n_tiles)]), jnp.int32),
        tile_prototype=_prototypes(unit, tile, padded),
        tile_scene=jnp.asarray(np.concatenate([owner, np.full(padded - n_tiles, -1)]), jnp.int32),
        scene_tile=jnp.asarray(np.concatenate([[0], np.cumsum(tiles_of)]), jnp.int32),
        scene_prototype=_prototypes(unit, scene, n_scenes),
        row_place=jnp.asarray(place, jnp.int32),
        row_tile=jnp.asarray(tile, jnp.int32),
        tile_slots=jnp.ones(_round_up(int(tiles_of.max()), TILE_STEP), bool),
    )


def _prototypes(unit: NDArray[np.float32], group: NDArray[np.integer], n_groups: int) -> jax.Array:
    """[n_groups, d] normalised means; zero for a group without rows."""
    order = np.argsort(group, kind="stable")
    sums = np.zeros((n_groups, unit.shape[1]))
    present, start = np.unique(group[order], return_index=True)
    for g, a, b in zip(present, start, [*start[1:], len(group)], strict=True):
        sums[g] = unit[order[a:b]].sum(axis=0, dtype=np.float64)
    return _normalize(jnp.asarray(sums, jnp.float32))


def _round_up(count: int, step: int) -> int:
    """The next multiple of a step, or of an eighth of the number's power of two where that is larger."""
    step = max(step, 1 << max(count.bit_length() - 4, 0))
    return -(-count // step) * step

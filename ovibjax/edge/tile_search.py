"""The coarse-to-fine search: scene prototypes, then tile prototypes, then the descriptors of the tiles that are kept.

On a CPU the fine search is bound by memory. It therefore reads a sketch of the kept descriptors first, whose product
bounds the similarity from above (Cauchy and Schwarz), and reads a piece of descriptors itself only where that bound
reaches the best so far: the answer is that of reading them all.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.edge.index import NO_ROW, ROW_STEP, TILE_STEP, Index

_SEARCH_BLOCK = 256
# A product over all tiles runs at the speed of arithmetic, reading a query's own tiles at that of memory.
_DENSE = 4
# Sketches of so many tiles are gathered at a time, which bounds the memory of a query that keeps all of them.
_TILES_AT_ONCE = 128
# What float32 may lose, relative to the query's norm: in a product, and in the square of what the sketch leaves out.
_ROUNDING, _CANCELLED = 2e-5, 4e-6
_Best = tuple[jax.Array, jax.Array]
"""Similarity and row."""


class Found(NamedTuple):
    """Outcome of a coarse-to-fine search, and what the pruning kept.

    Attributes:
        row: [Q] int32 most similar row among those searched.
        scenes: [Q, scenes] int32 scenes kept, ascending.
        tiles: [Q, tiles] int32 tiles kept, most similar first; -1 where the kept scenes have no more.
        searched: [Q] int32 descriptors compared in the fine search.
    """

    row: jax.Array
    scenes: jax.Array
    tiles: jax.Array
    searched: jax.Array


def search(query: jax.Array, index: Index, scenes: int, tiles: int) -> Found:
    """`retrieval.coarse_to_fine` with a record of what was kept and how much was searched.

    All queries are one compiled call, and batches of all sizes share a program per power of two.

    Args:
        query: as in `retrieval.coarse_to_fine`.
        index: as in `retrieval.coarse_to_fine`.
        scenes: as in `retrieval.coarse_to_fine`.
        tiles: as in `retrieval.coarse_to_fine`.

    Returns:
        Outcome of each query. Memory beside the index is bounded by blocks of queries.

    Raises:
        ValueError: `scenes` or `tiles` below one.
    """
    if scenes < 1 or tiles < 1:
        raise ValueError(f"scenes = {scenes}, tiles = {tiles}: keep at least one of each")
    n = query.shape[0]
    scenes = min(scenes, index.scene_prototype.shape[0])
    tiles = min(tiles, index.tile_prototype.shape[0])
    room = 1 << max(n - 1, 0).bit_length()
    traced = any(isinstance(leaf, jax.core.Tracer) for leaf in (query, *index))
    if traced:
        found = _search(jnp.pad(query, ((0, room - n), (0, 0))), jnp.int32(n), index, scenes, tiles)
        return jax.tree.map(lambda field: field[:n], found)
    # On the host: a pad or a slice of every size would be a program of its own.
    padded = np.zeros((room, query.shape[1]), np.float32)
    padded[:n] = query
    found = _search(jnp.asarray(padded), jnp.int32(n), index, scenes, tiles)
    if n == room:
        return found
    return jax.tree.map(lambda field: jnp.asarray(np.asarray(field)[:n]), found)


@partial(jax.jit, static_argnames=("scenes", "tiles"))
def _search(query: jax.Array, n: jax.Array, index: Index, scenes: int, tiles: int) -> Found:
    """The first n queries, block after block; the rest of the output stays as it began."""
    room = query.shape[0]
    block = min(room, _SEARCH_BLOCK)

    def one_block(b: jax.Array, found: Found) -> Found:
        start = b * block
        part = _search_block(
            jax.lax.dynamic_slice_in_dim(query, start, block), jnp.minimum(n - start, block), index, scenes, tiles
        )
        return jax.tree.map(
            lambda whole, piece: jax.lax.dynamic_update_slice_in_dim(whole, piece, start, 0), found, part
        )

    nothing = Found(
        jnp.full(room, NO_ROW, jnp.int32),
        jnp.full((room, scenes), -1, jnp.int32),
        jnp.full((room, tiles), -1, jnp.int32),
        jnp.zeros(room, jnp.int32),
    )
    return jax.lax.fori_loop(0, (n + block - 1) // block, one_block, nothing)


def _search_block(query: jax.Array, n: jax.Array, index: Index, scenes: int, tiles: int) -> Found:
    block = query.shape[0]
    if scenes == index.scene_prototype.shape[0]:
        kept_scenes = jnp.broadcast_to(jnp.arange(scenes, dtype=jnp.int32)[None], (block, scenes))
    else:
        kept_scenes = jnp.sort(jax.lax.top_k(query @ index.scene_prototype.T, scenes)[1], axis=1)
    # Rows of the padding keep no tile, and cost nothing below.
    asked = jnp.arange(block)[:, None] < n
    kept_tiles = jnp.where(asked, _rank_tiles(query, n, index, kept_scenes, tiles), -1)

    rows = _search_tiles(query, kept_tiles, index)
    searched = jnp.sum(jnp.where(kept_tiles < 0, 0, index.tile_size[kept_tiles]), axis=1)
    return Found(rows, kept_scenes, kept_tiles, searched)


def _search_tiles(query: jax.Array, kept_tiles: jax.Array, index: Index) -> jax.Array:
    """[block] most similar row of the kept tiles, the most promising pieces of them first."""
    end = index.descriptor.shape[0] - ROW_STEP
    lanes = jnp.arange(ROW_STEP, dtype=jnp.int32)
    chunk = min(_TILES_AT_ONCE, kept_tiles.shape[1])
    chunks = -(-kept_tiles.shape[1] // chunk)
    kept_tiles = jnp.pad(kept_tiles, ((0, 0), (0, chunks * chunk - kept_tiles.shape[1])), constant_values=-1)
    square = jnp.sum(query**2, axis=1, keepdims=True)
    leading = query @ index.basis
    left = jnp.maximum(square - jnp.sum(leading**2, axis=1, keepdims=True), 0.0)
    sketches = jnp.concatenate([leading, jnp.sqrt(left + _CANCELLED * square)], axis=1)

    def one_query(item: tuple[jax.Array, jax.Array, jax.Array, jax.Array]) -> jax.Array:
        q, sketch, slack, tiles = item

        def one_piece(at: jax.Array, last: jax.Array, best: _Best) -> _Best:
            here = at + lanes < last
            similarity = jax.lax.dynamic_slice_in_dim(index.descriptor, at, ROW_STEP) @ q
            similarity = jnp.where(here, similarity, -jnp.inf)
            top = jnp.max(similarity)
            rows = jax.lax.dynamic_slice_in_dim(index.row, at, ROW_STEP)
            lowest = jnp.min(jnp.where(here & (similarity == top), rows, NO_ROW))
            better = (top > best[0]) | ((top == best[0]) & (lowest < best[1]))
            return jnp.where(better, top, best[0]), jnp.where(better, lowest, best[1])

        def one_chunk(number: jax.Array, best: _Best) -> _Best:
            tile = jax.lax.dynamic_slice_in_dim(tiles, number * chunk, chunk)
            first = index.tile_start[tile]
            last = jnp.where(tile < 0, first, index.tile_start[tile + 1])

            def one_step(k: jax.Array, best: _Best) -> _Best:
                at = jnp.minimum(first + k * ROW_STEP, end)
                pieces = jax.vmap(partial(jax.lax.dynamic_slice_in_dim, index.sketch, slice_size=ROW_STEP))(at)
                bound = jnp.where(at[:, None] + lanes[None] < last[:, None], pieces @ sketch + slack, -jnp.inf)

                def promising(state: tuple[jax.Array, _Best]) -> jax.Array:
                    return jnp.max(state[0]) >= jnp.maximum(state[1][0], jnp.finfo(jnp.float32).min)

                def read(state: tuple[jax.Array, _Best]) -> tuple[jax.Array, _Best]:
                    piece = jnp.argmax(state[0])
                    return state[0].at[piece].set(-jnp.inf), one_piece(at[piece], last[piece], state[1])

                return jax.lax.while_loop(promising, read, (jnp.max(bound, axis=1), best))[1]

            steps = jnp.max((last - first + ROW_STEP - 1) // ROW_STEP)
            return jax.lax.fori_loop(0, steps, one_step, best)

        return jax.lax.fori_loop(0, chunks, one_chunk, (jnp.float32(-jnp.inf), jnp.int32(NO_ROW)))[1]

    return jax.lax.map(one_query, (query, sketches, _ROUNDING * jnp.sqrt(square[:, 0]), kept_tiles))


def _rank_tiles(query: jax.Array, n: jax.Array, index: Index, kept_scenes: jax.Array, tiles: int) -> jax.Array:
    """[block, tiles] most similar tiles of the kept scenes, -1 where there are no more."""
    (block, scenes), n_scenes, n_tiles = (
        kept_scenes.shape,
        index.scene_prototype.shape[0],
        index.tile_prototype.shape[0],
    )
    slots = index.tile_slots.shape[0]
    occupied = index.tile_size > 0
    if _DENSE * scenes * slots >= n_tiles:
        similarity = query @ index.tile_prototype.T
        tile = jnp.broadcast_to(jnp.arange(n_tiles, dtype=jnp.int32)[None], similarity.shape)
        real = jnp.broadcast_to(occupied[None], similarity.shape)
        if scenes < n_scenes:
            scene_kept = jnp.zeros((block, n_scenes), bool).at[jnp.arange(block)[:, None], kept_scenes].set(True)
            real &= scene_kept[:, index.tile_scene]  # a padded tile asks for the last scene, and is not occupied
    else:
        similarity = _read_tiles(query, n, index, kept_scenes)
        first, last = index.scene_start[kept_scenes], index.scene_start[kept_scenes + 1]
        tile = (first[..., None] + jnp.arange(slots, dtype=jnp.int32)[None, None]).reshape(block, -1)
        real = (tile < jnp.repeat(last, slots, axis=1)) & occupied[jnp.minimum(tile, n_tiles - 1)]
    keep = min(tiles, similarity.shape[1])
    value, place = jax.lax.top_k(jnp.where(real, similarity, -jnp.inf), keep)
    best = jnp.where(value > -jnp.inf, jnp.take_along_axis(tile, place, axis=1), -1)
    return jnp.pad(best, ((0, 0), (0, tiles - keep)), constant_values=-1)


def _read_tiles(query: jax.Array, n: jax.Array, index: Index, kept_scenes: jax.Array) -> jax.Array:
    """[block, scenes * slots] similarities with the tile prototypes of the kept scenes, read some at a time."""
    slots, step = index.tile_slots.shape[0], TILE_STEP
    scenes = kept_scenes.shape[1]

    def one_query(item: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
        q, kept, asked = item

        def one_scene(slot: jax.Array, out: jax.Array) -> jax.Array:
            first = index.scene_start[kept[slot]]
            last = jnp.where(asked, index.scene_start[kept[slot] + 1], first)

            def one_step(k: jax.Array, out: jax.Array) -> jax.Array:
                rows = jax.lax.dynamic_slice_in_dim(index.tile_prototype, first + k * step, step)
                return jax.lax.dynamic_update_slice(out, rows @ q, (slot * slots + k * step,))

            return jax.lax.fori_loop(0, (last - first + step - 1) // step, one_step, out)

        return jax.lax.fori_loop(0, scenes, one_scene, jnp.zeros(scenes * slots, jnp.float32))

    return jax.lax.map(one_query, (query, kept_scenes, jnp.arange(query.shape[0]) < n))

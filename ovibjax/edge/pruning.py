"""What pruning a search costs, over scenes and tiles kept (paper, Section "Coarse-to-Fine Retrieval").

The search of `edge.retrieval` is built for speed, with static numbers of scenes and tiles. A study wants every
combination of them, on databases small enough to compare each query with every row once: a grid point is then a mask.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.edge.index import Index
from ovibjax.edge.localize import errors


class Asked(NamedTuple):
    """Queries with their ground truth.

    Attributes:
        query: [Q, d] descriptors.
        truth_m: [Q, D] where they were taken.
        scene: [Q] int32 scene number of each.
    """

    query: jax.Array
    truth_m: jax.Array
    scene: jax.Array


class Pruning(NamedTuple):
    """Means over the queries at each grid point, [A, B].

    The right tile of a query is that of the nearest reference of its scene.

    Attributes:
        pruned: share of the descriptors that the fine search skips.
        scene_hit: share of queries whose scene is kept.
        tile_hit: share of queries whose right tile is kept.
        nearest_hit: share of queries for which the tile of the exhaustive answer is kept.
        error_m: error of coarse-to-fine retrieval over all queries; across scenes, in their overlapping coordinates.
        brute_m: the same of exhaustive retrieval (equal at all points).
        error_hit_m: error over the queries whose right tile is kept; NaN where there are none.
        brute_hit_m: the same of exhaustive retrieval.
        astray_excess_m: part of `error_m - brute_m` due to queries answered with another scene.
        wrong_scene: share of queries answered with another scene.
        same: share of queries with the exhaustive answer.
        floor_m: distance to the nearest reference of the query's scene (equal at all points).
    """

    pruned: jax.Array
    scene_hit: jax.Array
    tile_hit: jax.Array
    nearest_hit: jax.Array
    error_m: jax.Array
    brute_m: jax.Array
    error_hit_m: jax.Array
    brute_hit_m: jax.Array
    astray_excess_m: jax.Array
    wrong_scene: jax.Array
    same: jax.Array
    floor_m: jax.Array


def judge_pruning(asked: Asked, index: Index, position_m: jax.Array, scenes: jax.Array, tiles: jax.Array) -> Pruning:
    """Judge every combination of scenes kept and tiles kept on one database.

    Args:
        asked: queries; `asked.scene` numbers scenes as the index does.
        index: the database.
        position_m: [N, D] positions of its rows.
        scenes: [A] int32 scene prototypes kept.
        tiles: [B] int32 tile prototypes kept, over all kept scenes.

    Returns:
        Means over the queries, [A, B] each.
    """
    reference = index.descriptor[index.place]
    row_scene = index.tile_scene[index.row_tile]
    similarity = asked.query @ reference.T
    brute = jnp.argmax(similarity, axis=1)
    apart = jnp.sqrt(jnp.sum((asked.truth_m[:, None] - position_m[None]) ** 2, axis=-1))
    apart = jnp.where(asked.scene[:, None] == row_scene[None], apart, jnp.inf)
    right = index.row_tile[jnp.argmin(apart, axis=1)]
    brute_m = errors(position_m[brute], asked.truth_m)
    scene_place = _places(asked.query @ index.scene_prototype.T)
    tile_similarity = jnp.where((index.tile_size > 0)[None], asked.query @ index.tile_prototype.T, -jnp.inf)

    def one_row(n_scenes: jax.Array) -> Pruning:
        kept_scene = scene_place < n_scenes
        # A padded tile asks for the last scene, and is empty.
        open_tile = kept_scene[:, index.tile_scene] & (index.tile_size > 0)[None]
        place = _places(jnp.where(open_tile, tile_similarity, -jnp.inf))

        def one_point(n_tiles: jax.Array) -> Pruning:
            kept = open_tile & (place < n_tiles)
            row = jnp.argmax(jnp.where(kept[:, index.row_tile], similarity, -jnp.inf), axis=1)
            error_m = errors(position_m[row], asked.truth_m)
            astray = row_scene[row] != asked.scene
            hit = jnp.take_along_axis(kept, right[:, None], axis=1)[:, 0]
            n_hit = jnp.sum(hit.astype(jnp.float32))

            def over_hits(value: jax.Array) -> jax.Array:
                return jnp.sum(jnp.where(hit, value, 0.0)) / n_hit

            return Pruning(
                pruned=1.0 - jnp.mean(jnp.sum(jnp.where(kept, index.tile_size[None], 0), axis=1)) / reference.shape[0],
                scene_hit=jnp.mean(jnp.take_along_axis(kept_scene, asked.scene[:, None], axis=1)),
                tile_hit=jnp.mean(hit),
                nearest_hit=jnp.mean(jnp.take_along_axis(kept, index.row_tile[brute][:, None], axis=1)),
                error_m=jnp.mean(error_m),
                brute_m=jnp.mean(brute_m),
                error_hit_m=over_hits(error_m),
                brute_hit_m=over_hits(brute_m),
                astray_excess_m=jnp.mean(jnp.where(astray, error_m - brute_m, 0.0)),
                wrong_scene=jnp.mean(astray),
                same=jnp.mean(row == brute),
                floor_m=jnp.mean(jnp.min(apart, axis=1)),
            )

        return jax.lax.map(one_point, tiles)

    return jax.lax.map(one_row, scenes)


def _places(similarity: jax.Array) -> jax.Array:
    """[Q, C] place of each column in its row's descending order, equal ones by column."""
    return jnp.argsort(jnp.argsort(-similarity, axis=1, stable=True), axis=1)

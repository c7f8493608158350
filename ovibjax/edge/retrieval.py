"""Which reference of the geo-tagged database looks most like a query (paper, "System Architecture").

Similarity is the cosine of descriptors. `brute_force` compares a query with every row; `coarse_to_fine` with scene
prototypes, then with the tile prototypes of the scenes it keeps, and then with the descriptors of the tiles it keeps.
`leave_one_out` answers for a frame of the database as if that frame were not in it, and says how distinct the match is.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.edge.cluster_search import nearest
from ovibjax.edge.clusters import ClusterIndex
from ovibjax.edge.faiss_lists import FaissLists
from ovibjax.edge.index import Index, build_index, normalize
from ovibjax.edge.tile_search import Found, search

__all__ = [
    "SCENES",
    "TILES",
    "Found",
    "Index",
    "Match",
    "brute_force",
    "build_index",
    "coarse_to_fine",
    "leave_one_out",
    "normalize",
    "retrieve",
    "search",
]

SCENES, TILES = 2, 12
"""Scene and tile prototypes kept per query (paper, Section "Coarse-to-Fine Retrieval")."""

# Similarities, and queries of a leave-one-out search, held at a time: both bound memory.
_BLOCK_PAIRS, _OWN_BLOCK = 1 << 27, 512


def retrieve(
    query: jax.Array,
    database: jax.Array | np.ndarray | Index | ClusterIndex | FaissLists,
    scenes: int = SCENES,
    tiles: int = TILES,
) -> jax.Array:
    """Most similar database row of each query: exhaustive in an array, coarse-to-fine in tiles, `nearest` in clusters.

    Args:
        query: [Q, d] descriptors; their scale does not matter.
        database: [N, d] reference descriptors, or what `build_index` or `cluster_index` makes of them.
        scenes: scene prototypes kept per query of an index.
        tiles: tile prototypes kept per query of an index, over all its scenes.

    Returns:
        [Q] int32 rows of the database (paper, Section "Coarse-to-Fine Retrieval"); -1 where clusters are asked for
        what is no number.

    Raises:
        ValueError: `scenes` or `tiles` below one.
    """
    if isinstance(database, Index):
        return coarse_to_fine(query, database, scenes, tiles)
    if isinstance(database, ClusterIndex | FaissLists):
        return jnp.asarray(nearest(query, database).row[:, 0])
    return brute_force(jnp.asarray(query), jnp.asarray(database))


def brute_force(query: jax.Array, db: jax.Array) -> jax.Array:
    """Most similar database row of each query, compared with every row.

    Equal similarities go to the lower index; rows that are duplicates of each other may differ by rounding.

    Args:
        query: [Q, d] descriptors; their scale does not matter.
        db: [N, d] reference descriptors; squared norms must stay in float32's range.

    Returns:
        [Q] int32 rows of `db`. Memory is bounded by blocks of queries.
    """
    reference = normalize(db)
    block = max(1, _BLOCK_PAIRS // reference.shape[0])
    if query.shape[0] <= block:
        return jnp.argmax(query @ reference.T, axis=1).astype(jnp.int32)
    return jax.lax.map(lambda q: jnp.argmax(reference @ q), query, batch_size=block).astype(jnp.int32)


def coarse_to_fine(query: jax.Array, index: Index, scenes: int = SCENES, tiles: int = TILES) -> jax.Array:
    """Most similar database row of each query among the most similar tiles of the most similar scenes.

    Args:
        query: [Q, d] descriptors; their scale does not matter.
        index: the database, from `build_index`.
        scenes: scene prototypes kept per query.
        tiles: tile prototypes kept per query, over all its scenes.

    Returns:
        [Q] int32 rows of the database; equal similarities go to the lower row, scene or tile. With every scene and
        tile kept, what `brute_force` returns (to the rounding of a similarity, where two are equal but for that).

    Raises:
        ValueError: `scenes` or `tiles` below one.
    """
    return search(query, index, scenes, tiles).row


class Match(NamedTuple):
    """What leave-one-out retrieval answers, and how sure it is.

    Attributes:
        row: [Q] int32 most similar row of the database.
        distinctness: [Q] one less the ratio of two distances, to this row and to the most similar reference in another
            place, a distance being one less the cosine similarity: 0 for a look-alike elsewhere, 1 for a match without
            a rival (the ratio test of D. G. Lowe, 2004).
    """

    row: jax.Array
    distinctness: jax.Array


def best_of(similarity: jax.Array, places_m: jax.Array, elsewhere_m: float) -> Match:
    """The match of one query.

    Args:
        similarity: [N] cosine similarities to the references; minus infinity where one does not count.
        places_m: [N, 2] horizontal positions of the references, m.
        elsewhere_m: references further than this from the best one are in another place.

    Returns:
        Scalars.
    """
    row = jnp.argmax(similarity).astype(jnp.int32)
    away_m = jnp.linalg.norm(places_m - places_m[row][None], axis=1)
    rival = jnp.maximum(jnp.max(jnp.where(away_m > elsewhere_m, similarity, -jnp.inf)), -1.0)
    # Both distances vanish where a reference elsewhere is equal to the query as well: not distinct at all.
    near, far = (jnp.maximum(1.0 - value, 0.0) for value in (similarity[row], rival))
    return Match(row, jnp.where(far > 0, 1.0 - near / jnp.where(far > 0, far, 1.0), 0.0))


def leave_one_out(
    query: jax.Array, reference: jax.Array, own: jax.Array, places_m: jax.Array, elsewhere_m: float
) -> Match:
    """Most similar reference of each query by cosine similarity, its own excluded.

    Args:
        query: [Q, d] descriptors.
        reference: [N, d] descriptors of the database, at least two.
        own: [Q] int32 row of the query itself in the database, or -1 where it is not in it.
        places_m: [N, 2] horizontal positions of the references, m.
        elsewhere_m: references further than this from the best one are in another place.

    Returns:
        Rows, equal similarities to the lower one, and how distinct they are; where no reference is in another place
        the rival's similarity counts as the least possible, -1. Memory is bounded by blocks.
    """
    rows = jnp.arange(reference.shape[0], dtype=jnp.int32)
    unit, asked = normalize(reference), normalize(query)

    def one(item: tuple[jax.Array, jax.Array]) -> Match:
        descriptor, self_row = item
        return best_of(jnp.where(rows == self_row, -jnp.inf, unit @ descriptor), places_m, elsewhere_m)

    return jax.lax.map(one, (asked, own), batch_size=_OWN_BLOCK)

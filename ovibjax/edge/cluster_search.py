"""The most similar rows of a database that is sorted into clusters of like descriptors, whatever its places.

Two ways to the same answers: inside of compiled programs, and on accelerators, one product with all prototypes, blocks
of equal size copied piece by piece, and a product with those; on a processor `edge.host_search`, which reads less.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from ovibjax.edge.clusters import ClusterIndex, build_clusters
from ovibjax.edge.faiss_lists import FaissLists, build_lists
from ovibjax.edge.host_search import search_on_host
from ovibjax.edge.index import NO_ROW, normalize
from ovibjax.errors import InputError

PROBES = 16
"""Prototypes kept per query. On our descriptors 98 % of the exhaustive answers take 3 or 4 of them at 5 k, 6 at 100 k
and 10 to 16 at 1 M."""
ENGINES = ("ovibjax", "faiss")
# Numbers of gathered blocks held at a time: on a processor no more than its caches hold, which is ten times as fast.
_HELD, _HELD_BY_CPU = 1 << 26, 1 << 20


class Nearest(NamedTuple):
    """Outcome of a search.

    Attributes:
        row: [Q, k] int32 rows of the database, most similar first; -1 where the kept blocks hold no more.
        similarity: [Q, k] their cosine similarities; minus infinity there.
    """

    row: jax.Array | np.ndarray
    similarity: jax.Array | np.ndarray


def cluster_index(
    db: ArrayLike,
    tile: ArrayLike | None = None,
    key: jax.Array | None = None,
    rows: int | None = None,
    engine: str = "ovibjax",
) -> ClusterIndex | FaissLists:
    """Sort a database into blocks of like descriptors, by k-means, and average each.

    Args:
        db: [N, d] reference descriptors; their scale does not matter.
        tile: [N] label of the tile of each row; a block holds rows of one tile. None: blocks follow likeness alone.
        key: draws where k-means begins; the same key gives the same index.
        rows: descriptors of a block on average; by default a quarter of the square root of N, at least 16.
        engine: "ovibjax", or "faiss": the same blocks as inverted lists of that library (extra `[faiss]`), which
            answers the same and is no pytree.

    Returns:
        The index, for `nearest` and `retrieve`.

    Raises:
        InputError: no rows, a descriptor that is not finite, labels of another length, an engine that is not known or
            not installed.
    """
    if engine not in ENGINES:
        raise InputError(f"index: no engine {engine!r}; there are {' and '.join(ENGINES)}")
    build = build_clusters if engine == "ovibjax" else build_lists
    return build(db, tile, key, rows)


def nearest(query: ArrayLike, index: ClusterIndex | FaissLists, k: int = 1, probes: int = PROBES) -> Nearest:
    """Most similar rows of a database among the blocks whose prototypes are most similar to a query.

    Exact inside of the blocks that are kept, and with all of them kept: exhaustive.

    Args:
        query: [Q, d] descriptors; their scale does not matter.
        index: the database, from `cluster_index`.
        k: rows wanted.
        probes: blocks kept per query; all of them if there are fewer.

    Returns:
        Rows and similarities; equal similarities go to the lower row, and -1 stands for none, as a query that is not a
        number has none. Arrays of NumPy where the search ran outside of a compiled program on a processor, as a copy
        would take longer than the search.

    Raises:
        ValueError: `k` or `probes` below one.
        InputError: queries of another dimension than the database.
    """
    if k < 1 or probes < 1:
        raise ValueError(f"k = {k}, probes = {probes}: ask for at least one of each")
    shape, dim = np.shape(query), index.prototype.shape[1]
    if len(shape) != 2 or shape[1] != dim:
        raise InputError(f"search: queries {list(shape)}; expected [Q, {dim}]")
    probes = min(probes, index.prototype.shape[0])
    if isinstance(index, FaissLists):
        return Nearest(*index.search(np.asarray(query), k, probes))
    if _on_host(query, index):
        return Nearest(*search_on_host(np.asarray(query), index, k, probes))
    return _compiled(jnp.asarray(query, jnp.float32), index, k, probes)


def _on_host(query: ArrayLike, index: ClusterIndex) -> bool:
    """Whether NumPy can see all arrays without copying them off a device."""
    if isinstance(query, jax.core.Tracer) or any(isinstance(leaf, jax.core.Tracer) for leaf in index):
        return False
    table = index.descriptor
    return not isinstance(table, jax.Array) or all(device.platform == "cpu" for device in table.devices())


@partial(jax.jit, static_argnames=("k", "probes"))
def _compiled(query: jax.Array, index: ClusterIndex, k: int, probes: int) -> Nearest:
    most = index.sketch.shape[2]
    unit = normalize(query)
    kept = jax.lax.top_k(unit @ index.prototype.T, probes)[1]
    lane = jnp.arange(most, dtype=jnp.int32)

    def one(item: tuple[jax.Array, jax.Array]) -> Nearest:
        descriptor, block = item
        first = index.start[block]
        real = first[:, None] + lane[None] < index.start[block + 1][:, None]
        rows = jax.vmap(partial(jax.lax.dynamic_slice_in_dim, index.row, slice_size=most))(first)
        blocks = jax.vmap(partial(jax.lax.dynamic_slice_in_dim, index.descriptor, slice_size=most))(first)
        similarity = jnp.where(real, blocks @ descriptor, -jnp.inf)

        def best(left: jax.Array, _: None) -> tuple[jax.Array, Nearest]:
            top = jnp.max(left)
            row = jnp.min(jnp.where((left == top) & real, rows, NO_ROW))
            # Where nothing is left every place is at minus infinity, and no row is found a second time.
            found = Nearest(jnp.where(top > -jnp.inf, row, -1), top)
            return jnp.where(rows == row, -jnp.inf, left), found

        return jax.lax.scan(best, similarity, None, length=k)[1]

    held = _HELD_BY_CPU if jax.default_backend() == "cpu" else _HELD
    at_once = max(1, held // (probes * most * query.shape[1]))
    return jax.lax.map(one, (unit, kept), batch_size=at_once)

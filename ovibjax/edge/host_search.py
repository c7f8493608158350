"""Search among clusters on a processor, in NumPy: sketches first, descriptors where these leave something open.

With U the basis and c the mean of a block, a query q and a descriptor r = c + e have the similarity

    q'r = (U'q)'(U'r) + q_'c_ + c_'e_ + (q - c)_'e_ ,

where _ is what U leaves out. Of the four terms the first three are known from products with s numbers, and the last is
at most the product of two norms (Cauchy and Schwarz). Close to its block a query's bound is therefore tight, whatever
the basis leaves out of both. Rows whose bound does not reach what is already found are never read.

How many rows that are depends on the data, which a compiled program cannot make use of: it would read all blocks.
"""

import numpy as np
from numpy.typing import NDArray

from ovibjax.edge.clusters import NO_BOUND, ClusterIndex, unit_rows
from ovibjax.runtime.limits import cores
from ovibjax.runtime.threads import in_order, quick_one_blas_thread

Floats = NDArray[np.float32]
Ints = NDArray[np.integer]

# Bounds held at a time by a thread, and numbers of sketches gathered at a time, which should stay in its cache.
_BOUNDS, _GATHERED = 1 << 21, 1 << 17
# Queries that are multiplied with a block at a time, at most.
_WIDEST = 32
# What float32 may lose of a similarity, and of the square of a norm.
_ROUNDING, _CANCELLED = 1e-5, 4e-6
# Share of the kept places from which on reading whole blocks is quicker than reading rows (among 20 k descriptors
# without any structure, of which all stay open: a quarter of the time).
_DENSE = 0.2
_EXACT_AT_ONCE = 2048
# A bound below this is that of a place without a descriptor.
_EMPTY = np.float32(NO_BOUND / 2)
# Queries below which starting threads takes longer than they save.
_WORTH_A_THREAD = 64


class _Tables:
    """The arrays of an index as NumPy sees them, without copies."""

    def __init__(self, index: ClusterIndex) -> None:
        arrays = [np.asarray(leaf) for leaf in index]
        self.descriptor, self.row, self.start, self.prototype, self.centre, self.basis, self.sketch = arrays
        self.most = self.sketch.shape[2]


def search_on_host(query: NDArray[np.floating], index: ClusterIndex, k: int, probes: int) -> tuple[Ints, Floats]:
    """Most similar rows among the blocks whose prototypes are most similar.

    Args:
        query: [Q, d] descriptors; their scale does not matter.
        index: the database, on a processor.
        k: rows wanted.
        probes: blocks kept per query, at most P.

    Returns:
        [Q, k] int32 rows, the most similar first, of equals the lower one, and -1 where the blocks hold no more; and
        [Q, k] their similarities. Memory is bounded by parts of the queries.
    """
    tables = _Tables(index)
    if not len(query):
        return np.zeros((0, k), np.int32), np.zeros((0, k), np.float32)
    unit = unit_rows(np.asarray(query, np.float32))
    at_once = max(1, _BOUNDS // (probes * tables.most))
    parts = max(-(-len(unit) // at_once), 1)
    if len(unit) >= 2 * _WORTH_A_THREAD:  # how many cores there are takes longer to find out than a query
        parts = max(parts, min(cores(), len(unit) // _WORTH_A_THREAD))
    # On a busy machine one query would wait for BLAS's other threads a hundred times as long as its product takes.
    with quick_one_blas_thread:
        if parts == 1:
            return _search(unit, tables, k, probes)
        pieces = np.array_split(unit, parts)
        found = list(in_order(lambda piece: _search(piece, tables, k, probes), pieces, cores()))
    return np.concatenate([row for row, _ in found]), np.concatenate([similarity for _, similarity in found])


def _search(unit: Floats, tables: _Tables, k: int, probes: int) -> tuple[Ints, Floats]:
    score = unit @ tables.prototype.T
    blocks = score.shape[1]
    if probes < blocks:
        kept = np.argpartition(score, blocks - probes, axis=1)[:, blocks - probes :]
    else:
        kept = np.broadcast_to(np.arange(blocks), score.shape)
    visits = _Visits(kept)
    alive = _open(unit, kept, _bounds(unit, kept, score, visits, tables), tables, k)
    if np.count_nonzero(alive) > _DENSE * alive.size:
        alive = _open(unit, kept, _whole_blocks(unit, kept, visits, tables), tables, k)
    return _settle(unit, kept, alive, tables, k)


class _Visits:
    """The pairs of a query and a block that it keeps, sorted by block.

    Attributes:
        order: [Q * probes] the pairs, block after block.
        block: [V] the blocks that are visited, ascending.
        first: [V] where the pairs of each begin in `order`.
        count: [V] how many pairs each has.
    """

    def __init__(self, kept: Ints) -> None:
        pairs = kept.ravel()
        self.order = np.argsort(pairs, kind="stable")
        sorted_pairs = pairs[self.order]
        self.first = np.flatnonzero(np.diff(sorted_pairs, prepend=-1))
        self.block = sorted_pairs[self.first]
        self.count = np.diff(self.first, append=len(pairs))


def _bounds(unit: Floats, kept: Ints, score: Floats, visits: _Visits, tables: _Tables) -> Floats:
    """[Q, probes * B] what the similarity to each descriptor of the kept blocks is at most."""
    queries, probes = kept.shape
    size = tables.basis.shape[1]
    leading = unit @ tables.basis
    centre = tables.centre[kept]
    # q_'c_ and the norm of (q - c)_
    product = np.take_along_axis(score, kept, axis=1) * centre[..., size + 1]
    product -= np.einsum("qs,qps->qp", leading, centre[..., :size])
    rest = np.einsum("qd,qd->q", unit, unit) - np.einsum("qs,qs->q", leading, leading)
    apart = np.sqrt(np.maximum(rest[:, None] - 2 * product + centre[..., size], 0) + _CANCELLED)
    side = np.empty((queries, probes, size + 2), np.float32)
    side[..., :size], side[..., size], side[..., size + 1] = leading[:, None], 1, apart
    if queries == 1:
        bound = np.matmul(side[0, :, None], tables.sketch[kept[0]])
    else:
        bound = _by_block(side.reshape(-1, size + 2), visits, tables.sketch)
    bound = bound.reshape(queries, probes, -1)
    bound += (product + _ROUNDING)[..., None]
    return bound.reshape(queries, -1)


def _by_block(side: Floats, visits: _Visits, sketch: Floats) -> Floats:
    """[pairs, B] products of pairs' sides with the sketches of their blocks, each block read once for many queries."""
    pairs, (_, size, most) = len(side), sketch.shape
    # Pieces of equal width, so that they are one stack of products.
    width = min(_WIDEST, 1 << (-(-pairs // len(visits.block)) - 1).bit_length())
    pieces = -(-visits.count // width)
    within = np.arange(pairs) - np.repeat(visits.first, visits.count)
    piece = np.repeat(np.cumsum(pieces) - pieces, visits.count) + within // width
    slot = piece * width + within % width
    block = np.repeat(visits.block, pieces)
    stacked = np.zeros((len(block), width, size), np.float32)
    stacked.reshape(-1, size)[slot] = side[visits.order]
    product = np.empty((len(block), width, most), np.float32)
    step = max(1, _GATHERED // (size * most))
    for at in range(0, len(block), step):
        part = slice(at, at + step)
        np.matmul(stacked[part], sketch[block[part]], out=product[part])
    where = np.empty(pairs, np.int64)
    where[visits.order] = slot
    return product.reshape(-1, most)[where]


def _whole_blocks(unit: Floats, kept: Ints, visits: _Visits, tables: _Tables) -> Floats:
    """The bounds where sketches leave too much open: similarities, but for their rounding."""
    probes = kept.shape[1]
    bound = np.full((kept.size, tables.most), NO_BOUND, np.float32)
    for block, first, count in zip(visits.block, visits.first, visits.count, strict=True):
        pair = visits.order[first : first + count]
        rows = tables.descriptor[tables.start[block] : tables.start[block + 1]]
        bound[pair, : len(rows)] = unit[pair // probes] @ rows.T
    bound += _ROUNDING
    return bound.reshape(len(unit), -1)


def _open(unit: Floats, kept: Ints, bound: Floats, tables: _Tables, k: int) -> NDArray[np.bool_]:
    """[Q, probes * B] where a descriptor may be among the k most similar, by the k whose bounds are highest."""
    k = min(k, bound.shape[1])
    if k == 1:
        slot = np.argmax(bound, axis=1)[:, None]
    else:
        slot = np.argpartition(bound, bound.shape[1] - k, axis=1)[:, bound.shape[1] - k :]
    place = _places(np.arange(len(unit))[:, None], slot, kept, tables)
    least = np.min(np.einsum("qkd,qd->qk", tables.descriptor[place], unit), axis=1)
    # Fewer than k descriptors are kept where one of the highest bounds is that of a place without any.
    least[np.take_along_axis(bound, slot, axis=1).min(axis=1) <= _EMPTY] = _EMPTY
    return bound >= np.maximum(least, _EMPTY)[:, None]


def _settle(unit: Floats, kept: Ints, alive: NDArray[np.bool_], tables: _Tables, k: int) -> tuple[Ints, Floats]:
    """The k most similar rows of those that are open, and their similarities."""
    query, slot = np.nonzero(alive)
    place = _places(query, slot, kept, tables)
    similarity = np.empty(len(place), np.float32)
    for at in range(0, len(place), _EXACT_AT_ONCE):
        part = slice(at, at + _EXACT_AT_ONCE)
        np.einsum("nd,nd->n", tables.descriptor[place[part]], unit[query[part]], out=similarity[part])
    row = tables.row[place]
    best = np.lexsort((row, -similarity, query))
    count = np.bincount(query, minlength=len(unit))
    rank = np.arange(len(best)) - np.repeat(np.cumsum(count) - count, count)
    best, rank = best[rank < k], rank[rank < k]
    rows = np.full((len(unit), k), -1, np.int32)
    values = np.full((len(unit), k), -np.inf, np.float32)
    rows[query[best], rank], values[query[best], rank] = row[best], similarity[best]
    return rows, values


def _places(query: Ints, slot: Ints, kept: Ints, tables: _Tables) -> Ints:
    """Where the descriptors stand in the database's table that are at these places of queries' kept blocks."""
    return tables.start[kept[query, slot // tables.most]] + slot % tables.most

"""The same clusters as inverted lists of FAISS (extra `[faiss]`): its search, its files, its memory maps."""

import warnings
from importlib import import_module
from typing import Any

import jax
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ovibjax.edge.clusters import sort_into_blocks, unit_rows
from ovibjax.errors import InputError


class FaissLists:
    """A database in FAISS, a list per block of `cluster_index`.

    Attributes:
        lists: the `faiss.IndexIVFFlat`, for whatever else FAISS does with one.
        prototype: [P, d] normalised means of the blocks, by which a query ranks the lists.
    """

    def __init__(self, lists: Any, prototype: NDArray[np.float32]) -> None:
        self.lists = lists
        self.prototype = prototype

    def search(self, query: NDArray[np.floating], k: int, probes: int) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """Most similar rows among the lists whose prototypes are most similar.

        Args:
            query: [Q, d] descriptors; their scale does not matter.
            k: rows wanted.
            probes: lists kept per query.

        Returns:
            [Q, k] rows, -1 where the lists hold no more, and their similarities.
        """
        if not len(query):
            return np.zeros((0, k), np.int32), np.zeros((0, k), np.float32)
        unit = np.ascontiguousarray(unit_rows(np.asarray(query, np.float32)))
        similarity, row = self.lists.search(unit, k, params=_faiss().SearchParametersIVF(nprobe=probes))
        similarity = np.where(row < 0, -np.inf, similarity).astype(np.float32)
        order = np.lexsort((row, -similarity))  # equal similarities to the lower row
        return np.take_along_axis(row, order, axis=1).astype(np.int32), np.take_along_axis(similarity, order, axis=1)


def build_lists(db: ArrayLike, tile: ArrayLike | None, key: jax.Array | None, rows: int | None) -> FaissLists:
    """Sort a database into blocks and hand them to FAISS; arguments are those of `cluster_index`.

    Args:
        db: as there.
        tile: as there.
        key: as there.
        rows: as there.

    Returns:
        The lists.

    Raises:
        InputError: as there, or FAISS is not installed.
    """
    faiss = _faiss()
    made = sort_into_blocks(db, tile, key, rows)
    (n, d), blocks = made.descriptor.shape, len(made.mean)
    coarse = faiss.IndexFlatIP(d)
    prototype = unit_rows(made.mean)
    coarse.add(prototype)
    lists = faiss.IndexIVFFlat(coarse, d, blocks, faiss.METRIC_INNER_PRODUCT)
    lists.train(prototype)  # nothing is left to train; it takes note of that
    block = np.empty(n, np.int64)
    block[made.order] = np.repeat(np.arange(blocks), np.diff(made.start))
    unit, pointer = np.ascontiguousarray(made.descriptor), faiss.swig_ptr
    lists.add_core(n, pointer(unit), None, pointer(block))
    return FaissLists(lists, prototype)


def _faiss() -> Any:
    """The library, or a line that says how to get it."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of its bindings, at import
            return import_module("faiss")
    except ImportError as error:
        raise InputError('engine "faiss" needs the extra [faiss]: pip install "ovibjax[faiss]"') from error

"""Batches of one size, so that one program serves all: the first compiles it, the rest run on all cores."""

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ovibjax.runtime.threads import in_threads

Item = TypeVar("Item")
Result = TypeVar("Result")
Scalar = TypeVar("Scalar", bound=np.generic)


def padded_batches(rows: NDArray[Scalar], size: int) -> Iterator[tuple[int, NDArray[Scalar]]]:
    """Cut an array into batches of one size; the last repeats its last row.

    Args:
        rows: [B, ...].
        size: rows per batch.

    Yields:
        Number of rows that count, and the batch [size, ...].
    """
    for start in range(0, len(rows), size):
        batch = rows[start : start + size]
        yield len(batch), np.concatenate([batch, np.repeat(batch[-1:], size - len(batch), axis=0)])


def first_then_threads(function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Result]:
    """Results of a function that compiles at its first call, in the order in which they are finished.

    Args:
        function: called once per item.
        items: the first runs alone, as it compiles for all; the rest run one per core, which fills the gaps between
            XLA's own parallel parts.

    Yields:
        Results.
    """
    yield from map(function, items[:1])
    yield from in_threads(function, items[1:])

"""One sweep as work that can be done chunk by chunk, here or in another process."""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from functools import cached_property, lru_cache, partial
from typing import Any

import jax
import numpy as np

from ovibjax.sweep.grid import PADDING
from ovibjax.sweep.program import MemberFn, Program, Shape
from ovibjax.sweep.schema import Schema


@dataclass(frozen=True)
class Along:
    """Data that differ along one axis: the member function receives the entry of its own value.

    Attributes:
        axis: name of the axis.
        values: one pytree of arrays per value, all of equal shapes.
    """

    axis: str
    values: Sequence[Any]


@dataclass(frozen=True)
class Block:
    """What one chunk gives.

    Attributes:
        arrays: outputs [rows, columns, ...].
        diverged: [rows, columns] bool; True where a member has any output that is not finite.
    """

    arrays: dict[str, np.ndarray]
    diverged: np.ndarray


@dataclass(frozen=True)
class Work:
    """Everything that computing a chunk needs; can be sent to another process.

    Attributes:
        fn: the member function.
        schema: the grid and its chunks.
        shape: size of a chunk.
        shared: data, or `Along`.
    """

    fn: MemberFn
    schema: Schema
    shape: Shape
    shared: Any

    def __getstate__(self) -> dict[str, Any]:
        # Without what is cached: a program stays in its process.
        return {field.name: self.__dict__[field.name] for field in fields(self)}

    def arguments(self, chunk: int) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], Any]:
        """Outer points [rows], inner points [columns] and data of a chunk; padding repeats the first member."""
        grid, chunks = self.schema.grid, self.schema.chunks
        members = chunks.members[chunk]
        rows, columns = members.max(axis=1), members.max(axis=0)
        rows, columns = np.where(rows == PADDING, rows[0], rows), np.where(columns == PADDING, columns[0], columns)
        outer = () if chunks.outer is None else grid.groups[chunks.outer]
        inner = [name for name in grid.axes if name not in outer]
        points = grid.points(rows, outer), grid.points(columns, inner)
        if not isinstance(self.shared, Along):
            return *points, self.shared
        assert chunks.outer is not None
        return *points, self._stack(tuple(np.unravel_index(rows, grid.shape)[chunks.outer].tolist()))

    @cached_property
    def _stack(self) -> Callable[[tuple[int, ...]], Any]:
        # A few blocks at a time: chunks of one outer value follow each other.
        return lru_cache(maxsize=4)(
            lambda index: jax.tree.map(lambda *leaves: np.stack(leaves), *(self.shared.values[i] for i in index))
        )

    @cached_property
    def program(self) -> Program:
        """The program of every chunk, lowered."""
        return Program(self.fn, self.shape, isinstance(self.shared, Along), self.arguments(0))

    def compute(self, chunk: int) -> Block:
        """One chunk, on the host."""
        arrays = self.program(*self.arguments(chunk))
        diverged = np.zeros(self.schema.chunks.members.shape[1:], bool)
        for values in arrays.values():
            if values.dtype.kind == "f":
                diverged |= ~np.isfinite(values).all(axis=tuple(range(2, values.ndim)))
        return Block(arrays, diverged)


def configuration(work: Work, settings: dict[str, Any]) -> dict[str, Any]:
    """What identifies a sweep: everything that its bits depend on, as JSON."""
    grid = work.schema.grid
    fn = work.fn.func if isinstance(work.fn, partial) else work.fn
    named = fn if hasattr(fn, "__qualname__") else type(fn)
    return {
        "axes": {
            axis: {"values": np.asarray(a.values).tolist(), **({"unit": a.unit} if a.unit else {})}
            for axis, a in grid.axes.items()
        },
        "zipped": [list(group) for group in grid.groups if len(group) > 1],
        "settings": json.loads(json.dumps(settings)),
        "function": f"{named.__module__}.{named.__qualname__}",
        "program": work.program.text_hash,
        "data": _data_hash(work.shared.values if isinstance(work.shared, Along) else work.shared),
        "execution": asdict(work.shape),
        "environment": {"jax": jax.__version__, "platform": jax.default_backend()},
    }


def _data_hash(shared: Any) -> str:
    digest = hashlib.sha256()
    for path, leaf in jax.tree_util.tree_leaves_with_path(shared):
        array = np.ascontiguousarray(np.asarray(leaf))
        digest.update(f"{jax.tree_util.keystr(path)} {array.dtype} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()

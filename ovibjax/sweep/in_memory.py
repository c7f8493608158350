"""Finished chunks of a sweep in memory, with the interface of a store: for sweeps that nobody wants to keep."""

from typing import Any, Self

import numpy as np
import xarray

from ovibjax.sweep.schema import Schema, Variable, assemble
from ovibjax.sweep.work import Block


class InMemory:
    """What `Store` is, without a disk.

    Attributes:
        path: None, as there is no directory.
        schema: what it holds.
        config: what the sweep was started with.
    """

    path = None

    def __init__(self, schema: Schema, config: dict[str, Any]) -> None:
        self.schema, self.config = schema, config
        self._blocks: dict[int, Block] = {}

    def finished(self) -> np.ndarray:
        """[chunks] bool, which are complete."""
        done = np.zeros(len(self.schema.chunks.members), bool)
        done[list(self._blocks)] = True
        return done

    def write(self, chunk: int, arrays: dict[str, np.ndarray], diverged: np.ndarray) -> None:
        """Keep one chunk; see `Store.write`."""
        self._blocks[chunk] = Block(arrays, diverged)

    def dataset(self) -> xarray.Dataset:
        """All finished members; see `schema.assemble`."""
        order = sorted(self._blocks)
        return assemble(self.schema, order, lambda name: self._read(name, order), self.config)

    def _read(self, name: str, chunks: list[int]) -> np.ndarray:
        """[chunks, rows * columns, ...] of a variable, or of `diverged`."""
        blocks = [self._blocks[i] for i in chunks]
        parts = [block.diverged if name == "diverged" else block.arrays[name] for block in blocks]
        variable = self.schema.variables.get(name, Variable((), np.dtype(bool), ()))
        size = self.schema.chunks.members[0].size
        if not parts:
            return np.empty((0, size, *variable.shape), variable.dtype)
        return np.stack(parts).reshape(len(parts), size, *variable.shape)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

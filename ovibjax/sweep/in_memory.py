"""Finished members of a sweep in memory, with the interface of a store: for sweeps that nobody wants to keep."""

from collections.abc import Sequence
from typing import Any, Self

import numpy as np
import xarray

from ovibjax.sweep.dataset import assemble
from ovibjax.sweep.differences import digest
from ovibjax.sweep.grid import Grid
from ovibjax.sweep.layout import Layout
from ovibjax.sweep.members import grid_keys, row_keys, together


class InMemory:
    """What `Store` is, without a disk.

    Attributes:
        path: None, as there is no folder.
        layout: what members have.
        config: what their bits depend on.
    """

    path = None

    def __init__(self, layout: Layout, config: dict[str, Any]) -> None:
        self.layout, self.config = layout, config
        self._tables: list[np.ndarray] = []

    @property
    def rows(self) -> np.ndarray | None:
        """The members that were added; None if there is none."""
        self._tables = [] if (rows := together(self._tables, list(self.layout.units))) is None else [rows]
        return rows

    def lock(self) -> None:
        """Nobody else can add members."""

    def read(self) -> None:
        """Nobody else adds members."""

    def announce(self, grid: Grid) -> None:
        """Nobody else reads."""

    def missing(self, grid: Grid, data: Sequence[bytes]) -> np.ndarray:
        """[n] members of a grid that are to be computed."""
        held = set() if self.rows is None else set(row_keys(self.rows, list(grid.axes)))
        return np.array([member for member, key in enumerate(grid_keys(grid)) if key not in held], int)

    def add(self, rows: np.ndarray) -> None:
        """Keep members."""
        self._tables.append(rows)

    def dataset(self, grid: Grid) -> xarray.Dataset:
        """The members of a grid; see `dataset.assemble`."""
        return assemble(self.layout, grid, self.rows, {"config": self.config, "hash": digest(self.config)})

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

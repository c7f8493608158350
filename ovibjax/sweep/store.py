"""Members of a sweep on disk: a folder that grows, that any number of processes may fill, and that survives a kill.

A store is the union of the members computed so far. `sweep.json` says what all of them have in common (what their bits
depend on, axes, outputs); `members/` holds tables of them, see `blocks`. Another command on the same store reads what
it needs and adds what is missing. Nothing is ever changed, so that shards of one sweep, on machines that share a file
system, need no lock of each other; a whole sweep takes one, so that two do not do the same work.
"""

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any, Self

import numpy as np
import xarray

from ovibjax.errors import InputError, doubt
from ovibjax.runtime.locks import WITHOUT_LOCKS
from ovibjax.runtime.progress import console
from ovibjax.sweep.asked import announce, asked_grids, expected
from ovibjax.sweep.blocks import count_members, read_blocks, remove_abandoned
from ovibjax.sweep.dataset import assemble, union
from ovibjax.sweep.differences import digest
from ovibjax.sweep.disk import lock_of, writing
from ovibjax.sweep.grid import Grid
from ovibjax.sweep.head import OtherSweep, create, read_head, refuse_other
from ovibjax.sweep.layout import Layout, columns_of
from ovibjax.sweep.members import digests_of, grid_keys, name_clash, names_of, row_keys, together, unequal
from ovibjax.sweep.writer import Writer

_ADVICE = "choose another --out, keep both (--keep-both), or repeat the first command"


class Store:
    """An open store; several threads may add members.

    Attributes:
        path: the folder.
        layout: what members have.
        config: what their bits depend on.
    """

    def __init__(self, path: Path, layout: Layout, config: dict[str, Any]) -> None:
        self.path, self.layout, self.config = path, layout, config
        self._lock: IO[str] | None = None
        self._writer = Writer(path)
        self._table: np.ndarray | None = None
        self._new: list[np.ndarray] = []

    @classmethod
    def open(cls, path: str | Path, layout: Layout, config: dict[str, Any]) -> "Store":
        """Create a store, or go on with it if it is there and holds members of the same sweep.

        Args:
            path: the folder; parents are made.
            layout: what members have.
            config: what their bits depend on, made of JSON's types.

        Returns:
            The open store, its members read.

        Raises:
            InputError: the path holds something else or another sweep (`OtherSweep`), or it cannot be written.
        """
        path = Path(path)
        config = json.loads(json.dumps(config))
        real = Path(os.path.realpath(path))  # a link may lead to where a store is to be
        if not real.exists():
            with writing(path, lambda: 0):
                real.parent.mkdir(parents=True, exist_ok=True)
                create(real, layout, config)
        store = attach(path)
        refuse_other(path, (store.layout, store.config), (layout, config), _ADVICE)
        store.read()
        return store

    def lock(self) -> None:
        """Keep other whole sweeps out until this store is closed, and read what they have added before.

        Raises:
            InputError: another process works on it, or the disk refuses.
        """
        folder = self.path / "members"
        with writing(self.path, lambda: count_members(folder)):
            self._lock = lock_of(self.path, self.path / "lock")
            remove_abandoned(folder)
        if self._lock is None:
            console.print(
                f"{self.path / 'lock'}: {WITHOUT_LOCKS} (nothing would be lost, but all computed twice)",
                highlight=False,
            )
        self.read()

    def read(self) -> None:
        """Read every member that is there now.

        Raises:
            InputError: a file is damaged.
        """
        self._writer.flush()
        self._table, self._new = None, []
        self._table = together(read_blocks(self.path / "members", columns_of(self.layout)), list(self.layout.units))

    @property
    def rows(self) -> np.ndarray | None:
        """The members that were read or added; None if there is none."""
        if self._new:
            tables = [*([] if self._table is None else [self._table]), *self._new]
            self._table, self._new = together(tables, list(self.layout.units)), []
        return self._table

    def missing(self, grid: Grid, data: Sequence[bytes]) -> np.ndarray:
        """Members of a grid that the store lacks.

        Args:
            grid: what is asked for.
            data: digest of the data of every member of it.

        Returns:
            [n] flat indices, ascending.

        Raises:
            OtherSweep: the store has one of them with other data, or an axis whose names have other numbers there.
        """
        rows = self.rows
        if rows is None:
            return np.arange(grid.size)
        for name in self.layout.named:
            here = dict(zip(grid.codes(name).tolist(), np.asarray(grid.axes[name].values).tolist(), strict=True))
            clash = name_clash(names_of(rows, name), here)
            if clash is not None:
                advice = "give names in the order of the first command, new ones last"
                raise OtherSweep(f"{self.path}: of {name}, {clash}; {advice}", self.path, self.config)
        held = dict(zip(row_keys(rows, list(grid.axes)), digests_of(rows), strict=True))
        keys = grid_keys(grid)
        for member, (key, seen) in enumerate(zip(keys, data, strict=True)):
            if held.get(key, seen) != seen:
                index = np.unravel_index(member, grid.shape)
                values = {name: a.values[int(index[grid.group_of(name)])] for name, a in grid.axes.items()}
                point = ", ".join(f"{name} {value}" for name, value in values.items())
                message = f"{self.path} holds another sweep: {point} saw other data there than here; {_ADVICE}"
                raise OtherSweep(message, self.path, self.config)
        return np.array([member for member, key in enumerate(keys) if key not in held], int)

    def join(self, rows: np.ndarray, source: Path) -> int:
        """Add members of another store of the same sweep, those that are not here.

        Args:
            rows: the members.
            source: where they are from.

        Returns:
            How many were added; they are on disk.

        Raises:
            InputError: one of them saw other data than that of the same point here, or has a name of another number;
                or the disk refuses.
        """
        axes, mine = list(self.layout.units), self.rows
        held = {} if mine is None else dict(zip(row_keys(mine, axes), digests_of(mine), strict=True))
        keys = row_keys(rows, axes)
        for key, seen, row in zip(keys, digests_of(rows), rows, strict=True):
            if held.get(key, seen) != seen:
                point = ", ".join(f"{name} {row[f'value.{name}']}" for name in axes)
                raise InputError(f"{source}: {point} saw other data there than in {self.path}; they cannot be merged")
        for name in self.layout.named:
            known = {} if mine is None else names_of(mine, name)
            clash = name_clash(known, {**known, **names_of(rows, name)})
            if clash is not None:
                raise InputError(f"{source}: of {name}, {clash}; they cannot be merged")
        other = 0 if mine is None else unequal(mine, rows, axes)
        if other:
            doubt(source, f"{other} members are in {self.path} with other bits (another processor?); those stay")
        new = [n for n, key in enumerate(keys) if key not in held]
        if new:
            self.add(rows[new])
            self._writer.flush()
        return len(new)

    def add(self, rows: np.ndarray) -> None:
        """Keep members; they are on disk a second later at most, and when the store is closed.

        Raises:
            InputError: the disk refuses; what was written before is kept.
        """
        self._new.append(rows)
        self._writer.add(rows)

    def dataset(self, grid: Grid | None = None) -> xarray.Dataset:
        """Members as a dataset.

        Args:
            grid: the grid to show; if None, the smallest that holds all members and what was asked for.

        Returns:
            See `dataset.assemble`; without a grid its attribute `asked` counts the members there or to come.
        """
        rows = self.rows
        attributes: dict[str, Any] = {"config": self.config, "hash": digest(self.config)}
        if grid is None:
            grid, members = union(self.layout, rows, list(asked_grids(self.path, self.layout)))
            attributes["asked"] = max(members, expected(self.path))
        return assemble(self.layout, grid, rows, attributes)

    def announce(self, grid: Grid) -> None:
        """Let readers know which members are to come.

        Raises:
            InputError: the disk refuses.
        """
        with writing(self.path, lambda: count_members(self.path / "members")):
            announce(self.path, grid)

    def close(self) -> None:
        """Write what waits, and let other processes in."""
        try:
            self._writer.flush()
        finally:
            if self._lock is not None:
                self._lock.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def attach(path: str | Path) -> Store:
    """Open a store that is there, whoever else works on it.

    Args:
        path: the folder.

    Returns:
        The open store, without its members.

    Raises:
        InputError: there is no store, or a damaged one.
    """
    return Store(Path(path), *read_head(Path(path)))


def open_dataset(path: str | Path) -> xarray.Dataset:
    """Read all finished members; the sweep may still be running.

    Args:
        path: the folder.

    Returns:
        The smallest grid that holds them and what was asked for, see `dataset.union`; holes are not finished.

    Raises:
        InputError: there is no store, or it is damaged.
    """
    store = attach(path)
    store.read()
    return store.dataset()


def config_of(path: str | Path) -> dict[str, Any] | None:
    """What members of the store at a path depend on; None if nothing is there.

    Args:
        path: the folder.

    Returns:
        Settings, function, program, data, execution, environment.

    Raises:
        InputError: something else is there, or a damaged store.
    """
    return attach(path).config if Path(os.path.realpath(path)).exists() else None

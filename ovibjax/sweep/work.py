"""One sweep as work that can be done batch by batch, here or in another process."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from typing import Any, Protocol

import jax
import numpy as np

from ovibjax.sweep.grid import Grid
from ovibjax.sweep.members import data_digest, rows_of
from ovibjax.sweep.program import Batch, MemberFn, Program, batch_function
from ovibjax.sweep.staged import STATE, STEPS, Form, Staged, form_of
from ovibjax.sweep.staged_program import Stage, StagedProgram

PADDING = -1
"""Entry of a lot that holds no member."""

_agreed: dict[str, bool] = {}


@dataclass(frozen=True)
class Along:
    """Data that differ along one axis: the member function receives the entry of its own value.

    Attributes:
        axis: name of the axis.
        values: one pytree of arrays per value, all of equal shapes.
    """

    axis: str
    values: Sequence[Any]


class Brought(Protocol):
    """Arrays that each member has for itself, beside its values on the axes."""

    def of(self, members: np.ndarray) -> dict[str, Any]:
        """Entries of the points of members [n], each a pytree of arrays [n, ...]."""


@dataclass(frozen=True)
class Work:
    """Everything that computing a member needs; can be sent to another process.

    Attributes:
        fn: the member function.
        grid: the members that are asked for.
        outer: position of the outer dimension, or None.
        batch: how members are put together.
        devices: devices that share a batch.
        threads: see `pool_threads`; of the process that computes.
        shared: data, or `Along`.
        alive_bytes: what a member keeps alive while it runs, see `trace_member`; 0 where nobody knows.
        stage: the steps to take of a function in stages, all if None; the grid has `STEPS` among its axes otherwise.
        brought: what each member brings along for itself.
    """

    fn: MemberFn
    grid: Grid
    outer: int | None
    batch: Batch
    devices: int
    threads: int
    shared: Any
    alive_bytes: int = 0
    stage: Stage | None = None
    brought: "Brought | None" = None

    def __getstate__(self) -> dict[str, Any]:
        # Without what is cached: a program stays in its process.
        return {field.name: self.__dict__[field.name] for field in fields(self)}

    def lots(self, members: np.ndarray) -> list[np.ndarray]:
        """Members as batches.

        Args:
            members: [n] flat indices into the grid.

        Returns:
            Batches [devices, lanes] of them, padded with `PADDING`; outer values slowest.
        """
        lanes, devices = self.batch.lanes, self.devices
        at = np.zeros(len(members), int) if self.outer is None else self._outer_of(members)
        members = members[np.argsort(at, kind="stable")]
        if self.batch.grouped:
            at = np.sort(at, kind="stable")
            parts = [members[at == value] for value in np.unique(at)]
            rows = [part[i : i + lanes] for part in parts for i in range(0, len(part), lanes)]
        else:
            rows = [members[i : i + lanes] for i in range(0, len(members), lanes)]
        table = np.full((-(-len(rows) // devices) * devices, lanes), PADDING)
        for row, part in zip(table, rows, strict=False):
            row[: len(part)] = part
        return list(table.reshape(-1, devices, lanes))

    def arguments(self, lot: np.ndarray) -> tuple[dict[str, np.ndarray], Any]:
        """Points [devices * lanes] and data of a batch."""
        members = _filled(lot)
        points = self.grid.points(members.ravel(), self._seen)
        if self.brought is not None:
            points |= self.brought.of(members.ravel())
        return points, self._data(members)

    @property
    def _seen(self) -> list[str]:
        """Axes whose values the member function is given."""
        return [name for name in self.grid.axes if self.stage is None or name != STEPS]

    def _data(self, members: np.ndarray) -> Any:
        """Data of a batch [devices, lanes]."""
        if not isinstance(self.shared, Along):
            return self._common
        each = members[:, 0] if self.batch.grouped else members.ravel()
        return self._stack(tuple(self._outer_of(each).tolist()))

    def compute(self, lot: np.ndarray) -> np.ndarray:
        """The members of a batch as rows, on the host."""
        return self.rows(*self.outputs(lot))

    def outputs(self, lot: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """The members of a batch [n], and what each gave [n, ...] by name, on the host."""
        real = lot.ravel() != PADDING
        found, keep = self._outputs(lot), self.stage is not None and self.stage.keep
        wanted = {name: values[real] for name, values in found.items() if keep or not name.startswith(STATE)}
        return lot.ravel()[real], wanted

    def rows(self, members: np.ndarray, outputs: dict[str, np.ndarray]) -> np.ndarray:
        """Members and what they gave, as rows."""
        diverged = np.zeros(len(members), bool)
        for values in outputs.values():
            if values.dtype.kind == "f":
                diverged |= ~np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
        return rows_of(self.grid, members, [self.digests[i] for i in self.data_of(members)], outputs, diverged)

    def places_agree(self, members: np.ndarray) -> bool:
        """Whether a member's bits do not depend on its place in a batch: the first batch forwards and backwards.

        Machine code may treat the last few of many numbers otherwise than the others.

        Args:
            members: [n] flat indices into the grid, of which the first batch is looked at.

        Returns:
            True if all copies of a member are equal; looked at once per program and process.
        """
        if self.batch.lanes == 1 or not len(members):
            return True
        if self.program.key not in _agreed:
            lot = self.lots(members)[0]
            one, other = _filled(lot), _filled(lot)[:, ::-1]
            found, again = (self.program.whole(*self.arguments(part)) for part in (lot, other))
            _agreed[self.program.key] = all(
                _are_equal([*values[one.ravel() == member], *again[name][other.ravel() == member]])
                for name, values in found.items()
                for member in np.unique(one)
            )
            self._known[lot.tobytes()] = found  # it is computed next
        return _agreed[self.program.key]

    def _outputs(self, lot: np.ndarray) -> dict[str, np.ndarray]:
        return self._known.pop(lot.tobytes(), None) or self.program(*self.arguments(lot))

    @cached_property
    def _known(self) -> dict[bytes, dict[str, np.ndarray]]:
        """Outputs of batches that were computed before anybody asked for them."""
        return {}

    def data_of(self, members: np.ndarray) -> list[int]:
        """Which of `digests` belongs to each member."""
        return self._outer_of(members).tolist() if isinstance(self.shared, Along) else [0] * len(members)

    @cached_property
    def digests(self) -> list[bytes]:
        """What identifies the data of each outer value, or of all members."""
        values = self.shared.values if isinstance(self.shared, Along) else [self.shared]
        known = {id(data): data for data in values}  # one may stand at several places
        found = {key: data_digest(data) for key, data in known.items()}
        return [found[id(data)] for data in values]

    @cached_property
    def program(self) -> Program | StagedProgram:
        """The program of every batch, lowered."""
        return self._program(self.devices)

    @cached_property
    def text_hash(self) -> str:
        """Hash of the program's text on one device: what a machine's size does not change."""
        return (self.program if self.devices == 1 else self._program(1)).text_hash

    def _program(self, devices: int) -> Program | StagedProgram:
        along = isinstance(self.shared, Along)
        outer = () if self.outer is None else [name for name in self.grid.groups[self.outer] if name in self._seen]
        members = np.zeros((devices, self.batch.lanes), int)
        points, shared = self.grid.points(members.ravel(), self._seen), self._data(members)

        def lower(fn: Any, called: Any, points: Any, *same: Any) -> Program:
            function = batch_function(fn, self.batch, outer, along, devices)
            return Program(function, called, devices, (points, shared, *same))

        if not isinstance(self.fn, Staged):
            return lower(self.fn, self.fn, points)
        stage = self.stage or Stage(0, self.fn.steps, False)
        return StagedProgram(self.fn, self.form, stage, points, devices, lower)

    @cached_property
    def form(self) -> Form:
        """What the state of a member is made of, of a function in stages."""
        assert isinstance(self.fn, Staged)
        example = {name: self.grid.codes(name)[0] for name in self._seen}
        return form_of(self.fn, example, self.shared.values[0] if isinstance(self.shared, Along) else self.shared)

    @cached_property
    def _common(self) -> Any:
        return self.shared if self.devices > 1 else jax.device_put(self.shared)

    @cached_property
    def _stack(self) -> Callable[[tuple[int, ...]], Any]:
        # A few batches at a time: those of one outer value follow each other.
        return lru_cache(maxsize=4)(
            lambda index: jax.tree.map(lambda *leaves: np.stack(leaves), *(self.shared.values[i] for i in index))
        )

    def _outer_of(self, members: np.ndarray) -> np.ndarray:
        assert self.outer is not None
        return np.unravel_index(members, self.grid.shape)[self.outer]


def _filled(lot: np.ndarray) -> np.ndarray:
    """A batch with members in all places: the first of its row, or of all, again where there was none."""
    heads = np.where(lot[:, :1] == PADDING, lot[0, 0], lot[:, :1])
    return np.where(lot == PADDING, heads, lot)


def _are_equal(arrays: Sequence[np.ndarray]) -> bool:
    """Whether arrays are equal bit for bit."""
    return len({np.ascontiguousarray(array).tobytes() for array in arrays}) == 1

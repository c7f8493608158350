"""Run a sweep: one compiled program, chunk after chunk, in memory or into a store that survives a kill.

`fn(key, point, shared)` is a pure function of one member. Its key follows the member's `seed` (common random
numbers: members of equal seed see the same draws), `point` holds its value on every axis, `shared` the data.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
import xarray

from ovibjax.errors import InputError
from ovibjax.runtime.threads import in_threads
from ovibjax.sweep.grid import PADDING, Axis, Grid, make_chunks, make_grid
from ovibjax.sweep.in_memory import InMemory
from ovibjax.sweep.program import SEED, MemberFn, Shape, choose_shape, trace_member
from ovibjax.sweep.schema import Schema, Variable, check
from ovibjax.sweep.store import Store, config_of
from ovibjax.sweep.work import Along, Block, Work, configuration

Executor = Callable[[Work, Sequence[int], Path | None], Iterator[tuple[int, Block | None]]]
"""Computes chunks elsewhere: yields (chunk, its arrays), or (chunk, None) for one that a worker has stored itself."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C came during a sweep; what was finished is kept.

    Attributes:
        dataset: the finished members.
    """

    def __init__(self, dataset: xarray.Dataset) -> None:
        super().__init__("interrupted")
        self.dataset = dataset


# Many keywords, as each says one thing about a sweep that a caller may leave out; inside they become a schema, a shape
# and a configuration at once.
def run(
    fn: MemberFn,
    axes: Mapping[str, Any],
    shared: Any = None,
    *,
    zipped: Sequence[Sequence[str]] = (),
    dims: Mapping[str, Sequence[str]] | None = None,
    coords: Mapping[str, Any] | None = None,
    units: Mapping[str, str] | None = None,
    store: str | Path | Callable[[dict[str, Any]], Path] | None = None,
    settings: Mapping[str, Any] | None = None,
    chunk: int | None = None,
    lanes: int | None = None,
    executor: Executor | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> xarray.Dataset:
    """Compute a member function on every point of a grid, in one compiled program.

    Args:
        fn: pure function of (key, point, shared) that returns a dictionary of arrays; dictionaries may nest.
        axes: values per axis, or `Axis` with a unit; all points of the product are computed. Names are passed as
            their index. The axis `seed` sets the key.
        shared: a pytree of arrays, or `Along` for data that differ along one axis.
        zipped: groups of axes that advance together.
        dims: names of the trailing dimensions of outputs.
        coords: values (or `Axis`) of these dimensions.
        units: units of outputs.
        store: a folder to write finished chunks to and to resume from, or a function that gives it from the sweep's
            configuration; in memory only if None.
        settings: whatever else identifies the sweep, JSON's types; kept in the store and compared on resuming.
        chunk: members per chunk; chosen from memory if None.
        lanes: members vmapped together; chosen if None.
        executor: computes chunks elsewhere, e.g. `cluster.on_ray()`; this process if None.
        on_progress: called with members finished and members in all.

    Returns:
        One named dimension per axis (or zipped group) with coordinates and units, and the booleans `finished` and
        `diverged`.

    Raises:
        InputError: bad axes, data that do not fit, or a store that cannot be used.
        Interrupted: Ctrl-C; carries the finished members.

    Example:
        >>> dataset = run(lambda key, point, data: {"y": point["a"] * data}, {"a": [1.0, 2.0, 3.0]}, 10.0)
        >>> dataset.y.values.tolist()
        [10.0, 20.0, 30.0]
    """
    grid = make_grid(axes, zipped)
    outer = _outer_dimension(grid, shared)
    example = {name: grid.codes(name)[0] for name in grid.axes}
    outputs, cost = trace_member(fn, example, shared.values[0] if isinstance(shared, Along) else shared)
    variables = _variables(outputs, dims or {}, units or {})
    shape = _shape(grid, outer, cost, chunk, lanes, store if isinstance(store, str | Path) else None)
    schema = Schema(grid, make_chunks(grid, outer, shape.rows, shape.columns), variables, _axes(coords or {}))
    check(schema)
    work = Work(fn, schema, shape, shared)
    config = configuration(work, dict(settings or {}))
    path = store(config) if callable(store) else store
    with InMemory(schema, config) if path is None else Store.open(path, schema, config) as kept:
        complete = _finish(work, kept, executor or _in_process, on_progress or (lambda done, total: None))
        dataset = kept.dataset()
    if not complete:
        raise Interrupted(dataset)
    return dataset


def _outer_dimension(grid: Grid, shared: Any) -> int | None:
    """Position of the dimension that data differ along, the seed's where they do not; None if there is none."""
    if SEED in grid.axes and grid.codes(SEED).dtype != np.int32:
        raise InputError("axis seed: values are whole numbers")
    if not isinstance(shared, Along):
        return grid.group_of(SEED) if SEED in grid.axes else None
    if shared.axis not in grid.axes or len(shared.values) != len(grid.axes[shared.axis].values):
        raise InputError(f"the data differ along axis {shared.axis!r}, which has not one entry per value in the grid")
    return grid.group_of(shared.axis)


def _shape(
    grid: Grid, outer: int | None, cost: tuple[int, int], chunk: int | None, lanes: int | None, store: str | Path | None
) -> Shape:
    """Size of a chunk: what the caller says, what a store was begun with, or what memory allows."""
    if (chunk is not None and chunk < 1) or (lanes is not None and lanes < 1):
        raise InputError("chunk and lanes are positive numbers of members")
    held = config_of(store) if store is not None else None
    if held is None or chunk is not None or lanes is not None or "execution" not in held:
        return choose_shape(grid, outer, cost, chunk, lanes)
    # Chunks as the store has them: memory may have chosen otherwise today, and bits depend on it.
    shape = Shape(**held["execution"])
    if shape.devices > jax.local_device_count():
        raise InputError(f"{store} was begun on {shape.devices} devices; here are {jax.local_device_count()}")
    return shape


def _variables(
    outputs: Mapping[str, Any], dims: Mapping[str, Sequence[str]], units: Mapping[str, str]
) -> dict[str, Variable]:
    """Outputs with names for their trailing dimensions, the caller's or made ones."""
    for name in {**dims, **units}:
        if name not in outputs:
            raise InputError(f"dims and units: there is no output {name!r}; there are {', '.join(outputs)}")
    return {name: _variable(name, aval, dims.get(name, ()), units.get(name, "")) for name, aval in outputs.items()}


def _variable(name: str, aval: Any, dims: Sequence[str], unit: str) -> Variable:
    named = tuple(dims)
    if len(named) > len(aval.shape):
        raise InputError(f"output {name} has shape {aval.shape}; dims names {len(named)} dimensions")
    named += tuple(f"{name}_dim_{i}" for i in range(len(named), len(aval.shape)))
    return Variable(tuple(aval.shape), np.dtype(aval.dtype), named, unit)


def _axes(coords: Mapping[str, Any]) -> dict[str, Axis]:
    return {name: axis if isinstance(axis, Axis) else Axis(np.asarray(axis).tolist()) for name, axis in coords.items()}


def _finish(work: Work, kept: Store | InMemory, compute: Executor, on_progress: Callable[[int, int], None]) -> bool:
    """Compute and keep the chunks that are not finished; False if Ctrl-C came before the last."""
    done = kept.finished()
    real = (work.schema.chunks.members != PADDING).sum(axis=(1, 2))
    try:
        on_progress(int(real[done].sum()), work.schema.grid.size)
        for i, block in compute(work, np.flatnonzero(~done).tolist(), kept.path):
            if block is not None:
                kept.write(i, block.arrays, block.diverged)
            done[i] = True
            on_progress(int(real[done].sum()), work.schema.grid.size)
    except KeyboardInterrupt:
        return False
    return True


def _in_process(work: Work, pending: Sequence[int], _: Path | None) -> Iterator[tuple[int, Block]]:
    """Chunks on this machine: one per core at a time, or one after another over all devices."""

    def one(i: int) -> tuple[int, Block]:
        return i, work.compute(i)

    if work.shape.devices > 1:
        return map(one, pending)
    return in_threads(one, pending)

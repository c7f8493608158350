"""Run a sweep: one compiled program, chunk after chunk, in memory or into a store that survives a kill.

    dataset = run(fn, {"beta": [1e-4, 1e-3], "gamma": [0, 0.1], "seed": range(5)}, data)

`fn(key, point, shared)` is a pure function of one member. Its key follows the member's `seed` (common random
numbers: members of equal seed see the same draws), `point` holds its value on every axis, `shared` the data.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import jax
import numpy as np
import xarray

from ovibjax.errors import InputError
from ovibjax.runtime.threads import in_threads
from ovibjax.sweep.grid import PADDING, Axis, make_chunks, make_grid
from ovibjax.sweep.layout import Layout, Variable, assemble, check
from ovibjax.sweep.program import SEED, MemberFn, Shape, choose_shape, trace_member
from ovibjax.sweep.store import Store, config_of
from ovibjax.sweep.work import Along, Block, Work, describe

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
    """
    grid = make_grid(axes, zipped)
    if (chunk is not None and chunk < 1) or (lanes is not None and lanes < 1):
        raise InputError("chunk and lanes are positive numbers of members")
    named = shared.axis if isinstance(shared, Along) else SEED
    if isinstance(shared, Along) and (named not in grid.axes or len(shared.values) != len(grid.axes[named].values)):
        raise InputError(f"the data differ along axis {named!r}, which has not one entry per value in the grid")
    outer = grid.group_of(named) if named in grid.axes else None
    example = {name: grid.codes(name)[0] for name in grid.axes}
    one = shared.values[0] if isinstance(shared, Along) else shared
    outputs, cost = trace_member(fn, example, one)
    held = config_of(store) if isinstance(store, str | Path) else None
    for name in {**(dims or {}), **(units or {})}:
        if name not in outputs:
            raise InputError(f"dims and units: there is no output {name!r}; there are {', '.join(outputs)}")
    if SEED in grid.axes and grid.codes(SEED).dtype != np.int32:
        raise InputError("axis seed: values are whole numbers")
    if held is not None and chunk is None and lanes is None and "execution" in held:
        # Chunks as the store has them: memory may have chosen otherwise today, and bits depend on it.
        shape = Shape(**held["execution"])
    else:
        shape = choose_shape(grid, outer, cost, chunk, lanes)
    if shape.devices > jax.local_device_count():
        raise InputError(f"{store} was begun on {shape.devices} devices; here are {jax.local_device_count()}")
    layout = Layout(
        grid,
        make_chunks(grid, outer, shape.rows, shape.columns),
        {name: _variable(name, aval, dims or {}, units or {}) for name, aval in outputs.items()},
        {
            name: axis if isinstance(axis, Axis) else Axis(np.asarray(axis).tolist())
            for name, axis in (coords or {}).items()
        },
    )
    check(layout)
    work = Work(fn, layout, shape, shared)
    config = describe(work, dict(settings or {}))
    if callable(store):
        store = store(config)
    with ExitStack() as stack:
        kept = stack.enter_context(Store.open(store, layout, config)) if store is not None else None
        blocks: dict[int, Block] = {}
        done = kept.finished() if kept is not None else np.zeros(len(layout.chunks.members), bool)
        real = (layout.chunks.members != PADDING).sum(axis=(1, 2))
        pending = np.flatnonzero(~done).tolist()
        compute = executor or _in_process
        interrupted = False
        try:
            if on_progress is not None:
                on_progress(int(real[done].sum()), grid.size)
            for i, block in compute(work, pending, kept.path if kept is not None else None):
                if block is not None and kept is not None:
                    kept.write(i, block.arrays, block.diverged)
                elif block is not None:
                    blocks[i] = block
                done[i] = True
                if on_progress is not None:
                    on_progress(int(real[done].sum()), grid.size)
        except KeyboardInterrupt:
            interrupted = True
        dataset = kept.dataset() if kept is not None else _gather(layout, blocks, config)
    if interrupted:
        raise Interrupted(dataset)
    return dataset


def _in_process(work: Work, pending: Sequence[int], _: Path | None) -> Iterator[tuple[int, Block]]:
    """Chunks on this machine: one per core at a time, or one after another over all devices."""

    def one(i: int) -> tuple[int, Block]:
        return i, work.compute(i)

    if work.shape.devices > 1:
        return map(one, pending)
    return in_threads(one, pending)


def _variable(name: str, aval: Any, dims: Mapping[str, Sequence[str]], units: Mapping[str, str]) -> Variable:
    named = tuple(dims.get(name, ()))
    if len(named) > len(aval.shape):
        raise InputError(f"output {name} has shape {aval.shape}; dims names {len(named)} dimensions")
    named += tuple(f"{name}_dim_{i}" for i in range(len(named), len(aval.shape)))
    return Variable(tuple(aval.shape), np.dtype(aval.dtype), named, units.get(name, ""))


def _gather(layout: Layout, blocks: dict[int, Block], config: dict[str, Any]) -> xarray.Dataset:
    order = sorted(blocks)

    def read(name: str) -> np.ndarray:
        parts = [blocks[i].diverged if name == "diverged" else blocks[i].arrays[name] for i in order]
        variable = layout.variables.get(name, Variable((), np.dtype(bool), ()))
        size = layout.chunks.members[0].size
        if not parts:
            return np.empty((0, size, *variable.shape), variable.dtype)
        return np.stack(parts).reshape(len(parts), size, *variable.shape)

    return assemble(layout, order, read, config)

"""Run a sweep: one compiled program, batch after batch, in memory or into a store that grows and survives a kill.

`fn(key, point, shared)` is a pure function of one member. Its key follows the member's `seed` (common random
numbers: members of equal seed see the same draws), `point` holds its value on every axis, `shared` the data.
"""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import xarray

from ovibjax.errors import InputError
from ovibjax.runtime.limits import free_bytes
from ovibjax.runtime.threads import in_threads, one_blas_thread, pool_threads
from ovibjax.sweep.grid import Axis, Grid, make_grid
from ovibjax.sweep.in_memory import InMemory
from ovibjax.sweep.layout import Layout, Variable, compared, layout_of
from ovibjax.sweep.program import SEED, Batch, MemberFn, choose_batch, next_power_of_two, trace_member
from ovibjax.sweep.store import Store, config_of
from ovibjax.sweep.work import Along, Work, identity

Executor = Callable[[Work, Sequence[np.ndarray], Path | None], Iterator[tuple[int, np.ndarray | None]]]
"""Computes batches elsewhere: yields (members finished, their rows), or None for rows that a worker has stored."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C came during a sweep; what was finished is kept.

    Attributes:
        dataset: the grid, with the finished members.
    """

    def __init__(self, dataset: xarray.Dataset) -> None:
        super().__init__("interrupted")
        self.dataset = dataset


# Many keywords, as each says one thing about a sweep that a caller may leave out; inside they become a layout, a batch
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
    notes: Mapping[str, Any] | None = None,
    lanes: int | None = None,
    shard: tuple[int, int] | None = None,
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
        store: a folder that holds finished members and to which the missing ones are added, or a function that gives
            it from all that sweeps must have in common to share one; in memory only if None.
        settings: whatever else identifies the sweep, JSON's types; kept in the store and compared.
        notes: what is kept in a store that is made and not compared, such as the name of a file whose content counts.
        lanes: members vmapped together; chosen if None. Bits depend on it, so that a store keeps its own.
        shard: (i, n), i from 1 to n: compute every n-th member only, so that n processes that share a folder fill one
            store without waiting for each other.
        executor: computes batches elsewhere, e.g. `cluster.on_ray()`; this process if None.
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
    mine = np.arange(grid.size) if shard is None else _shard(grid.size, *shard)
    example = {name: grid.codes(name)[0] for name in grid.axes}
    outputs, alive = trace_member(fn, example, shared.values[0] if isinstance(shared, Along) else shared)
    layout = layout_of(grid, _variables(outputs, dims or {}, units or {}), _axes(coords or {}))
    devices = jax.local_device_count()
    # Workers elsewhere have one thread per device: those of one program gain little, and there is a worker per core.
    threads = pool_threads() if executor is None else devices
    work = Work(fn, grid, outer, _batch(grid, outer, shared, alive, lanes), devices, threads, shared, alive)
    given = dict(settings or {})
    path = None if callable(store) else store
    if callable(store):
        path = store({**identity(work, given), **_of_its_own(work, layout)})
    with one_blas_thread():
        work = _settled(work, None if path is None else config_of(path), mine, lanes)
        config = identity(work, given) | ({"notes": dict(notes)} if notes else {})
        with InMemory(layout, config) if path is None else Store.open(path, layout, config) as kept:
            complete = _finish(work, kept, mine, shard is None, executor or _in_process, on_progress or _silent)
            dataset = kept.dataset(grid)
    if not complete:
        raise Interrupted(dataset)
    return dataset


def _shard(size: int, i: int, n: int) -> np.ndarray:
    """[m] members of one of n shards."""
    if not 1 <= i <= n:
        raise InputError(f"shard {i}/{n}: there are shards 1/{n} to {n}/{n}")
    return np.arange(i - 1, size, n)


def _outer_dimension(grid: Grid, shared: Any) -> int | None:
    """Position of the dimension that data differ along, the seed's where they do not; None if there is none."""
    if SEED in grid.axes and grid.codes(SEED).dtype != np.int32:
        raise InputError("axis seed: values are whole numbers")
    if not isinstance(shared, Along):
        return grid.group_of(SEED) if SEED in grid.axes else None
    if shared.axis not in grid.axes or len(shared.values) != len(grid.axes[shared.axis].values):
        raise InputError(f"the data differ along axis {shared.axis!r}, which has not one entry per value in the grid")
    return grid.group_of(shared.axis)


def _batch(grid: Grid, outer: int | None, shared: Any, alive_bytes: int, lanes: int | None) -> Batch:
    """How members are put together: as the caller says, or by what a member needs."""
    inner = None if outer is None else grid.size // grid.shape[outer]
    if lanes is None:
        own = jax.tree.leaves(shared.values[0]) if isinstance(shared, Along) else []
        return choose_batch(alive_bytes, sum(np.asarray(leaf).nbytes for leaf in own), grid.size, inner)
    if lanes < 1:
        raise InputError("lanes is a positive number of members")
    return Batch(lanes, inner is not None and inner >= lanes > 1)


def _of_its_own(work: Work, layout: Layout) -> dict[str, Any]:
    """What must be equal beside the identity lest a sweep be refused: outputs, data, and names by their numbers."""
    names = {name: np.asarray(work.grid.axes[name].values).tolist() for name in sorted(layout.named)}
    return {"layout": compared(layout), "first_data": work.digests[0].hex(), "names": names}


def _settled(work: Work, held: dict[str, Any] | None, members: np.ndarray, lanes: int | None) -> Work:
    """The work as a store was begun with it; where there is none, one whose members' bits depend on no place."""
    held = held or {}
    work = _with(work, threads=held.get("environment", {}).get("threads", work.threads))
    if lanes is None and held.get("execution", {}).keys() == asdict(work.batch).keys():
        return _with(work, batch=Batch(**held["execution"]))
    # Where the machine code of a batch treats its places differently, whole vectors may help, and a batch of one does.
    for batch in (work.batch, replace(work.batch, lanes=next_power_of_two(work.batch.lanes)), Batch(1, False)):
        work = _with(work, batch=batch)
        if work.places_agree(members):
            break
    return work


def _with(work: Work, **changes: Any) -> Work:
    """Changed work; what is changed to itself keeps its program."""
    return work if all(getattr(work, name) == value for name, value in changes.items()) else replace(work, **changes)


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


def _finish(
    work: Work,
    kept: Store | InMemory,
    mine: np.ndarray,
    whole: bool,
    compute: Executor,
    on_progress: Callable[[int, int], None],
) -> bool:
    """Compute and keep the members that are missing; False if Ctrl-C came before the last."""
    data = [work.digests[i] for i in work.data_of(np.arange(work.grid.size))]

    def lacking() -> np.ndarray:
        return np.intersect1d(kept.missing(work.grid, data), mine)

    missing = lacking()
    if len(missing) and compute is _in_process:
        _require_threads(work, kept.path)
    if len(missing) and whole:  # who only reads needs no lock, nor a disk that can be written
        kept.lock()
        missing = lacking()
    if len(missing):
        kept.announce(work.grid)
    done = len(mine) - len(missing)
    try:
        on_progress(done, len(mine))
        for count, rows in compute(work, work.lots(missing), kept.path):
            if rows is not None:
                kept.add(rows)
            done += count
            on_progress(done, len(mine))
    except KeyboardInterrupt:
        return False
    finally:
        if compute is not _in_process:
            kept.read()  # what workers have stored
    return True


def _require_threads(work: Work, path: Path | None) -> None:
    """Refuse to add members with other last bits than the same ones of a store would have."""
    if work.threads != pool_threads() and jax.default_backend() == "cpu":
        advice = f"start with NPROC={work.threads} in the environment, or --threads {work.threads}"
        if work.threads < work.devices:
            advice = "leave --devices out, members run side by side without it, or choose another store"
        raise InputError(
            f"{path}: its members were computed by programs of {work.threads} threads, and bits depend on it; here are "
            f"{pool_threads()}: {advice}"
        )


def _silent(done: int, total: int) -> None:
    """Tell nobody how far it is."""


def _in_process(work: Work, lots: Sequence[np.ndarray], _: Path | None) -> Iterator[tuple[int, np.ndarray]]:
    """Batches on this machine: one per core at a time, or one after another over all devices."""

    def one(lot: np.ndarray) -> tuple[int, np.ndarray]:
        rows = work.compute(lot)
        return len(rows), rows

    return map(one, lots) if work.devices > 1 else in_threads(one, lots, _fitting(work))


def _fitting(work: Work) -> int | None:
    """Batches whose memory fits beside each other into what this process may still take; None where nobody knows."""
    each, free = work.alive_bytes * work.batch.lanes, free_bytes()
    return None if free is None or not 0 < each < sys.maxsize else max(1, free // each)

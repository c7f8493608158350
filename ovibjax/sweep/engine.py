"""Run a sweep: one compiled program, batch after batch, in memory or into a store that grows and survives a kill.

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
from ovibjax.runtime.threads import one_blas_thread, pool_threads
from ovibjax.sweep.arrange import (
    batch_of,
    coordinates_of,
    each_batch,
    outer_dimension,
    require_threads,
    settled,
    variables_of,
)
from ovibjax.sweep.grid import make_grid
from ovibjax.sweep.identity import identity
from ovibjax.sweep.in_memory import InMemory
from ovibjax.sweep.layout import Layout, compared, layout_of
from ovibjax.sweep.program import MemberFn, trace_member
from ovibjax.sweep.store import Store, config_of
from ovibjax.sweep.work import Along, Work

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
    outer = outer_dimension(grid, shared)
    mine = np.arange(grid.size) if shard is None else _shard(grid.size, *shard)
    example = {name: grid.codes(name)[0] for name in grid.axes}
    outputs, alive = trace_member(fn, example, shared.values[0] if isinstance(shared, Along) else shared)
    layout = layout_of(grid, variables_of(outputs, dims or {}, units or {}), coordinates_of(coords or {}))
    devices = jax.local_device_count()
    # Workers elsewhere have one thread per device: those of one program gain little, and there is a worker per core.
    threads = pool_threads() if executor is None else devices
    work = Work(fn, grid, outer, batch_of(grid, outer, shared, alive, lanes), devices, threads, shared, alive)
    given = dict(settings or {})
    path = None if callable(store) else store
    if callable(store):
        path = store({**identity(work, given), **_of_its_own(work, layout)})
    with one_blas_thread():
        work = settled(work, None if path is None else config_of(path), mine, lanes)
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


def _of_its_own(work: Work, layout: Layout) -> dict[str, Any]:
    """What must be equal beside the identity lest a sweep be refused: outputs, data, and names by their numbers."""
    names = {name: np.asarray(work.grid.axes[name].values).tolist() for name in sorted(layout.named)}
    return {"layout": compared(layout), "first_data": work.digests[0].hex(), "names": names}


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
        require_threads(work, kept.path)
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


def _silent(done: int, total: int) -> None:
    """Tell nobody how far it is."""


def _in_process(work: Work, lots: Sequence[np.ndarray], _: Path | None) -> Iterator[tuple[int, np.ndarray]]:
    """Batches on this machine."""
    return ((len(rows), rows) for rows in each_batch(work, lots, work.compute))

"""What a sweep is made of before anything is computed: how members are batched, what their outputs are called."""

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, TypeVar

import jax
import numpy as np

from ovibjax.errors import InputError
from ovibjax.runtime.limits import free_bytes
from ovibjax.runtime.threads import in_threads, pool_threads
from ovibjax.sweep.grid import Axis, Grid
from ovibjax.sweep.layout import Variable
from ovibjax.sweep.program import SEED, Batch, choose_batch, next_power_of_two
from ovibjax.sweep.work import Along, Work

Result = TypeVar("Result")


def outer_dimension(grid: Grid, shared: Any) -> int | None:
    """Position of the dimension that data differ along, the seed's where they do not; None if there is none."""
    if SEED in grid.axes and grid.codes(SEED).dtype != np.int32:
        raise InputError("axis seed: values are whole numbers")
    if not isinstance(shared, Along):
        return grid.group_of(SEED) if SEED in grid.axes else None
    if shared.axis not in grid.axes or len(shared.values) != len(grid.axes[shared.axis].values):
        raise InputError(f"the data differ along axis {shared.axis!r}, which has not one entry per value in the grid")
    return grid.group_of(shared.axis)


def batch_of(grid: Grid, outer: int | None, shared: Any, alive_bytes: int, lanes: int | None) -> Batch:
    """How members are put together: as the caller says, or by what a member needs."""
    inner = None if outer is None else grid.size // grid.shape[outer]
    if lanes is None:
        own = jax.tree.leaves(shared.values[0]) if isinstance(shared, Along) else []
        return choose_batch(alive_bytes, sum(np.asarray(leaf).nbytes for leaf in own), grid.size, inner)
    if lanes < 1:
        raise InputError("lanes is a positive number of members")
    return Batch(lanes, inner is not None and inner >= lanes > 1)


def settled(work: Work, held: dict[str, Any] | None, members: np.ndarray, lanes: int | None) -> Work:
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


def variables_of(
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


def coordinates_of(coords: Mapping[str, Any]) -> dict[str, Axis]:
    """Values of the dimensions of outputs."""
    return {name: axis if isinstance(axis, Axis) else Axis(np.asarray(axis).tolist()) for name, axis in coords.items()}


def require_threads(work: Work, path: Path | None) -> None:
    """Refuse to add members with other last bits than the same ones of a store would have."""
    if work.threads != pool_threads() and jax.default_backend() == "cpu":
        advice = f"start with NPROC={work.threads} in the environment, or --threads {work.threads}"
        if work.threads < work.devices:
            advice = "leave --devices out, members run side by side without it, or choose another store"
        raise InputError(
            f"{path}: its members were computed by programs of {work.threads} threads, and bits depend on it; here are "
            f"{pool_threads()}: {advice}"
        )


def each_batch(work: Work, lots: Sequence[np.ndarray], one: Callable[[np.ndarray], Result]) -> Iterable[Result]:
    """Batches on this machine: one per core at a time, or one after another over all devices.

    Args:
        work: what they are of.
        lots: the batches.
        one: computes one; called from several threads.

    Returns:
        What each gave, as they are finished.
    """
    return map(one, lots) if work.devices > 1 else in_threads(one, lots, _fitting(work))


def _fitting(work: Work) -> int | None:
    """Batches whose memory fits beside each other into what this process may still take; None where nobody knows."""
    each, free = work.alive_bytes * work.batch.lanes, free_bytes()
    return None if free is None or not 0 < each < sys.maxsize else max(1, free // each)

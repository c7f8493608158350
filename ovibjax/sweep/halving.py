"""Halving: every point is trained for a while, the best of them go on, each from its own state.

What is found at the end of a rung is a member of the store like any other, with `steps` among its axes. States are in a
folder of the store until the rung after theirs has ended; one that is not there is computed again.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import xarray

from ovibjax.errors import InputError
from ovibjax.runtime.threads import one_blas_thread, pool_threads
from ovibjax.sweep.arrange import batch_of, coordinates_of, outer_dimension, variables_of
from ovibjax.sweep.climb import Brought, Climb, Plan
from ovibjax.sweep.engine import Interrupted
from ovibjax.sweep.grid import make_grid
from ovibjax.sweep.identity import identity
from ovibjax.sweep.in_memory import InMemory
from ovibjax.sweep.ladder import Points, cuts_of, points_of
from ovibjax.sweep.layout import Layout, layout_of
from ovibjax.sweep.members import point_keys
from ovibjax.sweep.program import trace_member
from ovibjax.sweep.staged import STEPS, Staged
from ovibjax.sweep.staged_program import Stage
from ovibjax.sweep.states import States
from ovibjax.sweep.store import Store, config_of
from ovibjax.sweep.work import Along, Work


# Many keywords, as each says one thing about a sweep that a caller may leave out; see `run`.
def halve(
    fn: Staged,
    axes: Mapping[str, Any],
    shared: Any = None,
    *,
    score: str,
    factor: int = 3,
    rungs: int | None = None,
    zipped: Sequence[Sequence[str]] = (),
    dims: Mapping[str, Sequence[str]] | None = None,
    coords: Mapping[str, Any] | None = None,
    units: Mapping[str, str] | None = None,
    store: str | Path | None = None,
    settings: Mapping[str, Any] | None = None,
    notes: Mapping[str, Any] | None = None,
    lanes: int | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> xarray.Dataset:
    """Train all points of a grid for a while, go on with the best, and so on: a fraction of the steps of all of them.

    A member that goes on gives the same bits as one that was trained in one go (`run` with the same function and
    lanes): they are computed by the same programs. The seeds of a point live and die together.

    Args:
        fn: the member function in stages.
        axes: as for `run`; points are all combinations of values but for `seed`.
        shared: as for `run`.
        score: the output whose mean over seeds, and over its own dimensions, chooses; the lowest go on, and no point of
            which a seed diverged.
        factor: one point in so many goes on; each rung ends at this multiple of the one before.
        rungs: how many; by default so many that the first is about a ninth of the training.
        zipped: as for `run`.
        dims: as for `run`.
        coords: as for `run`.
        units: as for `run`.
        store: as for `run`; it also holds the states of members that may go on, until it is done.
        settings: as for `run`.
        notes: as for `run`.
        lanes: as for `run`.
        on_progress: called with the members judged so far and those of all rungs.

    Returns:
        Every member that was judged: one dimension of points, along which the axes that differ and `steps` are
        coordinates, and the other axes. Its attribute `rungs` lists `steps` and `points` of each, `spent` is the share
        of the steps that all points would have taken.

    Raises:
        InputError: what `run` refuses, a score that is not among the outputs or is one of a test, or a training that
            cannot be cut so often.
        Interrupted: Ctrl-C; carries the finished members.

    Example:
        >>> import jax
        >>> fn = Staged(
        ...     begin=lambda key, point, data: 1.0,
        ...     go_on=lambda key, point, data, w, first, last: jax.lax.fori_loop(
        ...         first, last, lambda i, w: w - point["rate"] * w, w
        ...     ),
        ...     judge=lambda key, point, data, w: {"loss": w**2},
        ...     steps=9,
        ... )
        >>> dataset = halve(fn, {"rate": [0.1 * i for i in range(1, 10)]}, score="loss")
        >>> dataset.attrs["rungs"]
        [{'steps': 1, 'points': 9}, {'steps': 3, 'points': 3}, {'steps': 9, 'points': 1}]
        >>> dataset.rate.values[dataset.steps == 9].tolist(), round(dataset.attrs["spent"], 2)
        ([0.9], 0.26)
    """
    asked = points_of(make_grid(axes, zipped))
    path = None if store is None else Path(store)
    with one_blas_thread():
        plan = _planned(fn, asked, cuts_of(fn.steps, fn.every, factor, rungs), shared, lanes, path)
        variables = variables_of(plan.outputs, dims or {}, units or {})
        layout = layout_of(plan.works[0].grid, variables, coordinates_of(coords or {}))
        _check_score(score, layout)
        plan.settle(None if path is None else config_of(path), lanes)
        config = identity(plan.works[0], dict(settings or {})) | {
            "halving": {"factor": factor, "steps": list(plan.cuts), "score": score},
        }
        config |= {"notes": dict(notes)} if notes else {}
        with InMemory(layout, config) if path is None else Store.open(path, layout, config) as kept:
            climb = Climb(plan, kept, on_progress or (lambda done, total: None))
            complete = climb.run(score, factor)
            dataset = climb.dataset()
    if not complete:
        raise Interrupted(dataset)
    return dataset


def _planned(fn: Staged, asked: Points, cuts: Sequence[int], shared: Any, lanes: int | None, path: Path | None) -> Plan:
    """The work of every rung, on all points."""
    every = np.arange(len(asked))
    grids = [asked.trained(every, np.full(len(asked), cut)) for cut in cuts]
    own = _own_data(asked, shared)
    one = own.values[0] if isinstance(own, Along) else own
    example = {name: grids[0].codes(name)[0] for name in grids[0].axes if name != STEPS}
    outputs, alive = trace_member(fn, example, one)
    outer = outer_dimension(grids[0], own)
    batch, devices, threads = batch_of(grids[0], outer, own, alive, lanes), jax.local_device_count(), pool_threads()
    stages = [Stage(first, cut, cut < fn.steps) for first, cut in zip((0, *cuts[:-1]), cuts, strict=True)]
    works = [
        Work(fn, grid, outer, batch, devices, threads, own, alive, stage)
        for grid, stage in zip(grids, stages, strict=True)
    ]
    names, states = _names(works[0]), States(path, works[0].form.leaves)
    for i, steps in enumerate(cuts[:-1], start=1):
        works[i] = replace(works[i], brought=Brought(states, steps, names))
    return Plan(asked, tuple(cuts), works, outputs, names, states)


def _names(work: Work) -> list[str]:
    """What tells members apart, whatever they are trained for: their points and data."""
    everyone = np.arange(work.grid.size)
    keys = point_keys(work.grid.points(everyone, [name for name in work.grid.axes if name != STEPS]))
    data = [work.digests[i] for i in work.data_of(everyone)]
    return [hashlib.blake2b(key + seen, digest_size=12).hexdigest() for key, seen in zip(keys, data, strict=True)]


def _own_data(asked: Points, shared: Any) -> Any:
    """Data per place on the dimension of the points where they differ along an axis that differs between points."""
    if not isinstance(shared, Along) or shared.axis not in asked.together:
        return shared
    outer_dimension(asked.grid, shared)  # an entry per value
    return Along(shared.axis, [shared.values[i] for i in asked.at[shared.axis].tolist()])


def _check_score(score: str, layout: Layout) -> None:
    """Refuse what cannot choose."""
    if score not in layout.variables:
        raise InputError(f"score {score}: there is no such output; there are {', '.join(layout.variables)}")
    if score.startswith("test"):
        raise InputError(
            f"score {score}: chosen by a test, the winner's would tell nothing; give a score of validation"
        )
    if layout.variables[score].dtype.kind not in "fiu":
        raise InputError(f"score {score} is no number")

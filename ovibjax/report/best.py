"""The point of a grid with the lowest metric under constraints, and how sure that is, as `ovibjax best` prints it."""

import operator
import shlex
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from ovibjax.errors import InputError
from ovibjax.report.claims import Interval
from ovibjax.report.labels import axes_of, find, grid_dims, metrics, text_of
from ovibjax.report.means import Over, average, notes_on, prepare, repetitions, spans
from ovibjax.report.selection import taken_apart
from ovibjax.runtime.plain_numbers import plain_float

_COMPARISONS: dict[str, Callable[[Any, Any], Any]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "<": operator.lt,
    ">": operator.gt,
}


@dataclass(frozen=True)
class RunnerUp:
    """The second-lowest point, against the lowest.

    Attributes:
        point: value per axis that the metric depends on.
        difference: its metric less that of the lowest point, paired by seed, with its 95 % interval.
        common: seeds that both points have.
        apart: whether the whole interval lies above zero; otherwise the two cannot be told apart.
        tied: points, the runner-up among them, that cannot be told apart from the lowest.
        others: points beside the lowest.
    """

    point: dict[str, Any]
    difference: Interval
    common: int
    apart: bool
    tied: int
    others: int


@dataclass(frozen=True)
class Choice:
    """A chosen point.

    Attributes:
        point: value per axis, those averaged over excepted.
        means: mean per metric at the point.
        halves: half-width of its 95 % interval, NaN for one value.
        feasible: points that keep the constraints.
        points: points in all.
        over: values per averaged axis.
        missing: what the means at the point lack, `3 of 5 seeds: 2 unfinished`; empty if nothing.
        runner_up: the next point; None if no other keeps the constraints.
    """

    point: dict[str, Any]
    means: dict[str, float]
    halves: dict[str, float]
    feasible: int
    points: int
    over: dict[str, list[Any]]
    missing: str = ""
    runner_up: RunnerUp | None = None


def choose(dataset: xr.Dataset, minimise: str, subject_to: Sequence[str] = (), over: Over = "seed") -> Choice:
    """Minimise the mean of a metric over the grid, where means of other metrics keep their bounds.

    Args:
        dataset: results of a sweep.
        minimise: the metric.
        subject_to: `METRIC<=NUMBER` each, or with >=, < or >.
        over: axes to average over.

    Returns:
        The point, the first of equals in the order of the grid, and its difference to the runner-up.

    Raises:
        InputError: an unknown metric, a bound of another form, or no point that keeps the bounds.
    """
    known = metrics(dataset)
    target = find(minimise, known, "metric")
    bounds = [_bound(entry, known) for entry in subject_to]
    data, along = prepare(dataset, known, over)
    made = {name: average(data, data[name], along) for name in known}
    mean, *others = xr.broadcast(made[target][0], *(made[name][0] for name, _, _ in bounds))
    keeps = np.isfinite(mean)
    for other, (_, comparison, number) in zip(others, bounds, strict=True):
        keeps = keeps & comparison(other, number)
    if not bool(keeps.any()):
        text = " and ".join(subject_to)
        raise InputError(
            f"no finished point keeps {text}; loosen the bound" if bounds else f"no point has a finite {target}"
        )
    ranked = mean.where(keeps, np.inf)
    at = _lowest(ranked)

    def at_point(part: xr.DataArray) -> float:
        # What does not depend on an axis that was chosen along is the same everywhere on it.
        where = {dim: i for dim, i in at.items() if dim in part.dims}
        value = part.isel(where)
        return float(value) if value.ndim == 0 else float("nan")

    return Choice(
        _point(data, at),
        {name: at_point(mean) for name, (mean, _) in made.items()},
        {name: at_point(half) for name, (_, half) in made.items()},
        int(keeps.sum()),
        keeps.size,
        {axis: data[axis].values.tolist() for axis in axes_of(data, along)},
        _missing(data, along, at),
        _runner_up(data, target, along, ranked, at),
    )


def _runner_up(
    data: xr.Dataset, target: str, along: list[str], ranked: xr.DataArray, at: dict[str, int]
) -> RunnerUp | None:
    """The next point in the metric's own dimensions: along others, on which bounds may depend, it is the same."""
    own = [dim for dim in map(str, ranked.dims) if dim in data[target].dims]
    free = [dim for dim in ranked.dims if dim not in own]
    ranked = ranked.min(free) if free else ranked
    first = {dim: at[dim] for dim in own}
    beside = ranked.copy()
    beside[first] = np.inf
    feasible = beside < np.inf
    if not bool(feasible.any()):
        return None
    second = _lowest(beside)
    values, use, repeated = repetitions(data, data[target], along)
    values = values.where(use).astype(np.float64)
    swept = {dim: i for dim, i in first.items() if dim in use.dims}
    both = use & use.isel(swept, drop=True)
    mean, half = spans(values - values.isel(first, drop=True), both, repeated)
    # A point that shares no seed with the lowest has no difference, and is not told apart from it.
    tied = feasible & ~(mean - half > 0)
    difference = Interval(float(mean.isel(second)), float(half.isel(second)))
    common = both.sum(repeated).isel({dim: i for dim, i in second.items() if dim in both.dims})
    apart = not bool(tied.isel(second))
    return RunnerUp(_point(data, second), difference, int(common), apart, int(tied.sum()), int(feasible.sum()))


def _missing(data: xr.Dataset, along: list[str], at: dict[str, int]) -> str:
    """What the means at a point lack."""
    flat = 0
    for dim in (dim for dim in grid_dims(data) if dim not in along):
        flat = flat * data.sizes[dim] + at[dim]
    return notes_on(data, along, [flat])[0]


def _lowest(ranked: xr.DataArray) -> dict[str, int]:
    """Position of the lowest value by dimension, the first of equals."""
    index = np.unravel_index(int(np.argmin(ranked.values)), ranked.shape)
    return {str(dim): int(i) for dim, i in zip(ranked.dims, index, strict=True)}


def _point(data: xr.Dataset, at: Mapping[str, int]) -> dict[str, Any]:
    """Value per axis at a position."""
    return {axis: data[axis].values[at[dim]].item() for axis, dim in axes_of(data).items() if dim in at}


def _bound(entry: str, known: Sequence[str]) -> tuple[str, Callable[[Any, Any], Any], float]:
    """`kb<=2.1` taken apart."""
    parts = taken_apart(entry)
    if parts is None or parts[1] not in _COMPARISONS:
        raise InputError(f"--subject-to {entry}: write METRIC<=NUMBER, in quotes, e.g. 'kb<=2.1'")
    name, sign, text = parts
    try:
        number = plain_float(text)
    except ValueError:
        raise InputError(f"--subject-to {entry}: {text!r} is not a number") from None
    return find(name, list(known), "metric"), _COMPARISONS[sign], number


def command(
    config: Mapping[str, Any],
    axes: Collection[str],
    point: Mapping[str, Any],
    over: Mapping[str, Sequence[Any]],
    out: str,
) -> str:
    """The command that reruns one point alone.

    Args:
        config: configuration of the store.
        axes: its axes; a point may hold values on dimensions of outputs beside them.
        point: value per axis.
        over: values of the axes that were averaged over.
        out: store to write.

    Returns:
        One line for a shell; of a halving the point trained to the end, as no command trains it for less.

    Raises:
        InputError: a sweep that no command of this software made.
    """
    if "halving" in config:
        axes = [name for name in axes if name != "steps"]
        point = {name: value for name, value in point.items() if name != "steps"}
    if config["function"].startswith("sweep_file."):
        values = {**{name: [value] for name, value in point.items()}, **over}
        return _run_command(config, {name: items for name, items in values.items() if name in axes}, out)
    what = {"System": "system", "TrainAndJudge": "train"}.get(config["function"].rpartition(".")[2])
    if what is None:
        raise InputError(f"the sweep was made from Python by {config['function']}; no command reruns it")
    values = {
        name: value if isinstance(value, list) else [value]
        for name, value in {**config["settings"], **config.get("notes", {})}.items()
    }
    values |= {name: [value] for name, value in point.items()} | dict(over)
    words = ["ovibjax", "sweep", what]
    for name, items in values.items():
        if items in ([None], ["embedded"]):
            continue
        words += [f"--{name.replace('_', '-')}", *map(_typed, items)]
    return shlex.join([*words, "--out", out])


def _run_command(config: Mapping[str, Any], values: Mapping[str, Sequence[Any]], out: str) -> str:
    """The command for a sweep that a Python file describes; the store knows the file by its name, not its folder."""
    file = config["function"].removeprefix("sweep_file.").rpartition(".")[0]
    # Numbers in full: rounded ones would be other points.
    axes = [f"{name}={','.join(map(str, items))}" for name, items in values.items()]
    return shlex.join(["ovibjax", "sweep", "run", f"{file}.py", "--axis", *axes, "--out", out])


def _typed(value: Any) -> str:
    """A value so that reading it gives the same bits, as the member's own do depend on them."""
    text = text_of(value)
    return repr(value) if isinstance(value, float) and float(text) != value else text

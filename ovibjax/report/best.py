"""The point of a grid with the lowest metric under constraints, as `ovibjax best` prints it."""

import operator
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from ovibjax.errors import InputError
from ovibjax.report.labels import average, axes_of, find, metrics, prepare, text_of

_COMPARISONS: dict[str, Callable[[Any, Any], Any]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "<": operator.lt,
    ">": operator.gt,
}


@dataclass(frozen=True)
class Choice:
    """A chosen point.

    Attributes:
        point: value per axis, the one averaged over excepted.
        means: mean per metric at the point.
        halves: half-width of its 95 % interval, NaN for one value.
        feasible: points that keep the constraints.
        points: points in all.
        over: values of the averaged axis.
    """

    point: dict[str, Any]
    means: dict[str, float]
    halves: dict[str, float]
    feasible: int
    points: int
    over: list[Any]


def choose(dataset: xr.Dataset, minimise: str, subject_to: Sequence[str] = (), over: str = "seed") -> Choice:
    """Minimise the mean of a metric over the grid, where means of other metrics keep their bounds.

    Args:
        dataset: results of a sweep.
        minimise: the metric.
        subject_to: `METRIC<=NUMBER` each, or with >=, < or >.
        over: axis to average over.

    Returns:
        The point; the first of equals in the order of the grid.

    Raises:
        InputError: an unknown metric, a bound of another form, or no point that keeps the bounds.
    """
    known = metrics(dataset)
    target = find(minimise, known, "metric")
    bounds = [_bound(entry, known) for entry in subject_to]
    data, along = prepare(dataset, known, over)
    spans = {name: average(data, data[name], along) for name in known}
    mean, *others = xr.broadcast(spans[target][0], *(spans[name][0] for name, _, _ in bounds))
    keeps = np.isfinite(mean)
    for other, (_, comparison, number) in zip(others, bounds, strict=True):
        keeps = keeps & comparison(other, number)
    if not bool(keeps.any()):
        text = " and ".join(subject_to)
        raise InputError(
            f"no finished point keeps {text}; loosen the bound" if bounds else f"no point has a finite {target}"
        )
    ranked = mean.where(keeps, np.inf)
    at = {
        dim: int(i)
        for dim, i in zip(ranked.dims, np.unravel_index(int(np.argmin(ranked.values)), ranked.shape), strict=True)
    }
    axes = axes_of(data)
    point = {axis: data[axis].values[at[dim]].item() for axis, dim in axes.items() if dim in at and axis in data.coords}

    def at_point(part: xr.DataArray) -> float:
        # What does not depend on an axis that was chosen along is the same everywhere on it.
        where = {dim: i for dim, i in at.items() if dim in part.dims}
        value = part.isel(where)
        return float(value) if value.ndim == 0 else float("nan")

    return Choice(
        point,
        {name: at_point(mean) for name, (mean, _) in spans.items()},
        {name: at_point(half) for name, (_, half) in spans.items()},
        int(keeps.sum()),
        keeps.size,
        data[over].values.tolist() if over in data.coords else [],
    )


def _bound(entry: str, known: Sequence[str]) -> tuple[str, Callable[[Any, Any], Any], float]:
    """`kb<=2.1` taken apart."""
    found = re.fullmatch(r"\s*(\w+)\s*(<=|>=|<|>)\s*(\S+)\s*", entry)
    if found is None:
        raise InputError(f"--subject-to {entry}: write METRIC<=NUMBER, in quotes, e.g. 'kb<=2.1'")
    name, sign, text = found.groups()
    try:
        number = float(text)
    except ValueError:
        raise InputError(f"--subject-to {entry}: {text!r} is not a number") from None
    return find(name, list(known), "metric"), _COMPARISONS[sign], number


def command(config: Mapping[str, Any], point: Mapping[str, Any], over: Mapping[str, Sequence[Any]], out: str) -> str:
    """The command that reruns one point alone.

    Args:
        config: configuration of the store.
        point: value per axis.
        over: values of the axis that was averaged over.
        out: store to write.

    Returns:
        One line for a shell.

    Raises:
        InputError: a sweep that no command of this software made.
    """
    if config["function"].startswith("sweep_file."):
        return _run_command(config, {**{name: [value] for name, value in point.items()}, **over}, out)
    what = {"System": "system", "TrainAndJudge": "train"}.get(config["function"].rpartition(".")[2])
    if what is None:
        raise InputError(f"the sweep was made from Python by {config['function']}; no command reruns it")
    values: dict[str, Sequence[Any]] = {name: axis["values"] for name, axis in config["axes"].items()}
    values |= {name: value if isinstance(value, list) else [value] for name, value in config["settings"].items()}
    values |= {name: [value] for name, value in point.items()} | dict(over)
    words = ["ovibjax", "sweep", what]
    for name, items in values.items():
        if items in ([None], ["embedded"]):
            continue
        words += [f"--{name.replace('_', '-')}", *map(text_of, items)]
    return shlex.join([*words, "--out", out])


def _run_command(config: Mapping[str, Any], values: Mapping[str, Sequence[Any]], out: str) -> str:
    """The command for a sweep that a Python file describes; the store knows the file by its name, not its folder."""
    file = config["function"].removeprefix("sweep_file.").rpartition(".")[0]
    # Numbers in full: rounded ones would be other points.
    axes = [f"{name}={','.join(map(str, items))}" for name, items in values.items() if name in config["axes"]]
    return shlex.join(["ovibjax", "sweep", "run", f"{file}.py", "--axis", *axes, "--out", out])

"""A study: what was measured at the points of a grid, as means with intervals, for readers who look for themselves.

The page draws any metric of a study along any of its axes; here is where its numbers come from: a tidy table, or the
labelled results of a sweep.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr

from ovibjax.errors import InputError
from ovibjax.report.claims import interval
from ovibjax.report.labels import axes_of, grid_dims, metrics, text_of, varying, with_unit
from ovibjax.report.means import SEED, Over, average, counted, laid_out, prepare

MOST_NUMBERS = 120_000
"""Means that a page holds at most; with their half-widths they take some 18 bytes each."""

_LONG = 1000


@dataclass(frozen=True)
class Study:
    """What was measured at the points of a grid.

    Attributes:
        name: unique on its page, letters and digits.
        title: what the reader chooses it by.
        axes: values by axis, in the order in which they are shown; numbers, or texts.
        metrics: label by metric.
        points: [P, axes] int, the place of each point's value on each axis.
        mean: [P] per metric; NaN where there is none.
        half: [P] per metric, half-width of the 95 % interval; NaN where there is none.
        count: [P] members behind a mean.
        over: what there are `count` of behind a mean, `seeds`; empty where it is one measurement.
        start: what is drawn first: `metric`, `x`, `lines`, and values of other axes by name.
        labels: what stands for an axis or for one of its texts, where not itself.
        together: axes that advance together, as those of points drawn from ranges do.
    """

    name: str
    title: str
    axes: Mapping[str, Sequence[Any]]
    metrics: Mapping[str, str]
    points: np.ndarray
    mean: Mapping[str, np.ndarray]
    half: Mapping[str, np.ndarray]
    count: np.ndarray
    over: str = "seeds"
    start: Mapping[str, Any] = field(default_factory=dict)
    labels: Mapping[str, str] = field(default_factory=dict)
    together: Sequence[Sequence[str]] = ()

    def packed(self) -> dict[str, Any]:
        """The same in JSON's types, numbers with five significant digits."""
        return {
            "name": self.name,
            "title": self.title,
            "over": self.over,
            "axes": [
                {
                    "name": name,
                    "label": self.labels.get(name, name),
                    "values": list(values),
                    "texts": [self.labels.get(_text(value), _text(value)) for value in values],
                    "numeric": _is_numeric(values),
                }
                for name, values in self.axes.items()
            ],
            "metrics": [{"name": name, "label": label} for name, label in self.metrics.items()],
            "points": self.points.T.tolist(),
            "mean": {name: _short(values) for name, values in self.mean.items()},
            "half": {name: _short(values) for name, values in self.half.items()},
            "count": self.count.tolist(),
            "start": dict(self.start),
            "together": [list(names) for names in self.together],
        }


@dataclass(frozen=True)
class TableStudy:
    """How a tidy table becomes a study.

    Attributes:
        name: see `Study`.
        title: see `Study`.
        axes: columns that say where a row was measured.
        metrics: label by column that says what was measured.
        repetition: column of independent repetitions; rows that agree in it and in the axes are averaged first. Empty
            where every row is a point.
        half: what the name of the column of a metric's half-width ends in, where the table holds means; then there is
            no repetition.
        start: see `Study`.
        labels: see `Study`.
        optional: axes that the table may lack.
    """

    name: str
    title: str
    axes: tuple[str, ...]
    metrics: Mapping[str, str]
    repetition: str = "seed"
    half: str = ""
    start: Mapping[str, Any] = field(default_factory=dict)
    labels: Mapping[str, str] = field(default_factory=dict)
    optional: tuple[str, ...] = ()

    def study(self, rows: Sequence[Mapping[str, str]]) -> Study:
        """The study of a table.

        Args:
            rows: the table, cells as texts.

        Returns:
            Its study; metrics that the table lacks are left out.

        Raises:
            InputError: the table is empty, lacks an axis or all metrics, or has several rows where there is to be one.
        """
        axes = (*self.axes, *(axis for axis in self.optional if rows and axis in rows[0]))
        lacking = [axis for axis in self.axes if not rows or axis not in rows[0]]
        found = {name: label for name, label in self.metrics.items() if rows and name in rows[0]}
        if lacking or not found:
            raise InputError(f"{self.name}: the table has no column {', '.join(lacking or self.metrics)}")
        values = {axis: _in_order([row[axis] for row in rows]) for axis in axes}
        place = {axis: {_text(value): i for i, value in enumerate(known)} for axis, known in values.items()}
        groups: dict[tuple[int, ...], dict[str, list[Mapping[str, str]]]] = {}
        for row in rows:
            point = tuple(place[axis][_text(_read(row[axis]))] for axis in axes)
            groups.setdefault(point, {}).setdefault(row[self.repetition] if self._repeated else "", []).append(row)
        if not self._repeated and any(len(group[""]) > 1 for group in groups.values()):
            raise InputError(f"{self.name}: the table has several rows for one value of {', '.join(axes)}")
        spans = {name: [self._span(group, name) for group in groups.values()] for name in found}
        return Study(
            self.name,
            self.title,
            values,
            found,
            np.array(list(groups), np.int64).reshape(len(groups), len(axes)),
            {name: np.array([mean for mean, _ in both]) for name, both in spans.items()},
            {name: np.array([half for _, half in both]) for name, both in spans.items()},
            np.array([len(group) for group in groups.values()]),
            f"{self.repetition}s" if self._repeated else "",
            self.start,
            self.labels,
        )

    @property
    def _repeated(self) -> bool:
        return bool(self.repetition) and not self.half

    def _span(self, group: Mapping[str, Sequence[Mapping[str, str]]], metric: str) -> tuple[float, float]:
        """Mean and half-width at one point."""
        numbers = [float(np.mean([_number(row[metric]) for row in rows])) for rows in group.values()]
        if self.half:
            return numbers[0], _number(next(iter(group.values()))[0].get(metric + self.half, ""))
        known = interval([number for number in numbers if math.isfinite(number)])
        return known.mean, known.half if math.isfinite(known.half) else math.nan


def studies_of(dataset: xr.Dataset, over: Over = "seed") -> Iterator[Study]:
    """Studies of a sweep's results: metrics with the same dimensions make one.

    Args:
        dataset: results.
        over: axes to average over.

    Yields:
        The studies, the one with most points first, but for long traces, which come last.

    Raises:
        InputError: there is no number to show, an unknown axis, or more numbers than a page should hold.
    """
    names = metrics(dataset)
    if not names:
        raise InputError("these results hold no number with labelled dimensions; there is nothing to show")
    data, along = prepare(dataset, names, over)
    groups: dict[tuple[str, ...], list[str]] = {}
    for name in names:
        groups.setdefault(tuple(str(dim) for dim in data[name].dims if dim not in along), []).append(name)
    numbers = sum(math.prod(data.sizes[dim] for dim in dims) * len(group) for dims, group in groups.items())
    if numbers > MOST_NUMBERS:
        raise InputError(
            f"{numbers:,} means are too many for a page, which holds {MOST_NUMBERS:,}; choose with --where and "
            "--metric, or average over more axes with --over"
        )

    def rank(entry: tuple[tuple[str, ...], list[str]]) -> tuple[bool, int]:
        points = math.prod(data.sizes[dim] for dim in entry[0])
        return points > _LONG, -points

    for i, (dims, group) in enumerate(sorted(groups.items(), key=rank)):
        yield _study(data, f"sweep{i}", dims, group, along)


def _study(data: xr.Dataset, name: str, dims: Sequence[str], group: Sequence[str], along: Sequence[str]) -> Study:
    """The study of metrics over some dimensions."""
    shape = tuple(data.sizes[dim] for dim in dims)
    places = dict(zip(dims, np.indices(shape).reshape(len(shape), -1), strict=True))
    axes: dict[str, list[Any]] = {}
    points: list[np.ndarray] = []
    for axis, dim in axes_of(data, dims).items():
        values = data[axis].values.tolist()
        place = {value: i for i, value in enumerate(dict.fromkeys(values))}
        axes[axis] = list(place)
        points.append(np.array([place[value] for value in values], np.int64)[places[dim]])
    sharing = [[axis for axis in axes_of(data, [dim]) if varying(data, axis)] for dim in dims]
    spans = {metric: average(data, data[metric], along) for metric in group}
    halves = {metric: laid_out(data, half, dims).values.ravel() for metric, (_, half) in spans.items()}
    first = next((axis for axis in reversed(axes) if len(axes[axis]) > 1 and _is_numeric(axes[axis])), "")
    swept = [str(dim) for dim in grid_dims(data) if dim not in along]
    return Study(
        name,
        ", ".join(group[:3]) + (f" and {len(group) - 3} more" if len(group) > 3 else ""),
        axes,
        {metric: with_unit(data, metric, pretty=True) for metric in group},
        np.stack(points, axis=1) if points else np.zeros((1, 0), np.int64),
        {metric: laid_out(data, mean, dims).values.ravel() for metric, (mean, _) in spans.items()},
        {metric: np.where(np.isfinite(half), half, np.nan) for metric, half in halves.items()},
        np.broadcast_to(_expanded(counted(data, swept, along), len(shape)), shape).ravel(),
        "seeds" if along == [SEED] else "members" if along != ["(one)"] else "",
        {"x": first} if first else {},
        {axis: with_unit(data, axis, pretty=True) for axis in axes},
        [names for names in sharing if len(names) > 1],
    )


def _expanded(counts: np.ndarray, ndim: int) -> np.ndarray:
    """Counts over the dimensions of a sweep, with room for trailing ones."""
    return counts.reshape(*counts.shape, *[1] * (ndim - counts.ndim))


def _in_order(cells: Sequence[str]) -> list[Any]:
    """Different values of a column, numbers by size (what is missing comes last), texts as they come."""
    values = list(dict.fromkeys(map(_read, cells)))
    if _is_numeric(values):
        return sorted(values, key=lambda value: (value is None, value or 0.0))
    return values


def _read(cell: str) -> Any:
    """A cell as a number, a text, or None where it is empty."""
    if not cell:
        return None
    number = _number(cell)
    return number if math.isfinite(number) else cell


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan


def _text(value: Any) -> str:
    return "–" if value is None else text_of(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_numeric(values: Sequence[Any]) -> bool:
    """Whether values are numbers, as far as they are known."""
    return any(map(_is_number, values)) and all(value is None or _is_number(value) for value in values)


def _short(values: np.ndarray) -> list[float | None]:
    """Numbers with five significant digits; None where not finite."""
    return [float(f"{value:.5g}") if math.isfinite(value) else None for value in values.tolist()]

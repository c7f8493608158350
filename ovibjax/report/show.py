"""A sweep's results as a table in the terminal."""

import math
from collections import Counter
from typing import NamedTuple

import numpy as np
import xarray as xr
from rich import box
from rich.table import Table
from rich.text import Text

from ovibjax.errors import InputError
from ovibjax.report.cells import cells
from ovibjax.report.labels import axes_of, find, fixed, grid_dims, labels_of, metrics, numbers_of, varying, with_unit
from ovibjax.report.means import Over, average, lacking, notes_on, over_text, prepare
from ovibjax.report.ranking import Ranking

MAX_METRICS = 9
"""Metrics that a table of all of them sets side by side, those with the fewest trailing points first."""

MAX_COLUMNS = 4
"""Points of trailing dimensions that the table of one metric sets side by side; more become rows."""

_GRID_ORDER = Ranking()


def table(
    dataset: xr.Dataset,
    metric: str | None = None,
    over: Over = "seed",
    max_rows: int = 40,
    ranking: Ranking = _GRID_ORDER,
) -> Table:
    """Means with their 95 % intervals, one row per combination of the axes, the lowest of each column in bold.

    Args:
        dataset: results.
        metric: the metric to show in full; None shows all, each at the last point of its trailing dimensions.
        over: axes to average over; a dataset without `seed` is shown as it is.
        max_rows: rows to show; in the order of the grid, those with a lowest value are always among them.
        ranking: order of the rows, and how many are kept.

    Returns:
        The table, to be printed by rich.

    Raises:
        InputError: an unknown metric or axis, or nothing to show.

    Example:
        >>> from ovibjax import sweep
        >>> made = table(sweep.run(lambda key, point, data: {"cost": point["x"] ** 2}, {"x": [0.5, 2.0]}))
        >>> [[str(cell) for cell in (column.header, *column.cells)] for column in made.columns]
        [['x', '0.5', '2'], ['cost', '0.250', '4.000']]
    """
    names, captions = _metrics_to_show(dataset, metric)
    ranking = ranking.named(dataset, names)
    sort = [ranking.by] if ranking.by is not None and ranking.by in metrics(dataset) else []
    data, along = prepare(dataset, [*names, *sort], over)
    columns, rows, more = _columns(data, names, along, every_point=metric is not None)
    captions += more
    if any(np.isfinite(column.half).any() for column in columns):
        captions.insert(0, f"mean ± half-width of its 95 % interval over {over_text(data, along)}")
    order, said = ranking.order(data, rows, along)
    lows = [_lowest(column.mean) for column in columns]
    if said:
        captions.append(said)
        shown = order[: max(max_rows, ranking.top or 0)].tolist()
    else:
        best = {int(low.argmax()) for low in lows if low.any()}
        rest = (row for row in order.tolist() if row not in best)
        shown = sorted([*best, *rest][: max(max_rows, len(best))])
    if any(low[shown].any() for low in lows):
        captions.append("lowest in bold")
    captions += _left_out(dataset, len(shown), len(lows[0]))
    return _drawn(data, columns, (rows, along), shown, lows, captions)


def _left_out(dataset: xr.Dataset, shown: int, rows: int) -> list[str]:
    """What to say of rows and variables that are not in the table."""
    captions = []
    if shown < rows:
        captions.append(f"{shown} of {rows} rows, narrow down with --where AXIS=VALUE")
    if hidden := sorted(set(numbers_of(dataset)) - set(metrics(dataset))):
        groups = Counter(name.split(".")[0] + ".*" if "." in name else name for name in hidden)
        captions.append(f"(not shown: {', '.join(f'{key} ({n})' if n > 1 else key for key, n in groups.items())})")
    return captions


def _metrics_to_show(dataset: xr.Dataset, metric: str | None) -> tuple[list[str], list[str]]:
    """Names of the metric asked for, or of as many as fit side by side, and what to say of the others."""
    names = metrics(dataset) if metric is None else [find(metric, metrics(dataset), "metric")]
    if not names:
        raise InputError("these results hold no number with labelled dimensions; there is nothing to show")
    if len(names) <= MAX_METRICS:
        return names, []
    ranked = sorted(names, key=lambda name: dataset[name].size)
    kept = [name for name in names if name in ranked[:MAX_METRICS]]
    return kept, [f"also: {', '.join(name for name in names if name not in kept)}; see one with --metric NAME"]


class _Column(NamedTuple):
    """One column of a table.

    Attributes:
        head: metric with its unit, and the point of its trailing dimensions.
        mean: [rows] mean over the averaged axes.
        half: [rows] half-width of its 95 % interval.
    """

    head: str
    mean: np.ndarray
    half: np.ndarray


def _columns(
    data: xr.Dataset, names: list[str], along: list[str], every_point: bool
) -> tuple[list[_Column], list[str], list[str]]:
    """Columns of a table, the dimensions of its rows, and what to say of points that are left out."""
    columns: list[_Column] = []
    captions: list[str] = []
    grid = rows = [dim for dim in grid_dims(data) if dim not in along]
    for name in names:
        values = data[name]
        trailing = [str(dim) for dim in values.dims if dim not in (*grid, *along)]
        points = math.prod(values.sizes[dim] for dim in trailing)
        if points > 1 and not every_point:
            values = values.isel({dim: [-1] for dim in trailing})
            captions.append(f"--metric {name} for every {' and '.join(axes_of(data, trailing))}")
        elif points > MAX_COLUMNS:
            rows, trailing = [*grid, *trailing], []
        mean, half = (part.transpose(*rows, *trailing) for part in average(data, values, along))
        for i, place in enumerate(labels_of(mean, trailing)):
            head = "\n".join([with_unit(data, name), *place])
            points = math.prod(mean.sizes[dim] for dim in rows)
            columns.append(_Column(head, mean.values.reshape(points, -1)[:, i], half.values.reshape(points, -1)[:, i]))
    return columns, rows, captions


# What a table is made of, found by `table` step by step; a class of it would only rename the steps.
def _drawn(
    data: xr.Dataset,
    columns: list[_Column],
    dims: tuple[list[str], list[str]],
    shown: list[int],
    lows: list[np.ndarray],
    captions: list[str],
) -> Table:
    """The table of some rows; `dims` are those of the rows and those averaged over."""
    rows, along = dims
    made = Table(title=Text(fixed(data, rows)), caption=Text("; ".join(captions)), box=box.SIMPLE_HEAD)
    axes = axes_of(data, rows)
    several = [i for i, axis in enumerate(axes) if varying(data, axis)]
    for head in (*(with_unit(data, list(axes)[i]) for i in several), *(column.head for column in columns)):
        made.add_column(Text(head), justify="right")
    flawed = any(bool(flag.any()) for flag in lacking(data).values())
    if flawed:
        made.add_column("note")
    keys = labels_of(data, rows, named=False, at=shown)
    # Trailing dimensions that became rows are the fastest; what is missing does not depend on them.
    trailing = math.prod(data.sizes[dim] for dim in rows if dim not in grid_dims(data))
    notes = notes_on(data, along, [row // trailing for row in shown]) if flawed else [""] * len(shown)
    texts = [cells(column.mean, column.half, shown) for column in columns]
    for place, row in enumerate(shown):
        line = [Text(keys[place][i]) for i in several]
        line += [Text(text[place], "bold" if low[row] else "") for text, low in zip(texts, lows, strict=True)]
        made.add_row(*line, *([Text(notes[place])] if flawed else []))
    return made


def _lowest(mean: np.ndarray) -> np.ndarray:
    """Marks the lowest of a column [rows]; nothing where all are equal or there is only one."""
    known = mean[np.isfinite(mean)]
    if known.size < 2 or known.min() == known.max():
        return np.zeros(mean.shape, bool)
    return np.asarray(mean == known.min())

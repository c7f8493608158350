"""A sweep's results as a table in the terminal or a CSV file."""

import math
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr
from rich import box
from rich.table import Table
from rich.text import Text

from ovibjax.errors import InputError
from ovibjax.report.claims import Interval
from ovibjax.report.labels import (
    average,
    axes_of,
    find,
    fixed,
    grid_dims,
    labels_of,
    metrics,
    notes_on,
    numbers_of,
    prepare,
    with_unit,
)

MAX_METRICS = 9
"""Metrics that a table of all of them sets side by side, those with the fewest trailing points first."""

MAX_COLUMNS = 4
"""Points of trailing dimensions that the table of one metric sets side by side; more become rows."""


def table(dataset: xr.Dataset, metric: str | None = None, over: str = "seed", max_rows: int = 40) -> Table:
    """Means with their 95 % intervals, one row per combination of the axes, the lowest of each column in bold.

    Args:
        dataset: results.
        metric: the metric to show in full; None shows all, each at the last point of its trailing dimensions.
        over: axis to average over; a dataset without `seed` is shown as it is.
        max_rows: rows to show; those with a lowest value are always among them.

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
    data, along = prepare(dataset, names, over)
    columns, rows, more = _columns(data, names, along, every_point=metric is not None)
    captions += more
    if any(np.isfinite(column.half).any() for column in columns):
        captions.insert(0, f"mean ± half-width of its 95 % interval over {data.sizes[along]} values of {over}")

    keys, notes = labels_of(data, rows, named=False), notes_on(data, along)
    lows = [_lowest(column.mean) for column in columns]
    best = {int(low.argmax()) for low in lows if low.any()}
    shown = sorted([*best, *(row for row in range(len(keys)) if row not in best)][: max(max_rows, len(best))])
    if best:
        captions.append("lowest in bold")
    if len(shown) < len(keys):
        captions.append(f"{len(shown)} of {len(keys)} rows, narrow down with --where AXIS=VALUE")
    if hidden := sorted(set(numbers_of(dataset)) - set(metrics(dataset))):
        groups = Counter(name.split(".")[0] + ".*" if "." in name else name for name in hidden)
        captions.append(f"(not shown: {', '.join(f'{key} ({n})' if n > 1 else key for key, n in groups.items())})")

    made = Table(title=Text(fixed(data, rows)), caption=Text("; ".join(captions)), box=box.SIMPLE_HEAD)
    axes = axes_of(data, rows)
    varying = [i for i, dim in enumerate(axes.values()) if data.sizes[dim] > 1]
    for head in (*(with_unit(data, list(axes)[i]) for i in varying), *(column.head for column in columns)):
        made.add_column(Text(head), justify="right")
    if any(notes):
        made.add_column("note")
    cells = [_cells(column.mean, column.half) for column in columns]
    for row in shown:
        line = [Text(keys[row][i]) for i in varying]
        line += [Text(text[row], "bold" if low[row] else "") for text, low in zip(cells, lows, strict=True)]
        made.add_row(*line, *([Text(notes[row * len(notes) // len(keys)])] if any(notes) else []))
    return made


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
        mean: [rows] mean over the averaged axis.
        half: [rows] half-width of its 95 % interval.
    """

    head: str
    mean: np.ndarray
    half: np.ndarray


def _columns(
    data: xr.Dataset, names: list[str], along: str, every_point: bool
) -> tuple[list[_Column], list[str], list[str]]:
    """Columns of a table, the dimensions of its rows, and what to say of points that are left out."""
    columns: list[_Column] = []
    captions: list[str] = []
    grid = rows = [dim for dim in grid_dims(data) if dim != along]
    for name in names:
        values = data[name]
        trailing = [str(dim) for dim in values.dims if dim not in (*grid, along)]
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


def write_csv(dataset: xr.Dataset, path: Path) -> None:
    """Write one row per finished member and point of the trailing dimensions.

    Columns are the axes, the trailing coordinates, the metrics and `diverged`. A metric is repeated along trailing
    dimensions that it lacks; metrics whose trailing dimensions differ (prefix, epoch) have rows of their own, empty
    elsewhere.

    Args:
        dataset: results.
        path: CSV file to write.

    Raises:
        InputError: the file cannot be written.
    """
    names, grid = metrics(dataset), grid_dims(dataset)
    trailing = {name: [str(dim) for dim in dataset[name].dims if dim not in grid] for name in names}
    spans = {frozenset(dims): dims for dims in trailing.values()} or {frozenset(): []}
    blocks = [dims for span, dims in spans.items() if not any(span < other for other in spans)]
    used = [*grid, *dict.fromkeys(dim for dims in blocks for dim in dims)]
    columns = [*axes_of(dataset, used), *names, "diverged"]
    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            for i, dims in enumerate(blocks):
                inside = [name for name in names if set(trailing[name]) <= set(dims)]
                frame = dataset[[*inside, "finished", "diverged"]].to_dataframe([*grid, *dims]).reset_index()
                frame[frame["finished"]].reindex(columns=columns).to_csv(file, index=False, header=i == 0)
    except OSError as error:
        raise InputError(f"{path}: cannot write there ({error.strerror}); choose another file") from error


def _cells(mean: np.ndarray, half: np.ndarray) -> list[str]:
    """Text of one column [rows]: two digits of the typical half-width, or four of the typical value."""
    halves, sizes = half[np.isfinite(half) & (half > 0)], np.abs(mean[np.isfinite(mean) & (mean != 0)])
    digits = 0
    if halves.size:
        digits = 1 - math.floor(math.log10(np.median(halves)))
    elif sizes.size and (sizes % 1).any():
        digits = 3 - math.floor(math.log10(np.median(sizes)))
    # Columns over many decades, or far from one, are written number by number.
    fixed = digits <= 6 and (not sizes.size or (sizes.max() < 1e7 and sizes.min() >= 10.0 ** min(1 - digits, 0)))
    cells = []
    for m, h in zip(mean, half, strict=True):
        spread = f" ± {h:.2g}" if math.isfinite(h) else ""
        text = Interval(m, h).text(digits=max(digits, 0)) if fixed else f"{m:.4g}{spread}"
        cells.append(text if math.isfinite(m) else "-")
    return cells


def _lowest(mean: np.ndarray) -> np.ndarray:
    """Marks the lowest of a column [rows]; nothing where all are equal or there is only one."""
    known = mean[np.isfinite(mean)]
    if known.size < 2 or known.min() == known.max():
        return np.zeros(mean.shape, bool)
    return np.asarray(mean == known.min())

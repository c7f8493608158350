"""A sweep's results over two axes: a heat map with the values in its cells, and its holes shown as such."""

import math
import textwrap
from collections.abc import Sequence
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ovibjax.errors import InputError
from ovibjax.report import figures as fig
from ovibjax.report.cells import SPREAD, cells
from ovibjax.report.labels import text_of, with_unit
from ovibjax.report.means import Over, average, counted, laid_out, over_text
from ovibjax.report.panels import heat
from ovibjax.report.plot_choice import Chosen, choose_drawn
from ovibjax.report.scales import LOG_SPAN

COLOURS = "cividis"
"""Runs from dark blue to yellow for every eye, and in grey."""

_LARGEST_PT, _SMALLEST_PT = 6.5, 5.0
_BESIDE_IN = 1.15
"""Width beside the panel: labels of the ordinate and the colour bar."""


def heat_figure(dataset: xr.Dataset, x: str, y: str, metric: str | None = None, over: Over = "seed") -> Figure:
    """A metric over two axes; in every cell its mean, the half-width of its 95 % interval, and how many it lacks.

    Colours are logarithmic where positive means span a factor of 30. A cell without a mean is hatched; `3/5` in a cell
    says that three of five members count. The intervals are left out where they would not be readable, then the figure
    becomes a page wide, then the numbers are left out.

    Args:
        dataset: results.
        x: axis along the abscissa.
        y: axis along the ordinate.
        metric: the metric; may be left out where only one depends on `x`.
        over: axes to average over.

    Returns:
        The figure, one column wide unless the values need more.

    Raises:
        InputError: an unknown metric or axis, axes that exclude each other, an axis with several values left over, or
            nothing to draw.
    """
    chosen = choose_drawn(dataset, (("plot", x), ("plot", y)), metric, over)
    data, order = chosen.data, chosen.dims[::-1]
    mean, half = (laid_out(data, part, order).values for part in average(data, data[chosen.metric], chosen.along))
    if not np.isfinite(mean).any():
        raise InputError(f"{chosen.metric}: no finished member has a finite value; there is nothing to draw")
    columns, rows = _in_order(data[x].values), _in_order(data[y].values)
    at = np.ix_(rows, columns)
    mean, half, count = mean[at], half[at], counted(data, order, chosen.along)[at]
    total = int(np.prod([data.sizes[dim] for dim in chosen.along]))
    look = _look(*(_texts(mean, half, count, total, spread) for spread in (True, False)))
    with mpl.rc_context(fig.style()):
        height_in = min(8.0, max(1.2, look.row_in * len(rows)) + 1.0)
        figure, (ax,) = fig.panels(1, width_in=look.width_in, height_in=height_in)
        _cells_of(ax, mean, look)
        _ticks(ax, _short(data[x].values[columns]))
        ax.set_yticks(*_thinned(_short(data[y].values[rows]), 24))
        if data[y].dtype.kind in "fiu":
            ax.invert_yaxis()  # numbers grow upwards, names stand from the top
        ax.set(xlabel=with_unit(data, x, pretty=True), ylabel=with_unit(data, y, pretty=True))
        bar = figure.colorbar(ax.images[0], ax=ax, pad=0.02, label=with_unit(data, chosen.metric, pretty=True))
        bar.outline.set_linewidth(0.5)
        if isinstance(ax.images[0].norm, LogNorm):
            fig.plain_log_ticks(bar.ax.yaxis)
        caption = _caption(chosen, look, bool(np.isfinite(half).any()))
        figure.suptitle(caption, x=0.01, ha="left", fontsize=6.5, color="0.35")
    return figure


class _Look(NamedTuple):
    """How the cells are written.

    Attributes:
        texts: [rows][columns] what they say; empty where there is no room.
        size_pt: of the type.
        width_in: of the figure.
        row_in: height of a row.
        spread: whether the texts hold intervals.
    """

    texts: list[list[str]]
    size_pt: float
    width_in: float
    row_in: float
    spread: bool


def _look(whole: list[list[str]], short: list[list[str]]) -> _Look:
    """The first way of writing that can be read: with intervals, without, a page wide, not at all."""
    for texts, width_in in ((whole, fig.COLUMN_IN), (short, fig.COLUMN_IN), (short, fig.PAGE_IN)):
        lines = [line for row in texts for cell in row for line in cell.split("\n")]
        # A character is 0.6 of the type's size wide; a tenth of the cell stays free.
        cell_in = (width_in - _BESIDE_IN) / len(texts[0])
        size_pt = min(_LARGEST_PT, 0.9 * 72 * cell_in / (0.6 * max(map(len, lines))))
        if size_pt >= _SMALLEST_PT:
            most = max(cell.count("\n") + 1 for row in texts for cell in row)
            return _Look(texts, size_pt, width_in, most * 1.3 * size_pt / 72 + 0.06, texts is whole)
    return _Look([[""] * len(row) for row in short], _SMALLEST_PT, fig.COLUMN_IN, 0.05, False)


def _texts(mean: np.ndarray, half: np.ndarray, count: np.ndarray, total: int, spread: bool) -> list[list[str]]:
    """[rows][columns] what the cells say: mean, half-width if wanted, and how many count where some are missing."""
    flat = [text.replace(SPREAD, "\n±") for text in cells(mean.ravel(), half.ravel())]
    flat = flat if spread else [text.partition("\n")[0] for text in flat]
    flat = [
        f"{text}\n{n}/{total}" if 0 < n < total else text for text, n in zip(flat, count.ravel().tolist(), strict=True)
    ]
    columns = mean.shape[1]
    return [flat[i : i + columns] for i in range(0, len(flat), columns)]


def _cells_of(ax: Axes, mean: np.ndarray, look: _Look) -> None:
    """Colours and texts; holes hatched."""
    known = mean[np.isfinite(mean)]
    log = bool(known.min() > 0 and known.max() >= LOG_SPAN * known.min())
    heat(ax, mean, look.texts, COLOURS, (LogNorm if log else Normalize)(known.min(), known.max()), look.size_pt)
    for row, column in np.argwhere(~np.isfinite(mean)).tolist():
        ax.add_patch(Rectangle((column - 0.5, row - 0.5), 1, 1, fill=False, hatch="////", edgecolor="0.8", lw=0))


def _ticks(ax: Axes, texts: Sequence[str]) -> None:
    """Ticks of the abscissa, slanted where they are long."""
    places, shown = _thinned(texts, 24)
    steep = sum(len(text) + 2 for text in shown) > 45
    ax.set_xticks(places, shown, rotation=30 if steep else 0, ha="right" if steep else "center")


def _short(values: np.ndarray) -> list[str]:
    """Values of an axis for its ticks: three digits where they tell the values apart."""
    texts = [f"{value:.3g}" if isinstance(value, np.floating) else text_of(value) for value in values]
    return texts if len(set(texts)) == len(texts) else [text_of(value) for value in values]


def _thinned(texts: Sequence[str], most: int) -> tuple[list[int], list[str]]:
    """Places and texts of ticks, every second, third ... where there are too many."""
    step = math.ceil(len(texts) / most)
    return list(range(0, len(texts), step)), list(texts[::step])


def _in_order(values: np.ndarray) -> np.ndarray:
    """Positions of an axis' values: numbers by size, names as they are."""
    return np.argsort(values, kind="stable") if values.dtype.kind in "fiu" else np.arange(len(values))


def _caption(chosen: Chosen, look: _Look, intervals: bool) -> str:
    text = chosen.caption(intervals and look.spread)
    if intervals and not look.spread:
        text = "; ".join(filter(None, [f"means over {over_text(chosen.data, chosen.along)}", text]))
    return textwrap.fill(text, 66 if look.width_in < fig.PAGE_IN else 140)

"""Panels that recur in the figures: bars with the paper's tick, grouped columns, heat maps, distributions."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from string import ascii_lowercase
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize

from ovibjax.report.claims import Interval
from ovibjax.report.figures import FEWEST_SEEDS, RED, YELLOW, mean_and_half, panels, save_figure, style, title

_CAPS = {"lw": 1, "capsize": 2}

Panel = Callable[[Axes, Any], None]
"""What draws into a panel what was found."""


@contextmanager
def sheet(path: Path, columns: int, rows: int = 1, height_in: float = 2.1) -> Iterator[list[Axes]]:
    """A figure of several panels, written when the block ends.

    Args:
        path: the PNG to write.
        columns: panels side by side.
        rows: panels above one another.
        height_in: height of a row, inches.

    Yields:
        The panels in reading order.
    """
    with mpl.rc_context(style()):
        figure, axes = panels(columns, rows, height_in=height_in)
        yield axes
        save_figure(figure, path)


def draw_panels(path: Path, found: Any, titled: Mapping[str, Panel], columns: int, height_in: float = 2.1) -> None:
    """A figure of titled panels, each drawn by a function.

    Args:
        path: the PNG to write.
        found: what the panels show.
        titled: what draws a panel, by its title, in reading order.
        columns: panels side by side.
        height_in: height of a row, inches.
    """
    with sheet(path, columns, -(-len(titled) // columns), height_in) as axes:
        for ax, letter, (text, draw) in zip(axes, ascii_lowercase, titled.items(), strict=False):
            draw(ax, found)
            title(ax, letter, text)
        for ax in axes[len(titled) :]:
            ax.set_axis_off()


@dataclass(frozen=True)
class Bar:
    """One row of `bars`.

    Attributes:
        label: beside the axis.
        value: mean and interval; without a width no cap is drawn.
        colour: of the bar.
        paper: the paper's value, a black tick.
        text: what stands at the bar; nothing if empty.
    """

    label: str
    value: Interval
    colour: str
    paper: float | None = None
    text: str = ""


def bars(ax: Axes, rows: Sequence[Bar], inside: bool = False, height: float = 0.62) -> None:
    """Horizontal bars with 95 % intervals and the paper's values as ticks, from the top.

    Args:
        ax: the panel.
        rows: the bars.
        inside: whether the texts stand in the bars, in white; otherwise to the right of bar, cap and tick.
        height: of a bar, in rows.
    """
    for row, bar in enumerate(rows):
        value = bar.value
        ax.barh(row, value.mean, xerr=value.cap or None, height=height, color=bar.colour, error_kw=_CAPS)
        if bar.paper is not None:
            paper_tick(ax, bar.paper, row, 18.0 * height)
        if bar.text and inside:
            ink = "black" if bar.colour == YELLOW else "white"
            ax.text(0.03 * value.mean, row, bar.text, va="center", fontsize=6.5, color=ink, weight="bold")
        elif bar.text:
            end = max(value.mean + value.cap, bar.paper or 0.0)
            ax.annotate(bar.text, (end, row), (4, 0), textcoords="offset points", va="center", fontsize=6.5)
    if any(bar.paper is not None for bar in rows):
        ax.plot([], [], "|", ms=8, mew=1.6, color="black", label="paper")
    category_axis(ax, [bar.label for bar in rows])


def paper_tick(ax: Axes, x: float, row: float, size: float = 11.0) -> None:
    """The paper's value at a horizontal bar: a black upright tick."""
    ax.plot(x, row, "|", ms=size, mew=1.6, color="black", zorder=5)


def category_axis(ax: Axes, labels: Sequence[str]) -> None:
    """Named rows from the top, without grid lines between them."""
    ax.set_yticks(range(len(labels)), list(labels))
    ax.invert_yaxis()
    ax.grid(visible=False, axis="y")


def columns(ax: Axes, groups: Sequence[str], series: Sequence[tuple[str, str, Sequence[Interval]]]) -> np.ndarray:
    """Upright bars side by side within named groups, with 95 % intervals.

    Args:
        ax: the panel.
        groups: names of the G groups.
        series: label, colour and G values each.

    Returns:
        [series, G] where the bars stand.
    """
    width = 0.8 / len(series)
    offsets = (np.arange(len(series)) - (len(series) - 1) / 2) * width
    places = offsets[:, None] + np.arange(len(groups))
    for x, (label, colour, values) in zip(places, series, strict=True):
        means, caps = [value.mean for value in values], [value.cap for value in values]
        ax.bar(x, means, 0.92 * width, yerr=caps if any(caps) else None, color=colour, label=label, error_kw=_CAPS)
    ax.set_xticks(range(len(groups)), list(groups))
    ax.grid(visible=False, axis="x")
    return places


def heat(
    ax: Axes,
    shade: np.ndarray,
    texts: Sequence[Sequence[str]],
    cmap: str,
    limits: tuple[float, float] | Normalize,
    size_pt: float = 6.5,
) -> None:
    """A table whose cells are shaded by a number and hold a text; white where the shade is dark.

    Args:
        ax: the panel; tick labels are the caller's.
        shade: [R, C] numbers; a cell stays white where it is not a number.
        texts: [R][C] what the cells say.
        cmap: a colour map of matplotlib.
        limits: numbers at its two ends, or a norm of matplotlib.
        size_pt: size of the texts.
    """
    norm = limits if isinstance(limits, Normalize) else Normalize(*limits)
    image = ax.imshow(np.ma.masked_invalid(shade), cmap=cmap, aspect="auto", norm=norm)
    for row, column in np.ndindex(*shade.shape):
        known = bool(np.isfinite(shade[row, column]))
        red, green, blue, _ = image.cmap(image.norm(shade[row, column])) if known else (1.0, 1.0, 1.0, 1.0)
        dark = 0.299 * red + 0.587 * green + 0.114 * blue < 0.5
        colour = "white" if dark else "black"
        ax.text(column, row, texts[row][column], ha="center", va="center", fontsize=size_pt, color=colour)
    ax.tick_params(length=0)
    ax.grid(visible=False)


def distribution(ax: Axes, x: np.ndarray, shares: np.ndarray, colour: str, label: str, line: str = "-") -> None:
    """A cumulative distribution with its 95 % interval as a band, or with few repetitions as thin lines.

    Args:
        ax: the panel.
        x: [P] abscissa.
        shares: [repetitions, P] share of values at most x.
        colour: line colour.
        label: legend entry.
        line: line style.
    """
    mean, half = mean_and_half(shares)
    if 1 < len(shares) < FEWEST_SEEDS:
        ax.plot(x, shares.T, color=colour, alpha=0.35, lw=0.5)
    else:
        ax.fill_between(x, np.maximum(mean - half, 0), np.minimum(mean + half, 1), color=colour, alpha=0.15, lw=0)
    ax.plot(x, mean, line, color=colour, label=label)


def star(ax: Axes, x: float, y: float, label: str = "", colour: str = RED) -> None:
    """The point that was selected."""
    ax.plot(x, y, "*", ms=11, color=colour, zorder=5, label=label or None)


def headroom(ax: Axes, factor: float) -> None:
    """Raise the upper end of the y axis by a factor, as room for a legend."""
    ax.set_ylim(top=factor * ax.get_ylim()[1])

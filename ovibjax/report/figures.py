"""One look for all figures: column width, type sizes, colour-blind-safe colours (Okabe and Ito)."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from ovibjax.report.claims import interval

FEWEST_SEEDS = 4
"""Below this many an interval is so wide that it hides the curves: the seeds are drawn instead."""

COLUMN_IN, PAGE_IN = 3.5, 7.16
"""Widths of one column and of the page in a two-column paper, inches."""

BLUE, ORANGE, GREEN, RED, PURPLE, SKY, YELLOW, GREY = (
    *("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#F0E442", "#7F7F7F"),
)

DARK_RED = "#8B2500"
"""A variant of what is red."""

_STYLE = {
    "font.size": 7.5,
    "axes.titlesize": 8,
    "axes.labelsize": 7.5,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 6.5,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "lines.linewidth": 1.4,
    "grid.linewidth": 0.4,
    "grid.alpha": 0.35,
    "axes.grid": True,
    "axes.axisbelow": True,
    "savefig.dpi": 220,
}


def style() -> Any:
    """Matplotlib settings, for `with matplotlib.rc_context(style())`."""
    return dict(_STYLE)


def panels(columns: int, rows: int = 1, width_in: float = PAGE_IN, height_in: float = 2.1) -> tuple[Figure, list[Axes]]:
    """A figure with a grid of panels labelled (a), (b), ... in reading order."""
    with mpl.rc_context(style()):
        figure = Figure(figsize=(width_in, height_in * rows), layout="constrained")
        FigureCanvasAgg(figure)
        axes = list(figure.subplots(rows, columns, squeeze=False).ravel())
    return figure, axes


def title(axes: Axes, letter: str, text: str) -> None:
    """Panel title: a bold letter, and the message."""
    axes.set_title(rf"$\bf{{({letter})}}$ {text}", loc="left")


def save_figure(figure: Figure, path: Path) -> None:
    """Write a PNG."""
    with mpl.rc_context(style()):
        figure.savefig(path, dpi=220)


def mean_and_half(curves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean over seeds and half-width of its 95 % interval, both [P], of curves [seeds, P]; zero for one seed."""
    spans = [interval(column) for column in curves.T]
    half = np.array([span.half if np.isfinite(span.half) else 0.0 for span in spans])
    return np.array([span.mean for span in spans]), half


def band(
    ax: Axes, x: np.ndarray, curves: np.ndarray, colour: str, label: str, style: str = "-", marker: str = ""
) -> None:
    """Mean curve over seeds with its 95 % interval as a band; with the seeds as thin lines where they are few.

    Args:
        ax: the panel.
        x: [P] abscissa.
        curves: [seeds, P] positive values.
        colour: line colour.
        label: legend entry.
        style: line style.
        marker: marker, none by default.
    """
    mean, half = mean_and_half(curves)
    if 1 < len(curves) < FEWEST_SEEDS:
        ax.plot(x, curves.T, color=colour, alpha=0.35, lw=0.5)
    else:
        # On a logarithmic axis an interval that reaches zero would swallow the panel.
        ax.fill_between(x, np.maximum(mean - half, 0.3 * mean), mean + half, color=colour, alpha=0.18, lw=0)
    ax.plot(x, mean, style, color=colour, label=label, marker=marker, ms=3)


def spread(repetitions: int, what: str = "seeds") -> str:
    """What a caption says of `band`: bands are intervals, or thin lines single seeds where they are few."""
    if repetitions < FEWEST_SEEDS:
        return f"Thin lines are the {repetitions} {what}, caps their 95 % intervals"
    return f"Bands and caps are 95 % intervals over {repetitions} {what}"


def error_boxes(ax: Axes, groups: Sequence[tuple[str, str, np.ndarray]]) -> None:
    """Horizontal boxes of per-frame errors on a logarithmic axis.

    Args:
        ax: the panel.
        groups: (label, colour, errors) per row, from the top.
    """
    for row, (_, colour, errors) in enumerate(groups):
        low, q1, median, q3, p90, high = np.percentile(errors, [5, 25, 50, 75, 90, 95])
        ax.plot([low, high], [row, row], color=colour, lw=1)
        ax.barh(row, q3 - q1, left=q1, height=0.55, color=colour, alpha=0.45)
        ax.plot([median, median], [row - 0.27, row + 0.27], color=colour, lw=1.4)
        ax.plot([p90, p90], [row - 0.36, row + 0.36], color="#C00000", lw=1.6)
        ax.plot(errors.mean(), row, "D", ms=4, color="black", mfc="white", mew=0.9)
    ax.set_yticks(range(len(groups)), [label for label, _, _ in groups])
    ax.set_xscale("log")
    ax.invert_yaxis()
    ax.grid(visible=False, axis="y")
    plain_log_ticks(ax.xaxis)


def plain_log_ticks(axis: Axis, subs: tuple[float, ...] = (1.0, 2.0, 5.0)) -> None:
    """Ticks at these multiples of powers of ten, written as plain numbers."""
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())

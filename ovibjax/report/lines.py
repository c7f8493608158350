"""A sweep's results as lines over one axis, or as points where others change with it; 95 % intervals over seeds."""

import textwrap
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ovibjax.errors import InputError
from ovibjax.report import figures as fig
from ovibjax.report.labels import advances_together, text_of, with_unit
from ovibjax.report.means import Over, average, laid_out
from ovibjax.report.plot_choice import choose_drawn
from ovibjax.report.scales import LOG_SPAN, scale_to

_COLOURS = (fig.BLUE, fig.ORANGE, fig.GREEN, fig.RED, fig.PURPLE, fig.SKY, fig.GREY)
_MARKERS = "osD^vPX"


def line_figure(
    dataset: xr.Dataset, x: str, metric: str | None = None, hue: str | None = None, over: Over = "seed"
) -> Figure:
    """A metric along an axis with its 95 % interval: lines with bands over numbers, points with bars over names.

    Where other axes advance together with it, as in a search, numbers are points with bars too: no path joins them.

    The axis is logarithmic where positive values span a factor of 30 (not where they are evenly spaced); a zero then
    stands on a linear piece at its left.

    Args:
        dataset: results.
        x: axis along the abscissa.
        metric: the metric; may be left out where only one depends on `x`.
        hue: axis that gives one line per value.
        over: axes to average over.

    Returns:
        The figure, one column wide.

    Raises:
        InputError: an unknown metric or axis, axes that exclude each other, an axis with several values left over, or
            nothing to draw.
    """
    chosen = choose_drawn(dataset, (("plot", x), *((("hue", hue),) if hue is not None else ())), metric, over)
    data, name, order = chosen.data, chosen.metric, chosen.dims[::-1]
    if hue is not None and data.sizes[order[0]] > len(_COLOURS):
        raise InputError(
            f"--hue {hue}: {data.sizes[order[0]]} lines are too many to tell apart; choose up to {len(_COLOURS)} with "
            f"--where {hue}={','.join(map(text_of, data[hue].values[:2]))},... or draw a heat map with --plot {x} {hue}"
        )
    means, halves = (
        np.atleast_2d(laid_out(data, part, order).values) for part in average(data, data[name], chosen.along)
    )
    if not np.isfinite(means).any():
        raise InputError(f"{name}: no finished member has a finite value; there is nothing to draw")
    values = data[x].values
    with mpl.rc_context(fig.style()):
        figure, (ax,) = fig.panels(1, width_in=fig.COLUMN_IN, height_in=2.3)
        log = bool((means[np.isfinite(means)] > 0).all() and np.nanmax(means) >= LOG_SPAN * np.nanmin(means))
        labels = [text_of(value) for value in data[hue].values] if hue else [name]
        labels = [text if np.isfinite(row).any() else f"{text} (none)" for text, row in zip(labels, means, strict=True)]
        draw = _points if values.dtype.kind not in "fiu" else _scattered if advances_together(data, x) else _lines
        draw(ax, values, means, halves, labels, log)
        ax.set(xlabel=with_unit(data, x, pretty=True), ylabel=with_unit(data, name, pretty=True))
        if log:
            ax.set_yscale("log")
            if np.nanmax(means) < 1e3 * np.nanmin(means):
                fig.plain_log_ticks(ax.yaxis)
        if hue:
            columns = len(labels) if sum(map(len, labels)) + 5 * len(labels) < 60 else 3
            look: dict[str, Any] = {"handlelength": 1.8, "columnspacing": 1.2, "title_fontsize": 6.5}
            title = with_unit(data, hue, pretty=True)
            figure.legend(loc="outside upper center", ncols=columns, title=title, **look)
        caption = textwrap.fill(chosen.caption(bool(np.isfinite(halves).any())), 66)
        ax.set_title(caption, loc="left", fontsize=6.5, color="0.35")
    return figure


def _lines(ax: Axes, x: np.ndarray, means: np.ndarray, halves: np.ndarray, labels: list[str], log: bool) -> None:
    """One line per row of `means` [lines, P] with its band; NaN leaves a gap."""
    order = np.argsort(x)
    x = x[order].astype(np.float64)
    for i, (mean, half, label) in enumerate(zip(means[:, order], halves[:, order], labels, strict=True)):
        marker, dash = (_MARKERS[i], "-") if len(x) <= 20 else ("", ("-", "--", "-.", ":")[i % 4])
        ax.plot(x, mean, dash, color=_COLOURS[i], marker=marker, ms=3.2, label=label)
        # On a logarithmic axis an interval that reaches zero would swallow the panel.
        low = np.maximum(mean - half, 0.3 * mean) if log else mean - half
        ax.fill_between(x, low, mean + half, where=np.isfinite(half), color=_COLOURS[i], alpha=0.18, lw=0)
    scale_to(ax, "x", x, at_values=len(x) <= 10)


def _scattered(ax: Axes, x: np.ndarray, means: np.ndarray, halves: np.ndarray, labels: list[str], log: bool) -> None:
    """Points with bars at numbers, per row of `means` [lines, P]."""
    for i, (mean, half, label) in enumerate(zip(means, halves, labels, strict=True)):
        up = np.where(np.isfinite(half), half, 0.0)
        down = np.minimum(up, 0.7 * np.abs(mean)) if log else up
        look: dict[str, Any] = {"ms": 3.2, "elinewidth": 0.7, "alpha": 0.8, "label": label}
        ax.errorbar(x.astype(np.float64), mean, (down, up), color=_COLOURS[i], fmt=_MARKERS[i], **look)
    scale_to(ax, "x", x)


def _points(ax: Axes, x: np.ndarray, means: np.ndarray, halves: np.ndarray, labels: list[str], log: bool) -> None:
    """One row of points per row of `means` [lines, P], side by side, with bars."""
    step = 0.6 / len(means)
    for i, (mean, half, label) in enumerate(zip(means, halves, labels, strict=True)):
        up = np.where(np.isfinite(half), half, 0.0)
        down = np.minimum(up, 0.7 * mean) if log else up
        at = np.arange(len(x)) + (i - (len(means) - 1) / 2) * step
        ax.errorbar(
            at, mean, (down, up), color=_COLOURS[i], fmt=_MARKERS[i], ms=3.5, capsize=2, elinewidth=1, label=label
        )
    texts = [text_of(value) for value in x]
    steep = sum(len(text) + 2 for text in texts) > 45
    ax.set_xticks(range(len(x)), texts, rotation=30 if steep else 0, ha="right" if steep else "center")
    ax.set_xlim(-0.5, len(x) - 0.5)
    ax.grid(visible=False, axis="x")

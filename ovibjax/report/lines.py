"""A sweep's results as lines over one axis, with 95 % intervals over seeds."""

import math
import textwrap
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ovibjax.errors import InputError
from ovibjax.report import figures as fig
from ovibjax.report.labels import average, axes_of, find, fixed, lacking, listing, metrics, prepare, text_of, with_unit

_COLOURS = (fig.BLUE, fig.ORANGE, fig.GREEN, fig.RED, fig.PURPLE, fig.SKY, fig.GREY)
_MARKERS = "osD^vPX"
_LOG_SPAN = 30.0


def plot(
    dataset: xr.Dataset, path: Path, x: str, metric: str | None = None, hue: str | None = None, over: str = "seed"
) -> None:
    """Draw a metric along an axis (see `line_figure`) and write the picture.

    Args:
        dataset: results.
        path: picture to write, e.g. PNG, PDF or SVG.
        x: as for `line_figure`.
        metric: likewise.
        hue: likewise.
        over: likewise.

    Raises:
        InputError: as `line_figure`, or the file cannot be written.
    """
    figure = line_figure(dataset, x, metric, hue, over)
    kinds = figure.canvas.get_supported_filetypes()
    if path.suffix[1:].lower() not in kinds:
        raise InputError(f"{path}: not a kind of picture; choose a name that ends in .png, .pdf or .svg")
    try:
        fig.save_figure(figure, path)
    except OSError as error:
        raise InputError(f"{path}: cannot write there ({error.strerror}); choose another file") from error


def line_figure(
    dataset: xr.Dataset, x: str, metric: str | None = None, hue: str | None = None, over: str = "seed"
) -> Figure:
    """A metric along an axis with its 95 % interval: lines with bands over numbers, points with bars over names.

    The axis is logarithmic where positive values span a factor of 30 (not where they are evenly spaced); a zero then
    stands on a linear piece at its left.

    Args:
        dataset: results.
        x: axis along the abscissa.
        metric: the metric; may be left out where only one depends on `x`.
        hue: axis that gives one line per value.
        over: axis to average over.

    Returns:
        The figure, one column wide.

    Raises:
        InputError: an unknown metric or axis, axes that exclude each other, an axis with several values left over, or
            nothing to draw.
    """
    chosen = _choose(dataset, x, metric, hue, over)
    data, name = chosen.data, chosen.metric
    others = [dim for dim in data[name].dims if dim not in (chosen.x_dim, chosen.hue_dim, chosen.along)]
    order = [chosen.hue_dim, chosen.x_dim] if chosen.hue_dim else [chosen.x_dim]
    means, halves = (
        np.atleast_2d(part.isel(dict.fromkeys(others, 0)).transpose(*order).values)
        for part in average(data, data[name], chosen.along)
    )
    if not np.isfinite(means).any():
        raise InputError(f"{name}: no finished member has a finite value; there is nothing to draw")
    values = data[x].values
    with mpl.rc_context(fig.style()):
        figure, (ax,) = fig.panels(1, width_in=fig.COLUMN_IN, height_in=2.3)
        log = bool((means[np.isfinite(means)] > 0).all() and np.nanmax(means) >= _LOG_SPAN * np.nanmin(means))
        labels = [text_of(value) for value in data[hue].values] if hue else [name]
        labels = [text if np.isfinite(row).any() else f"{text} (none)" for text, row in zip(labels, means, strict=True)]
        (_points if values.dtype.kind not in "fiu" else _lines)(ax, values, means, halves, labels, log)
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
        notes = [fixed(data, others)] if others else []
        if np.isfinite(halves).any():
            notes.append(f"95 % intervals over {data.sizes[chosen.along]} values of {over}")
        if lost := [f"{int(flag.sum())} {word}" for word, flag in lacking(data).items() if flag.any()]:
            notes.append(f"without {' and '.join(lost)}")
        ax.set_title(textwrap.fill("; ".join(notes), 66), loc="left", fontsize=6.5, color="0.35")
    return figure


class _Chosen(NamedTuple):
    """What is drawn.

    Attributes:
        data: the results that are needed.
        metric: the variable.
        x_dim: dimension of the abscissa.
        hue_dim: dimension with one line per point, if any.
        along: dimension averaged over.
    """

    data: xr.Dataset
    metric: str
    x_dim: str
    hue_dim: str | None
    along: str


def _choose(dataset: xr.Dataset, x: str, metric: str | None, hue: str | None, over: str) -> _Chosen:
    """Metric and dimensions of a drawing, or what the user has to say first; see `line_figure`."""
    axes, known = axes_of(dataset), metrics(dataset)
    x_dim = axes[find(x, axes, "axis")]
    fits = [name for name in known if x_dim in dataset[name].dims]
    if metric is None and len(fits) != 1:
        raise InputError(f"choose what to draw along {x} with --metric: {', '.join(fits) or 'nothing depends on it'}")
    name = fits[0] if metric is None else find(metric, known, "metric")
    data, along = prepare(dataset, [name], over)
    hue_dim = axes[find(hue, axes, "axis")] if hue is not None else None
    for role, axis, dim in (("x", x, x_dim), ("hue", hue, hue_dim)):
        if dim == along:
            raise InputError(f"--{role} {axis}: the mean is taken along it; choose another axis")
        if dim is not None and dim not in data[name].dims:
            raise InputError(f"--{role} {axis}: {name} does not depend on it; choose another axis")
    if hue_dim == x_dim:
        raise InputError(f"--hue {hue}: it advances together with {x}; choose another axis")
    for dim in map(str, data[name].dims):
        if dim not in (x_dim, hue_dim, along) and data.sizes[dim] > 1:
            axis = next(iter(axes_of(data, [dim])))
            values = data[axis].values
            raise InputError(
                f"{axis} has {len(values)} values ({listing(values)}): choose one with --where "
                f"{axis}={text_of(values[-1])}" + ("" if hue else f" or draw a line for each with --hue {axis}")
            )
    if hue_dim and data.sizes[hue_dim] > len(_COLOURS):
        raise InputError(
            f"--hue {hue}: {data.sizes[hue_dim]} lines are too many to tell apart; choose up to {len(_COLOURS)} with "
            f"--where {hue}={','.join(map(text_of, data[hue].values[:2]))},..."
        )
    return _Chosen(data, name, x_dim, hue_dim, along)


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
    _scale_x(ax, x)


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


def _scale_x(ax: Axes, x: np.ndarray) -> None:
    """Scale and ticks of a numeric abscissa with sorted values."""
    positive = x[x > 0]
    even = len(x) > 2 and np.allclose(np.diff(x), x[1] - x[0], rtol=1e-3)
    log = bool(x[0] >= 0 and len(positive) > 1 and positive[-1] >= _LOG_SPAN * positive[0] and not even)
    place = x
    if log and x[0] == 0:
        decades = float(np.clip(np.median(np.diff(np.log10(positive))), 0.3, 1.0))
        # The linear piece from 0 to the least value is as wide as linscale * 10 / 9 decades.
        ax.set_xscale("symlog", linthresh=positive[0], linscale=0.9 * decades)
        place = np.r_[np.full(len(x) - len(positive), np.log10(positive[0]) - decades), np.log10(positive)]
    elif log:
        ax.set_xscale("log")
        place = np.log10(x)
    if len(x) <= 10 and place[-1] > place[0]:
        plain = positive.size == 0 or (positive[0] >= 1e-3 and positive[-1] < 1e5)
        texts, end = [], -math.inf
        for value, at in zip(x, (place - place[0]) / (place[-1] - place[0]), strict=True):
            text = f"{value:g}" if plain or not log else _power(value)
            # Widths in the panel: seven-point digits on 2.7 inches.
            half_width = 0.5 * (0.022 * (4 if "$" in text else len(text)) + 0.02)
            texts.append(text if at - half_width >= end else "")
            end = at + half_width if texts[-1] else end
        ax.set_xticks(x, texts)
        ax.minorticks_off()
    elif log and x[0] > 0 and x[-1] < 1e3 * x[0]:
        fig.plain_log_ticks(ax.xaxis)


def _power(value: float) -> str:
    if value == 0:
        return "0"
    mantissa, exponent = f"{value:.5e}".split("e")
    times = "" if float(mantissa) == 1 else rf"{float(mantissa):g}\cdot"
    return rf"${times}10^{{{int(exponent)}}}$"

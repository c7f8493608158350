"""A sweep's results over two axes that advance together, as a search has them: points coloured by a metric."""

import textwrap

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from ovibjax.errors import InputError
from ovibjax.report import figures as fig
from ovibjax.report.heat_map import COLOURS
from ovibjax.report.labels import with_unit
from ovibjax.report.means import Over, average, laid_out
from ovibjax.report.plot_choice import choose_drawn
from ovibjax.report.scales import LOG_SPAN, scale_to


def scatter_figure(dataset: xr.Dataset, x: str, y: str, metric: str | None = None, over: Over = "seed") -> Figure:
    """A metric at points of two axes: its mean as a colour, the lowest ringed, points without a mean as crosses.

    Args:
        dataset: results; both axes lie along one dimension.
        x: axis along the abscissa.
        y: axis along the ordinate.
        metric: the metric; may be left out where only one depends on `x`.
        over: axes to average over.

    Returns:
        The figure, one column wide.

    Raises:
        InputError: an unknown metric or axis, an axis of names or with one value, an axis with several values left
            over, or nothing to draw.
    """
    chosen = choose_drawn(dataset, (("plot", x),), metric, over)
    data = chosen.data
    for axis in (x, y):
        if data[axis].dtype.kind not in "fiu":
            raise InputError(f"--plot {x} {y}: {axis} has names, which no point stands at; choose one with --where")
    mean = laid_out(data, average(data, data[chosen.metric], chosen.along)[0], chosen.dims).values
    known = np.isfinite(mean)
    if not known.any():
        raise InputError(f"{chosen.metric}: no finished member has a finite value; there is nothing to draw")
    low, high = float(mean[known].min()), float(mean[known].max())
    norm = LogNorm(low, high) if low > 0 and high >= LOG_SPAN * low else Normalize(low, high)
    at_x, at_y = (data[axis].values.astype(np.float64) for axis in (x, y))
    with mpl.rc_context(fig.style()):
        figure, (ax,) = fig.panels(1, width_in=fig.COLUMN_IN, height_in=2.6)
        order = np.argsort(-mean[known])  # the lowest on top
        shown = ax.scatter(at_x[known][order], at_y[known][order], 22, mean[known][order], cmap=COLOURS, norm=norm)
        ax.plot(at_x[~known], at_y[~known], "x", color="0.6", ms=3.5)
        best = int(np.nanargmin(np.where(known, mean, np.nan)))
        ax.plot(at_x[best], at_y[best], "o", ms=8, mfc="none", color=fig.RED, mew=1.2)
        scale_to(ax, "x", at_x)
        scale_to(ax, "y", at_y)
        ax.set(xlabel=with_unit(data, x, pretty=True), ylabel=with_unit(data, y, pretty=True))
        bar = figure.colorbar(shown, ax=ax, pad=0.02, label=with_unit(data, chosen.metric, pretty=True))
        bar.outline.set_linewidth(0.5)
        if isinstance(norm, LogNorm):
            fig.plain_log_ticks(bar.ax.yaxis)
        caption = "; ".join(filter(None, [chosen.caption(False), "lowest ringed"]))
        figure.suptitle(textwrap.fill(caption, 66), x=0.01, ha="left", fontsize=6.5, color="0.35")
    return figure

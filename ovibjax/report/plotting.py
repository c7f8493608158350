"""A sweep's results as a picture: along one axis as lines, over two as a heat map or, of a search, as points."""

from pathlib import Path

import xarray as xr

from ovibjax.errors import InputError
from ovibjax.report.figures import save_figure
from ovibjax.report.heat_map import heat_figure
from ovibjax.report.labels import axes_of
from ovibjax.report.lines import line_figure
from ovibjax.report.means import Over
from ovibjax.report.scatter import scatter_figure


# As many as there are things to say of a plot; the command line has an option for each.
def plot(
    dataset: xr.Dataset,
    path: Path,
    x: str,
    metric: str | None = None,
    hue: str | None = None,
    over: Over = "seed",
    y: str | None = None,
) -> None:
    """Draw a metric along an axis (see `line_figure`) or over two, and write the picture.

    Over two axes that cross it is a heat map (see `heat_figure`), over two that advance together points (see
    `scatter_figure`).

    Args:
        dataset: results.
        path: picture to write, e.g. PNG, PDF or SVG.
        x: axis along the abscissa.
        metric: the metric; may be left out where only one depends on `x`.
        hue: axis that gives one line per value; not with `y`.
        over: axes to average over.
        y: axis along the ordinate, where two are given.

    Raises:
        InputError: what cannot be drawn, or the file cannot be written.
    """
    if y is not None and hue is not None:
        raise InputError(f"--hue {hue}: a heat map of {x} and {y} has no lines; leave one of the three out")
    if y is None:
        figure = line_figure(dataset, x, metric, hue, over)
    else:
        axes = axes_of(dataset)
        together = x != y and x in axes and axes[x] == axes.get(y)
        figure = (scatter_figure if together else heat_figure)(dataset, x, y, metric, over)
    kinds = figure.canvas.get_supported_filetypes()
    if path.suffix[1:].lower() not in kinds:
        raise InputError(f"{path}: not a kind of picture; choose a name that ends in .png, .pdf or .svg")
    try:
        save_figure(figure, path)
    except OSError as error:
        raise InputError(f"{path}: cannot write there ({error.strerror}); choose another file") from error

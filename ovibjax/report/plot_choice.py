"""What a drawing of a sweep's results shows: the metric, the axes drawn along, and what its caption says."""

from collections.abc import Sequence
from typing import NamedTuple

import xarray as xr

from ovibjax.errors import InputError
from ovibjax.report.labels import axes_of, find, fixed, grid_dims, listing, metrics, text_of, varying
from ovibjax.report.means import Over, lacking, over_text, prepare


class Chosen(NamedTuple):
    """What is drawn.

    Attributes:
        data: the results that are needed.
        metric: the variable.
        dims: dimensions drawn along.
        along: dimensions averaged over.
        others: dimensions left, all of length one.
    """

    data: xr.Dataset
    metric: str
    dims: list[str]
    along: list[str]
    others: list[str]

    def caption(self, intervals: bool) -> str:
        """What a drawing says of itself: the axes with one value, the intervals, and what is missing."""
        notes = [fixed(self.data, self.others)] if self.others else []
        if intervals:
            notes.append(f"95 % intervals over {over_text(self.data, self.along)}")
        if lost := [f"{int(flag.sum())} {word}" for word, flag in lacking(self.data).items() if flag.any()]:
            notes.append(f"without {' and '.join(lost)}")
        return "; ".join(notes)


def choose_drawn(dataset: xr.Dataset, drawn: Sequence[tuple[str, str]], metric: str | None, over: Over) -> Chosen:
    """Metric and dimensions of a drawing.

    Args:
        dataset: results.
        drawn: option and axis, e.g. ("plot", "gamma"), for every axis that is drawn along.
        metric: the metric; may be left out where only one depends on the first axis.
        over: axes to average over.

    Returns:
        What is drawn.

    Raises:
        InputError: an unknown metric or axis, axes that exclude each other, or an axis with several values left over;
            what to say first, and how.
    """
    axes, known = axes_of(dataset), metrics(dataset)
    dims = [axes[find(axis, axes, "axis")] for _, axis in drawn]
    x = drawn[0][1]
    fits = [name for name in known if dims[0] in dataset[name].dims]
    if metric is None and len(fits) != 1:
        raise InputError(f"choose what to draw along {x} with --metric: {', '.join(fits) or 'nothing depends on it'}")
    name = fits[0] if metric is None else find(metric, known, "metric")
    data, along = prepare(dataset, [name], over)
    for place, ((option, axis), dim) in enumerate(zip(drawn, dims, strict=True)):
        if dim in along:
            raise InputError(f"--{option} {axis}: the mean is taken along it; choose another axis")
        if dim not in data[name].dims:
            raise InputError(f"--{option} {axis}: {name} does not depend on it; choose another axis")
        if dim in dims[:place]:
            raise InputError(f"--{option} {axis}: it advances together with {x}; choose another axis")
    others = [str(dim) for dim in data[name].dims if dim not in (*dims, *along)]
    for dim in others:
        if data.sizes[dim] > 1:
            raise InputError(_left_over(data, dim, along, hue=len(drawn) == 1))
    return Chosen(data, name, dims, along, others)


def _left_over(data: xr.Dataset, dim: str, along: Sequence[str], hue: bool) -> str:
    """What to do about an axis with several values of which a drawing has room for one."""
    axis = next((name for name in axes_of(data, [dim]) if varying(data, name)), dim)
    values = data[axis].values
    ways = [f"choose one with --where {axis}={text_of(values[-1])}"]
    if hue:
        ways.append(f"draw a line for each with --hue {axis}")
    if dim in grid_dims(data):
        named = [name for name, known in axes_of(data).items() if known in along]
        ways.append(f"average over it with --over {' '.join([*named, axis])}")
    return f"{axis} has {len(values)} values ({listing(values)}): {' or '.join(ways)}"

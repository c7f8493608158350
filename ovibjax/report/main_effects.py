"""Which axis of a sweep moves a metric, and how: means by value of each axis, and shares of the variance."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy.stats import spearmanr

from ovibjax.errors import InputError
from ovibjax.report.claims import Interval
from ovibjax.report.labels import advances_together, axes_of, find, metrics, text_of
from ovibjax.report.means import SEED, Over, average, prepare, repetitions, spans
from ovibjax.report.shares import variance_shares

MOST_LEVELS = 24
"""Values of an axis up to which its levels are listed; more are for a plot."""


@dataclass(frozen=True)
class Effects:
    """How a metric depends on the axes of a sweep.

    Attributes:
        levels: by axis with several values, the mean over everything else at each value: text of the value, mean and
            95 % interval over seeds, infinite where there is no seed or only one.
        shares: share of the variance of the means by axis, `beta`, and pair of axes, `beta x gamma`, and the `rest`;
            empty where a point has no finite mean.
        ranks: Spearman's rank correlation of the metric with each axis of points that were drawn, from -1 to 1.
        complete: whether every member counts; otherwise levels are means over different parts of the grid.
    """

    levels: dict[str, list[tuple[str, Interval]]]
    shares: dict[str, float]
    ranks: dict[str, float]
    complete: bool

    def main(self) -> dict[str, float]:
        """Shares of single axes, the largest first."""
        return _largest({name: share for name, share in self.shares.items() if " x " not in name and name != "rest"})

    def interactions(self) -> dict[str, float]:
        """Shares of pairs of axes, the largest first."""
        return _largest({name: share for name, share in self.shares.items() if " x " in name})


def effects(dataset: xr.Dataset, metric: str, over: Over = SEED) -> Effects:
    """Main effects and interactions of the axes of a sweep on a metric.

    An interval of a level is one over seeds, each a mean over everything else, so that it says how sure the level is
    and not how far the other axes move it.

    Args:
        dataset: results.
        metric: a metric of theirs.
        over: axes that are repetitions and not of interest.

    Returns:
        The effects; zipped axes, which advance together, count as one.

    Raises:
        InputError: an unknown metric or axis.

    Example:
        >>> from ovibjax import sweep
        >>> axes = {"a": [0.0, 1.0], "b": [0.0, 2.0], "seed": [0, 1]}
        >>> found = effects(sweep.run(lambda key, point, data: {"y": point["a"] + point["b"]}, axes), "y")
        >>> found.main()
        {'b': 0.8, 'a': 0.2}
        >>> [(value, span.mean) for value, span in found.levels["b"]]
        [('0', 0.5), ('2', 2.5)]
    """
    name = find(metric, metrics(dataset), "metric")
    data, along = prepare(dataset, [name], over)
    varying = [str(dim) for dim in data[name].dims if dim not in along and data.sizes[dim] > 1]
    labels = {dim: " / ".join(axes_of(data, [dim])) for dim in varying}
    listed = [dim for dim in varying if data.sizes[dim] <= MOST_LEVELS]
    levels = {labels[dim]: _levels(data, name, dim, along) for dim in listed}
    complete = bool((data["finished"] & ~data["diverged"]).all())
    return Effects(levels, _shares(data, name, along, labels), _ranks(data, name, along, varying), complete)


def _levels(data: xr.Dataset, name: str, dim: str, along: Sequence[str]) -> list[tuple[str, Interval]]:
    """Mean at each value of one axis over all others, the members that count."""
    values, use, repeated = repetitions(data, data[name], along)
    known = values.where(use & np.isfinite(values)).astype(np.float64)
    others = [other for other in known.dims if other not in (dim, *repeated)]
    per = known.mean(others) if others else known
    # Without seeds the members that are averaged over are no repetitions.
    seeds = SEED in axes_of(data, repeated) and repeated
    mean, half = spans(per, per.notnull(), repeated) if seeds else (per.mean(repeated), per.mean(repeated) * np.inf)
    columns = [data[axis].values for axis in axes_of(data, [dim])]
    texts = [" / ".join(map(text_of, row)) for row in zip(*columns, strict=True)]
    both = zip(mean.transpose(dim).values.tolist(), half.transpose(dim).values.tolist(), strict=True)
    return [(text, Interval(m, h if np.isfinite(h) else np.inf)) for text, (m, h) in zip(texts, both, strict=True)]


def _shares(data: xr.Dataset, name: str, along: Sequence[str], labels: dict[str, str]) -> dict[str, float]:
    """Shares of the variance of the means of complete grids."""
    mean = average(data, data[name], along)[0]
    mean = mean.squeeze([dim for dim in mean.dims if dim not in labels], drop=True)
    if not mean.ndim:
        return {}
    try:
        found = variance_shares(mean.rename({dim: labels[str(dim)] for dim in mean.dims if labels[str(dim)] != dim}))
    except InputError:
        return {}
    return found


def _ranks(data: xr.Dataset, name: str, along: Sequence[str], dims: Sequence[str]) -> dict[str, float]:
    """How each axis of numbers that advances together with others orders the means."""
    mean = average(data, data[name], along)[0]
    found = {}
    for dim in dims:
        axes = [
            axis for axis in axes_of(data, [dim]) if advances_together(data, axis) and data[axis].dtype.kind in "fiu"
        ]
        per = mean.mean([other for other in mean.dims if other != dim]).values
        known = np.isfinite(per)
        for axis in axes:
            values = data[axis].values[known]
            if known.sum() > 2 and np.ptp(values) > 0 and np.ptp(per[known]) > 0:
                found[axis] = float(spearmanr(values, per[known]).statistic)
    return dict(sorted(found.items(), key=lambda entry: -abs(entry[1])))


def _largest(shares: dict[str, float]) -> dict[str, float]:
    return dict(sorted(shares.items(), key=lambda entry: -entry[1]))

"""Means over axes of a sweep with 95 % intervals, over the members that count, and what is missing from them.

Members that diverged or are unfinished count in no mean. Where several axes are averaged over, `seed` among them, the
interval is one over seeds: members of one seed share their draws, so that each seed gives one number, its mean over
the other axes.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import xarray as xr
from scipy.special import stdtrit

from ovibjax.report.labels import axes_of, find, grid_dims

SEED = "seed"

_ONE = "(one)"
"""Dimension of length one where nothing is averaged over."""

Over = str | Sequence[str]
"""Axes to average over; none shows every member by itself, as does `seed` where there is no such axis."""


def prepare(dataset: xr.Dataset, names: Sequence[str], over: Over) -> tuple[xr.Dataset, list[str]]:
    """The variables needed, and the dimensions to average over.

    Args:
        dataset: results.
        names: variables over all swept axes.
        over: axes to average over.

    Returns:
        The variables with `finished` and `diverged`, and at least one dimension, if only of length one.

    Raises:
        InputError: an axis that was not swept.
    """
    data = dataset[[*dict.fromkeys(names), "finished", "diverged"]].compute()
    axes, wanted = axes_of(dataset, grid_dims(dataset)), [over] if isinstance(over, str) else list(over)
    if not wanted or (wanted == [SEED] and SEED not in axes):
        return data.expand_dims(_ONE), [_ONE]
    return data, list(dict.fromkeys(axes[find(axis, axes, "swept axis")] for axis in wanted))


def average(data: xr.Dataset, values: xr.DataArray, along: Sequence[str]) -> tuple[xr.DataArray, xr.DataArray]:
    """Mean and half-width of its 95 % interval over the members that count.

    Args:
        data: results, prepared.
        values: a variable of theirs, or part of one.
        along: dimensions to average over.

    Returns:
        Both over the dimensions left; NaN without a member that counts or if one of them is not finite, and an
        infinite half-width for a single repetition.
    """
    return spans(*repetitions(data, values, along))


def repetitions(
    data: xr.Dataset, values: xr.DataArray, along: Sequence[str]
) -> tuple[xr.DataArray, xr.DataArray, list[str]]:
    """What an interval is over: the values, which of them count, and the dimensions of independent repetitions."""
    use, seed = data["finished"] & ~data["diverged"], axes_of(data, along).get(SEED)
    if seed is None or len(along) == 1:
        return values, use, list(along)
    others = [dim for dim in along if dim != seed]
    count = use.sum(others)
    sums = xr.where(use, values, 0.0).sum(others, skipna=False)
    return sums / count.where(count > 0), count > 0, [seed]


def spans(values: xr.DataArray, use: xr.DataArray, along: Sequence[str]) -> tuple[xr.DataArray, xr.DataArray]:
    """Mean and half-width along dimensions of independent repetitions, as `claims.interval`, all points at once."""
    made: tuple[xr.DataArray, xr.DataArray] = xr.apply_ufunc(
        lambda numbers, counts: _intervals(numbers, counts, len(along)),
        values,
        use,
        input_core_dims=[list(along), list(along)],
        output_core_dims=[[], []],
    )
    return made


def _intervals(values: np.ndarray, use: np.ndarray, n_axes: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean and half-width [...] over the last axes of `values` where `use`, both [..., *axes]."""
    flat = values.astype(np.float64).reshape(*values.shape[:-n_axes], -1)
    use = np.broadcast_to(use, values.shape).reshape(flat.shape)
    count = use.sum(axis=-1)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        mean = np.where(use, flat, 0.0).sum(axis=-1) / count
        squares = np.where(use, (flat - mean[..., None]) ** 2, 0.0).sum(axis=-1)
        half = stdtrit(np.maximum(count - 1, 1), 0.975) * np.sqrt(squares / (count - 1) / count)
    half = np.where(count == 1, np.inf, half)
    finite = np.isfinite(np.where(use, flat, 0.0)).all(axis=-1) & (count > 0)
    return np.where(finite, mean, np.nan), np.where(finite, half, np.nan)


def over_text(data: xr.Dataset, along: Sequence[str]) -> str:
    """What a mean is over, as a caption says it: `5 values of seed`."""
    if len(along) == 1:
        return f"{data.sizes[along[0]]} values of {along[0]}"
    seed = axes_of(data, along).get(SEED)
    if seed is None:
        return f"{_total(data, along)} members over {' and '.join(along)}"
    others = [dim for dim in along if dim != seed]
    return f"{data.sizes[seed]} values of {seed}, each a mean over {' and '.join(others)}"


def lacking(data: xr.Dataset) -> dict[str, xr.DataArray]:
    """Members that count in no mean, by reason."""
    return {"diverged": data["finished"] & data["diverged"], "unfinished": ~data["finished"]}


def counted(data: xr.Dataset, dims: Sequence[str], along: Sequence[str]) -> np.ndarray:
    """How many members count in the means, [*dims], dimensions of the sweep or trailing ones."""
    use = data["finished"] & ~data["diverged"]
    return laid_out(data, use.sum(along), dims).values


def notes_on(data: xr.Dataset, along: Sequence[str], at: Iterable[int]) -> list[str]:
    """What is missing at points of the swept dimensions that are left: `3 of 5 seeds: 1 diverged, 1 unfinished`.

    Args:
        data: results, prepared.
        along: dimensions that are averaged over.
        at: flat positions of the points.

    Returns:
        A text per point, empty where nothing is missing.
    """
    left, total = [dim for dim in grid_dims(data) if dim not in along], _total(data, along)
    missing = {word: flag.sum(along).transpose(*left).values.ravel() for word, flag in lacking(data).items()}
    what = "members" if len(along) > 1 else "seeds" if along[0] == SEED else f"values of {along[0]}"
    notes = []
    for i in at:
        counts = {word: int(count[i]) for word, count in missing.items() if count[i]}
        if total == 1:
            notes.append(", ".join(counts))
        else:
            said = ", ".join(f"{count} {word}" for word, count in counts.items())
            notes.append(f"{total - sum(counts.values())} of {total} {what}: {said}" if counts else "")
    return notes


def laid_out(data: xr.Dataset, part: xr.DataArray, dims: Sequence[str]) -> xr.DataArray:
    """A part of the results over all of some dimensions, in this order; repeated along those that it lacks.

    Args:
        data: results, which have the dimensions.
        part: values over some of them.
        dims: dimensions wanted.

    Returns:
        [*dims]; what the part has of other dimensions must have length one.
    """
    kept: Any = part.isel({dim: 0 for dim in part.dims if dim not in dims}, drop=True)
    return kept.expand_dims({dim: data.sizes[dim] for dim in dims if dim not in kept.dims}).transpose(*dims)


def _total(data: xr.Dataset, along: Sequence[str]) -> int:
    return int(np.prod([data.sizes[dim] for dim in along]))

"""The labelled results of a sweep: which axes and metrics there are, selections, and means over seeds.

Results are an `xarray.Dataset`: one dimension per swept axis (zipped axes share one and are coordinates along it), the
booleans `finished` and `diverged` over these dimensions, and variables over them, some with further, trailing
dimensions. Members that diverged or are unfinished count in no mean. An axis is a coordinate along one dimension.
"""

import difflib
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from ovibjax.errors import InputError
from ovibjax.report.claims import interval


def metrics(dataset: xr.Dataset) -> list[str]:
    """Names of the variables that can be shown: numbers over all swept axes, every dimension labelled."""
    labelled = set(axes_of(dataset).values())
    return [name for name in numbers_of(dataset) if labelled.issuperset(map(str, dataset[name].dims))]


def select(dataset: xr.Dataset, where: Sequence[str]) -> xr.Dataset:
    """Keep the points at which axes have given values; every dimension stays, if only with length one.

    Args:
        dataset: results.
        where: `AXIS=VALUE` or `AXIS=VALUE,VALUE,...` each; numbers match to float32 accuracy.

    Returns:
        The selected part.

    Raises:
        InputError: an entry of another form, an unknown axis, or a value that the axis does not have.
    """
    for entry in where:
        axis, equals, wanted = entry.partition("=")
        axes = axes_of(dataset)
        if not equals or not wanted:
            raise InputError(f"--where {entry}: write AXIS=VALUE or AXIS=VALUE,VALUE (axes: {', '.join(axes)})")
        dim = axes[find(axis, axes, "axis")]
        values = dataset[axis].values
        # A name may hold a comma.
        parts = [wanted] if matches(values, wanted).any() else wanted.split(",")
        keep = np.zeros(len(values), bool)
        for part in parts:
            match = matches(values, part)
            if not match.any():
                raise InputError(f"--where {entry}: {axis} has no value {part!r}; it has {listing(values)}")
            keep |= match
        dataset = dataset.isel({dim: np.flatnonzero(keep)})
    return dataset


def prepare(dataset: xr.Dataset, names: list[str], over: str) -> tuple[xr.Dataset, str]:
    """The variables needed, and the dimension to average over: one of length one where there is no `seed`."""
    data, axes = dataset[[*names, "finished", "diverged"]].compute(), axes_of(dataset, grid_dims(dataset))
    if over not in axes and over == "seed":
        return data.drop_vars(over, errors="ignore").expand_dims({over: [0]}), over
    return data, axes[find(over, axes, "swept axis")]


def average(data: xr.Dataset, values: xr.DataArray, along: str) -> tuple[xr.DataArray, xr.DataArray]:
    """Mean and half-width along a dimension of the members that count; NaN without any, or if one is not finite."""

    def span(numbers: np.ndarray, use: np.ndarray) -> tuple[float, float]:
        kept = numbers[use]
        if not kept.size or not np.isfinite(kept).all():
            return math.nan, math.nan
        made = interval(kept)
        return made.mean, made.half

    use = data["finished"] & ~data["diverged"]
    made: tuple[xr.DataArray, xr.DataArray] = xr.apply_ufunc(
        span,
        values,
        use,
        input_core_dims=[[along], [along]],
        output_core_dims=[[], []],
        vectorize=True,
        output_dtypes=[float, float],
    )
    return made


def notes_on(data: xr.Dataset, along: str) -> list[str]:
    """What is missing, per combination of the axes: `diverged 1 of 5`."""
    total, missing = data.sizes[along], lacking(data)
    counts = zip(*(flag.sum(along).values.ravel() for flag in missing.values()), strict=True)
    words = [[(word, n) for word, n in zip(missing, ns, strict=True) if n] for ns in counts]
    return [", ".join(f"{word} {n} of {total}" if total > 1 else word for word, n in line) for line in words]


def lacking(data: xr.Dataset) -> dict[str, xr.DataArray]:
    """Members that count in no mean, by reason."""
    return {"diverged": data["finished"] & data["diverged"], "unfinished": ~data["finished"]}


def grid_dims(dataset: xr.Dataset) -> list[str]:
    """Dimensions of the sweep."""
    for name in ("finished", "diverged"):
        if name not in dataset:
            raise InputError(f"these are not a sweep's results: they hold no variable {name!r}")
    return [str(dim) for dim in dataset["finished"].dims]


def numbers_of(dataset: xr.Dataset) -> list[str]:
    """Variables that are numbers over all swept axes."""
    grid = set(grid_dims(dataset))
    return [str(name) for name, v in dataset.data_vars.items() if v.dtype.kind in "fiu" and grid <= set(v.dims)]


def axes_of(dataset: xr.Dataset, dims: Sequence[str] | None = None) -> dict[str, str]:
    """Axis name to dimension, in the order of the dimensions."""
    order = [str(dim) for dim in dataset.sizes] if dims is None else dims
    return {str(name): dim for dim in order for name, value in dataset.coords.items() if value.dims == (dim,)}


def labels_of(data: xr.Dataset | xr.DataArray, dims: Sequence[str], named: bool = True) -> list[list[str]]:
    """Per point of the dimensions the values of the axes along them as text, with the axis' name if wanted."""
    made = []
    for place, dim in enumerate(dims):
        for name, axis in data.coords.items():
            if axis.dims == (dim,):
                made.append((place, [f"{name} {text_of(value)}" if named else text_of(value) for value in axis.values]))
    return [[texts[at[place]] for place, texts in made] for at in np.ndindex(*(data.sizes[dim] for dim in dims))]


def fixed(data: xr.Dataset, dims: Sequence[Any]) -> str:
    """Axes with one value, as `beta = 0.001, prefix = 35`."""
    one = [data[axis] for axis, dim in axes_of(data, dims).items() if data.sizes[dim] == 1]
    return ", ".join(f"{axis.name} = {text_of(axis.values[0])} {axis.attrs.get('units', '')}".strip() for axis in one)


def with_unit(data: xr.Dataset, name: str, pretty: bool = False) -> str:
    """Name and unit; for a plot the long name, or the name without underscores and without the unit at its end."""
    attrs = data[name].attrs
    unit = attrs.get("units", "")
    if pretty:
        name = attrs.get("long_name", name.removesuffix(f"_{unit}").replace("_", " "))
    return f"{name} ({unit})" if unit else name


def text_of(value: Any) -> str:
    """A value of an axis as it is typed."""
    return f"{value:g}" if isinstance(value, float | np.floating) else str(value)


def listing(values: np.ndarray) -> str:
    """Values of an axis, shortened where there are many."""
    texts = [text_of(value) for value in values]
    return ", ".join(texts if len(texts) <= 12 else [*texts[:8], "...", *texts[-2:]])


def matches(values: np.ndarray, text: str) -> np.ndarray:
    """Where an axis has a value given as text."""
    if values.dtype.kind in "fiu":
        try:
            number = float(text)
        except ValueError:
            return np.zeros(len(values), bool)
        return np.asarray(np.isclose(values.astype(np.float64), number, rtol=1e-6, atol=0.0))
    return np.array([str(value) == text for value in values])


def find(name: str, choices: Sequence[str] | dict[str, str], what: str) -> str:
    """The name itself, or an `InputError` that suggests a close one."""
    if name not in choices:
        near = difflib.get_close_matches(name, list(choices), n=1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise InputError(f"no {what} {name!r}; {hint}there is: {', '.join(choices) or 'none'}")
    return name

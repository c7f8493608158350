"""The labelled results of a sweep: which axes and metrics there are, and how they are named, found and written.

Results are an `xarray.Dataset`: one dimension per swept axis (zipped axes share one and are coordinates along it), the
booleans `finished` and `diverged` over these dimensions, and variables over them, some with further, trailing
dimensions. An axis is a coordinate along one dimension.
"""

import difflib
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import xarray as xr

from ovibjax.errors import InputError
from ovibjax.runtime.plain_numbers import plain_float


def metrics(dataset: xr.Dataset) -> list[str]:
    """Names of the variables that can be shown: numbers over all swept axes, every dimension labelled."""
    labelled = set(axes_of(dataset).values())
    return [name for name in numbers_of(dataset) if labelled.issuperset(map(str, dataset[name].dims))]


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


def labels_of(
    data: xr.Dataset | xr.DataArray, dims: Sequence[str], named: bool = True, at: Iterable[int] | None = None
) -> list[list[str]]:
    """Per point of the dimensions the values of the axes along them as text, with the axis' name if wanted.

    Args:
        data: results.
        dims: dimensions, the first slowest.
        named: whether the name of the axis stands before the value.
        at: flat positions of the points; all by default.

    Returns:
        [points][axes] texts.
    """
    made = []
    for place, dim in enumerate(dims):
        for name, axis in data.coords.items():
            if axis.dims == (dim,):
                made.append((place, [f"{name} {text_of(value)}" if named else text_of(value) for value in axis.values]))
    shape = tuple(data.sizes[dim] for dim in dims)
    points = np.ndindex(*shape) if at is None else (np.unravel_index(i, shape) for i in at)
    return [[texts[int(point[place])] for place, texts in made] for point in points]


def varying(data: xr.Dataset, axis: str) -> bool:
    """Whether an axis has several values; one that advances together with others may have a single one."""
    values = data[axis].values
    return values.size > 1 and bool((values != values[0]).any())


def advances_together(data: xr.Dataset, axis: str) -> bool:
    """Whether other axes with several values lie along the dimension of one."""
    return any(name != axis and data[name].dims == data[axis].dims and varying(data, name) for name in axes_of(data))


def fixed(data: xr.Dataset, dims: Sequence[Any]) -> str:
    """Axes with one value, as `beta = 0.001, prefix = 35`."""
    one = [data[axis] for axis in axes_of(data, dims) if not varying(data, axis)]
    return ", ".join(f"{axis.name} = {text_of(axis.values[0])} {axis.attrs.get('units', '')}".strip() for axis in one)


def with_unit(data: xr.Dataset, name: str, pretty: bool = False) -> str:
    """Name and unit; for a plot the long name, or the name without underscores and without the unit at its end."""
    attrs = data[name].attrs
    unit = attrs.get("units", "")
    if pretty:
        name = attrs.get("long_name", name.removesuffix(f"_{unit}").replace("_", " "))
    return f"{name} ({unit})" if unit else name


def text_of(value: Any) -> str:
    """A value of an axis as it is shown."""
    return f"{value:g}" if isinstance(value, float | np.floating) else str(value)


def listing(values: np.ndarray) -> str:
    """Values of an axis, shortened where there are many."""
    texts = [text_of(value) for value in values]
    return ", ".join(texts if len(texts) <= 12 else [*texts[:8], "...", *texts[-2:]])


def same_number(values: np.ndarray, number: float) -> np.ndarray:
    """Where numbers are equal to one, to float32 accuracy."""
    return np.asarray(np.isclose(values.astype(np.float64), number, rtol=1e-6, atol=0.0))


def matches(values: np.ndarray, text: str) -> np.ndarray:
    """Where an axis has a value given as text: the number, or what is shown of it."""
    shown = np.array([text_of(value) == text for value in values], bool)
    if values.dtype.kind not in "fiu":
        return shown
    try:
        return shown | same_number(values, plain_float(text))
    except ValueError:
        return np.zeros(len(values), bool)


def items_of(text: str, names: Iterable[str]) -> list[str]:
    """The values of a list with commas; where names hold commas themselves, the longest that fits is meant.

    Args:
        text: what was typed.
        names: values that are names.

    Returns:
        Values; an unknown one ends at the next comma.
    """
    parts, items, known = text.split(","), [], set(names)
    most = max((name.count(",") + 1 for name in known), default=1)
    while parts:
        ends = (end for end in range(min(most, len(parts)), 0, -1) if ",".join(parts[:end]) in known)
        end = next(ends, 1)
        items.append(",".join(parts[:end]))
        del parts[:end]
    return items


def find(name: str, choices: Sequence[str] | dict[str, str], what: str) -> str:
    """The name itself, or an `InputError` that suggests a close one."""
    if name not in choices:
        near = difflib.get_close_matches(name, list(choices), n=1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise InputError(f"no {what} {name!r}; {hint}there is: {', '.join(choices) or 'none'}")
    return name

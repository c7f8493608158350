"""What a sweep holds: its grid, its outputs, and the labelled dataset they make."""

import hashlib
import json
import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray

from ovibjax.errors import InputError
from ovibjax.sweep.grid import PADDING, Axis, Chunks, Grid

_OWN_NAMES = ("member", "chunk", "grid_index", "finished", "diverged", "zarr.json")
_ABSENT = object()


@dataclass(frozen=True)
class Variable:
    """One output of the member function.

    Attributes:
        shape: shape for one member.
        dtype: a bool, integer or float type of NumPy.
        dims: names of the dimensions of `shape`.
        unit: unit of the values; empty for none.
    """

    shape: tuple[int, ...]
    dtype: np.dtype
    dims: tuple[str, ...]
    unit: str = ""


@dataclass(frozen=True)
class Schema:
    """What a store holds.

    Attributes:
        grid: the members.
        chunks: how the grid is cut.
        variables: outputs by name; dots are allowed.
        coords: values of dimensions of the outputs; a dimension may have none.
    """

    grid: Grid
    chunks: Chunks
    variables: dict[str, Variable]
    coords: dict[str, Axis]


def check(schema: Schema) -> None:
    """Refuse names that clash and types that a file cannot hold."""
    sizes: dict[str, int] = {}
    arrays = {dim: Variable((len(a.values),), np.asarray(a.values).dtype, (dim,)) for dim, a in schema.coords.items()}
    for name, variable in [*arrays.items(), *schema.variables.items()]:
        dims, shape, dtype = variable.dims, variable.shape, np.dtype(variable.dtype)
        if not re.fullmatch(r"(?!__)\w[\w.-]*", name):
            raise InputError(f"{name!r} cannot name a variable; use letters, digits, '_', '-' and '.'")
        if not re.fullmatch(r"bool|u?int(8|16|32|64)|float(16|32|64)" + r"|str\d+" * (name in arrays), dtype.name):
            raise InputError(f"variable {name}: values of type {dtype} cannot be stored, only numbers")
        if len(dims) != len(shape) or len(set(dims)) != len(dims) or 0 in shape:
            raise InputError(f"variable {name}: dimensions {dims} do not fit shape {shape}")
        for dim, size in zip(dims, shape, strict=True):
            if sizes.setdefault(dim, size) != size:
                raise InputError(f"variable {name}: dimension {dim} has length {size} here and {sizes[dim]} elsewhere")
    grid = schema.grid
    names = [*_OWN_NAMES, *grid.axes, *(set(grid.dims) - set(grid.axes)), *sizes, *schema.variables]
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise InputError(f"{twice[0]!r} names two things in this sweep (or is the store's own name); rename one")


def assemble(
    schema: Schema, done: list[int], read: Callable[[str], np.ndarray], config: dict[str, Any]
) -> xarray.Dataset:
    """Finished chunks as a dataset with the grid's dimensions.

    Args:
        schema: what there is.
        done: finished chunks.
        read: gives [len(done), rows * columns, ...] of a variable, or of `diverged`.
        config: what the sweep was started with.

    Returns:
        Variables [dimensions of the grid, ...]; members not finished are NaN, 0 or False, and `finished` and
        `diverged` tell. Coordinates have their values or names; those of zipped axes lie along their common
        dimension. Attributes are `config` and `hash`.
    """
    grid = schema.grid
    members = schema.chunks.members[done].reshape(-1)
    real = members != PADDING

    def spread(data: np.ndarray) -> np.ndarray:
        """[chunks, size, ...] finished chunks to [*grid, ...]."""
        flat = np.full((grid.size, *data.shape[2:]), fill_value(data.dtype))
        flat[members[real]] = data.reshape(-1, *data.shape[2:])[real]
        return flat.reshape(*grid.shape, *data.shape[2:])

    every = np.ones((len(done), schema.chunks.rows * schema.chunks.columns), bool)
    data: dict[str, Any] = {"finished": (grid.dims, spread(every))}
    for name, variable in {"diverged": Variable((), np.dtype(bool), ()), **schema.variables}.items():
        data[name] = ((*grid.dims, *variable.dims), spread(read(name)), attributes_of(variable.unit))
    coords = {name: (grid.dims[grid.group_of(name)], axis) for name, axis in grid.axes.items()}
    coords |= {dim: (dim, axis) for dim, axis in schema.coords.items()}
    return xarray.Dataset(
        data,
        {name: (dim, np.asarray(axis.values), attributes_of(axis.unit)) for name, (dim, axis) in coords.items()},
        {"config": config, "hash": digest(config)},
    )


def description(schema: Schema) -> dict[str, Any]:
    """A schema as JSON, with a digest of the order of members."""

    def axes(given: dict[str, Axis]) -> dict[str, Any]:
        return {name: {"values": np.asarray(a.values).tolist(), "unit": a.unit} for name, a in given.items()}

    chunks = schema.chunks
    order = hashlib.sha256(chunks.members.astype("<i8").tobytes()).hexdigest()[:16]
    return {
        "axes": axes(schema.grid.axes),
        "groups": [list(group) for group in schema.grid.groups],
        "chunks": {"outer": chunks.outer, "rows": chunks.rows, "columns": chunks.columns, "order": order},
        "variables": {
            name: {"shape": list(v.shape), "dtype": np.dtype(v.dtype).name, "dims": list(v.dims), "unit": v.unit}
            for name, v in schema.variables.items()
        },
        "coords": axes(schema.coords),
    }


def schema_of(described: dict[str, Any], members: np.ndarray) -> Schema:
    """The schema of a store from its description and the order of its members."""

    def axes(given: dict[str, Any]) -> dict[str, Axis]:
        return {name: Axis(tuple(a["values"]), a["unit"]) for name, a in given.items()}

    chunks = described["chunks"]
    schema = Schema(
        Grid(axes(described["axes"]), tuple(tuple(group) for group in described["groups"])),
        Chunks(
            chunks["outer"],
            chunks["rows"],
            chunks["columns"],
            members.reshape(-1, chunks["rows"], chunks["columns"]),
        ),
        {
            name: Variable(tuple(v["shape"]), np.dtype(v["dtype"]), tuple(v["dims"]), v["unit"])
            for name, v in described["variables"].items()
        },
        axes(described["coords"]),
    )
    if canonical(description(schema)) != canonical(described):
        raise ValueError("grid_index does not fit the layout")
    return schema


def differences(there: Any, here: Any, name: str = "") -> Iterator[str]:
    """What differs between two JSON values, each with its dotted path."""
    if isinstance(there, dict) and isinstance(here, dict):
        for key in {**there, **here}:
            yield from differences(there.get(key, _ABSENT), here.get(key, _ABSENT), f"{name}.{key}" if name else key)
    elif isinstance(there, list) and isinstance(here, list) and _itemwise(there, here):
        for i, pair in enumerate(zip(there, here, strict=True)):
            yield from differences(*pair, f"{name}[{i}]")
    elif there is _ABSENT or here is _ABSENT or canonical(there) != canonical(here):
        yield f"{name} is {_show(there)} there and {_show(here)} here"


def _itemwise(there: list[Any], here: list[Any]) -> bool:
    """Whether two lists are better compared item by item than shown whole."""
    return len(there) == len(here) and (len(there) > 4 or any(isinstance(v, dict | list) for v in there))


def _show(value: Any) -> str:
    """A value on one short line."""
    if value is _ABSENT:
        return "absent"
    if isinstance(value, list) and len(value) > 4:
        return f"[{_show(value[0])}, {_show(value[1])}, ... {_show(value[-1])}] ({len(value)} values)"
    text = json.dumps(value)
    return text if len(text) <= 80 else f"{text[:60]}...{text[-15:]}"


def attributes_of(unit: str, axis: Axis | None = None) -> dict[str, Any]:
    """Attributes of an array: its unit, and the names that its values are indices of."""
    attributes: dict[str, Any] = {"units": unit} if unit else {}
    if axis is not None and np.asarray(axis.values).dtype.kind == "U":
        attributes["names"] = np.asarray(axis.values).tolist()  # string arrays have no stable specification in Zarr 3
    return attributes


def fill_value(dtype: np.dtype) -> Any:
    """What stands where no member is: NaN, 0 or False."""
    return dtype.type(np.nan if dtype.kind == "f" else 0)


def canonical(value: Any) -> str:
    """JSON in one spelling."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"))


def digest(config: Any) -> str:
    """SHA-256 of a configuration."""
    return hashlib.sha256(canonical(config).encode()).hexdigest()

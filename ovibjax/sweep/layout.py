"""What the members of a sweep have in common: axes, outputs and their coordinates."""

import re
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from ovibjax.errors import InputError
from ovibjax.sweep.grid import Axis, Grid

_OWN_NAMES = ("finished", "diverged")


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
class Layout:
    """What a store holds, whatever members.

    Attributes:
        units: unit of each axis, in the order of the first command's grid.
        named: axes whose values are names.
        groups: dimensions of that grid, each a tuple of axis names that advance together; only the order in which the
            store is shown depends on them, no member does.
        variables: outputs by name; dots are allowed.
        coords: values of dimensions of the outputs; a dimension may have none.
    """

    units: dict[str, str]
    named: frozenset[str]
    groups: tuple[tuple[str, ...], ...]
    variables: dict[str, Variable]
    coords: dict[str, Axis]


def layout_of(grid: Grid, variables: dict[str, Variable], coords: dict[str, Axis]) -> Layout:
    """The layout of a grid with its outputs.

    Raises:
        InputError: names that clash, types that a file cannot hold, dimensions that do not fit.
    """
    sizes: dict[str, int] = {}
    arrays = {dim: Variable((len(a.values),), np.asarray(a.values).dtype, (dim,)) for dim, a in coords.items()}
    for name, variable in [*arrays.items(), *variables.items()]:
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
    names = [*_OWN_NAMES, *grid.axes, *(set(grid.dims) - set(grid.axes)), *sizes, *variables]
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise InputError(f"{twice[0]!r} names two things in this sweep (or is the store's own name); rename one")
    units = {name: axis.unit for name, axis in grid.axes.items()}
    return Layout(units, frozenset(filter(grid.has_names, grid.axes)), grid.groups, variables, coords)


def described(layout: Layout) -> dict[str, Any]:
    """A layout as JSON."""
    return {**compared(layout), "groups": [list(group) for group in layout.groups]}


def compared(layout: Layout) -> dict[str, Any]:
    """The part of a layout, as JSON, that all commands on one store share: not the dimensions that its axes span."""
    return {
        "axes": {
            name: {"unit": unit, "values": "names" if name in layout.named else "numbers"}
            for name, unit in layout.units.items()
        },
        "variables": {
            name: {"shape": list(v.shape), "dtype": np.dtype(v.dtype).name, "dims": list(v.dims), "unit": v.unit}
            for name, v in layout.variables.items()
        },
        "coords": {
            name: {"values": np.asarray(a.values).tolist(), "unit": a.unit} for name, a in layout.coords.items()
        },
    }


def from_description(given: dict[str, Any]) -> Layout:
    """The layout that JSON describes."""
    return Layout(
        {name: axis["unit"] for name, axis in given["axes"].items()},
        frozenset(name for name, axis in given["axes"].items() if axis["values"] == "names"),
        tuple(tuple(group) for group in given["groups"]),
        {
            name: Variable(tuple(v["shape"]), np.dtype(v["dtype"]), tuple(v["dims"]), v["unit"])
            for name, v in given["variables"].items()
        },
        {name: Axis(tuple(a["values"]), a["unit"]) for name, a in given["coords"].items()},
    )


def columns_of(layout: Layout) -> dict[str, tuple[np.dtype, tuple[int, ...]]]:
    """Type and shape of what every table holds of each output."""
    return {f"out.{name}": (np.dtype(v.dtype), v.shape) for name, v in layout.variables.items()}

"""Rows of members as a labelled dataset: the grid that was asked for, or the smallest that holds all of them."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray

from ovibjax.sweep.grid import Axis, Grid
from ovibjax.sweep.layout import Layout
from ovibjax.sweep.members import DIVERGED, grid_keys, point_keys, row_codes, row_keys
from ovibjax.sweep.program import SEED

_MOST_HOLE_BYTES = 1 << 26
"""A grid whose holes are more than its members, and take more than this, is shown as a list of members."""


def assemble(layout: Layout, grid: Grid, rows: np.ndarray | None, attributes: dict[str, Any]) -> xarray.Dataset:
    """Members as a dataset with a grid's dimensions.

    Args:
        layout: what members have.
        grid: the grid to show; members outside it are left out.
        rows: the members, or None.
        attributes: of the dataset.

    Returns:
        Variables [dimensions of the grid, ...]; members not finished are NaN, 0 or False, and `finished` and
        `diverged` tell. Coordinates have their values or names; those of zipped axes lie along their common
        dimension.
    """
    at, taken = _places(grid, rows)

    def spread(column: str, dtype: np.dtype, shape: tuple[int, ...]) -> np.ndarray:
        flat = np.full((grid.size, *shape), fill_value(dtype), dtype)
        if rows is not None:
            flat[at] = rows[column][taken]
        return flat.reshape(*grid.shape, *shape)

    finished = np.zeros(grid.size, bool)
    finished[at] = True
    data: dict[str, Any] = {"finished": (grid.dims, finished.reshape(grid.shape))}
    data["diverged"] = (grid.dims, spread(DIVERGED, np.dtype(bool), ()))
    for name, v in layout.variables.items():
        data[name] = ((*grid.dims, *v.dims), spread(f"out.{name}", np.dtype(v.dtype), v.shape), attributes_of(v.unit))
    coords = {name: (grid.dims[grid.group_of(name)], axis) for name, axis in grid.axes.items()}
    coords |= {dim: (dim, axis) for dim, axis in layout.coords.items()}
    return xarray.Dataset(
        data,
        {name: (dim, np.asarray(axis.values), attributes_of(axis.unit)) for name, (dim, axis) in coords.items()},
        attributes,
    )


def _places(grid: Grid, rows: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Flat places in a grid of the rows that belong there, and which rows these are."""
    place = {key: i for i, key in enumerate(grid_keys(grid))} if rows is not None else {}
    keys = [] if rows is None else row_keys(rows, list(grid.axes))
    found = [(place[key], n) for n, key in enumerate(keys) if key in place]
    at, taken = np.array(found, int).reshape(-1, 2).T
    return at, taken


def union(layout: Layout, rows: np.ndarray | None, asked: Sequence[Grid] = ()) -> tuple[Grid, int]:
    """The smallest grid that holds members and those that were asked for.

    Args:
        layout: axes and their dimensions.
        rows: the members, or None.
        asked: grids of members that are there or to come.

    Returns:
        Every value that occurs on every dimension, ascending (names in their order); axes that advanced together in one
        of the grids do here, and all but the seed where there would be more holes than members. Where too many are
        left, all axes advance together, a member a place. And how many members there are, or are to come.
    """
    parts = [grid.points(np.arange(grid.size), list(layout.units)) for grid in asked]
    values = [{name: _values(grid, name) for name in layout.units} for grid in asked]
    if rows is not None:
        parts.append({name: row_codes(rows, name) for name in layout.units})
        values.append({name: rows[f"value.{name}"] for name in layout.units})
    if not parts:
        return Grid({name: Axis((), unit) for name, unit in layout.units.items()}, layout.groups), 0
    codes = {name: np.concatenate([part[name] for part in parts]) for name in layout.units}
    every = {name: np.concatenate([part[name] for part in values]) for name in layout.units}
    members = len(set(point_keys(codes)))
    groups = _joined([*layout.groups, *(group for grid in asked for group in grid.groups)])
    grid = _grid(layout, codes, every, groups)
    if grid.size > 2 * members and max(map(len, groups)) > 1:  # a search beside a grid, or another one
        apart = tuple(group for group in groups if SEED in group)
        points = tuple(name for name in layout.units if not any(name in group for group in apart))
        grid = _grid(layout, codes, every, _joined([points, *apart]))
    item_bytes = sum(v.dtype.itemsize * int(np.prod(v.shape)) for v in layout.variables.values())
    holes = grid.size - members
    if holes > members and holes * item_bytes > _MOST_HOLE_BYTES:
        grid = _grid(layout, codes, every, (tuple(layout.units),))
    return grid, members


def _joined(groups: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Groups of axes with those that share an axis as one, in the order of the axes."""
    order = list(dict.fromkeys(axis for group in groups for axis in group))
    sets = [{axis} for axis in order]
    for group in groups:
        touched = [one for one in sets if not one.isdisjoint(group)]
        sets = [one for one in sets if one.isdisjoint(group)] + [set[str]().union(*touched)]
    joined = (tuple(filter(one.__contains__, order)) for one in sets)
    return sorted(joined, key=lambda group: order.index(group[0]))


def _values(grid: Grid, axis: str) -> np.ndarray:
    """Values of an axis, not as the member function sees them, at every member of a grid."""
    at = np.unravel_index(np.arange(grid.size), grid.shape)[grid.group_of(axis)]
    return np.asarray(grid.axes[axis].values)[at]


def _grid(
    layout: Layout,
    all_codes: Mapping[str, np.ndarray],
    values: Mapping[str, np.ndarray],
    groups: Sequence[tuple[str, ...]],
) -> Grid:
    axes: dict[str, Axis] = {}
    for group in groups:
        codes = {name: all_codes[name] for name in group}
        order = np.lexsort(list(codes.values())[::-1])
        new = np.ones(len(order), bool)
        new[1:] = np.any([code[order][1:] != code[order][:-1] for code in codes.values()], axis=0)
        kept = order[new]
        for name in group:
            numbers = codes[name][kept].tolist() if name in layout.named else None
            axes[name] = Axis(tuple(values[name][kept].tolist()), layout.units[name], numbers)
    return Grid({name: axes[name] for name in layout.units}, tuple(groups))


def attributes_of(unit: str) -> dict[str, str]:
    """Attributes of an array: its unit."""
    return {"units": unit} if unit else {}


def fill_value(dtype: np.dtype) -> Any:
    """What stands where no member is: NaN, 0 or False."""
    return dtype.type(np.nan if dtype.kind == "f" else 0)

"""A grid of members: named axes and the dimensions that they span."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ovibjax.errors import InputError


@dataclass(frozen=True)
class Axis:
    """Values of one axis with their unit.

    Attributes:
        values: numbers (floats are passed as float32, integers as int32, booleans as bool), or names (passed as their
            index, int32).
        unit: unit of the values, e.g. "m"; empty for none.
        numbers: index of each name where it is not its position, as in a few names of a longer list.
    """

    values: Sequence[Any]
    unit: str = ""
    numbers: Sequence[int] | None = None


@dataclass(frozen=True)
class Grid:
    """Axes of a sweep and the dimensions they span.

    Attributes:
        axes: axes by name.
        groups: the dimensions, each a tuple of axis names that advance together; most hold one.
    """

    axes: dict[str, Axis]
    groups: tuple[tuple[str, ...], ...]

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the dimensions; axes that are zipped share one, named after them."""
        return tuple("_".join(group) for group in self.groups)

    @property
    def shape(self) -> tuple[int, ...]:
        """Length of each dimension."""
        return tuple(len(self.axes[group[0]].values) for group in self.groups)

    @property
    def size(self) -> int:
        """Number of members."""
        return int(np.prod(self.shape))

    def group_of(self, axis: str) -> int:
        """Position of the dimension an axis belongs to."""
        return next(i for i, group in enumerate(self.groups) if axis in group)

    def has_names(self, axis: str) -> bool:
        """Whether the values of an axis are names, which the member function sees as their index."""
        return np.asarray(self.axes[axis].values).dtype.kind == "U"

    def codes(self, axis: str) -> np.ndarray:
        """Values of one axis as the member function sees them: float32, int32 or bool."""
        values = np.asarray(self.axes[axis].values)
        if self.has_names(axis):
            numbers = self.axes[axis].numbers
            return np.arange(len(values), dtype=np.int32) if numbers is None else np.asarray(numbers, np.int32)
        return values.astype({"f": np.float32, "i": np.int32, "u": np.int32, "b": np.bool_}[values.dtype.kind])

    def points(self, members: np.ndarray, axes: Sequence[str]) -> dict[str, np.ndarray]:
        """Values of some axes at members.

        Args:
            members: [...] flat indices into the grid.
            axes: names of the axes.

        Returns:
            Per axis an array [...].
        """
        index = np.unravel_index(members, self.shape)
        return {axis: self.codes(axis)[index[self.group_of(axis)]] for axis in axes}


def make_grid(axes: Mapping[str, Any], zipped: Sequence[Sequence[str]] = ()) -> Grid:
    """Check axes and arrange them.

    Args:
        axes: name to values, or to an `Axis`.
        zipped: groups of axis names that advance together instead of crossing.

    Returns:
        The grid; its dimensions keep the order of `axes`.

    Raises:
        InputError: an empty, repeated, non-finite or non-numeric axis, or unequal lengths of zipped axes.
    """
    if not axes:
        raise InputError("the grid has no axis")
    made = {
        name: axis if isinstance(axis, Axis) else Axis(tuple(np.atleast_1d(_array(name, axis)).tolist()))
        for name, axis in axes.items()
    }
    for name, axis in made.items():
        _check(name, axis)
    for other in (name for group in zipped for name in group):
        if other not in made:
            raise InputError(f"zipped axis {other!r} is not in the grid; it has {', '.join(made)}")
    groups: list[tuple[str, ...]] = []
    for name in made:
        group = tuple(next((g for g in zipped if name in g), (name,)))
        for other in group:
            if len(made[other].values) != len(made[group[0]].values):
                raise InputError(f"zipped axes {' and '.join(group)} have different lengths")
        if group not in groups:
            groups.append(group)
    if sum(map(len, groups)) != len(made):
        raise InputError("an axis is zipped twice")
    for group in groups:
        grid = Grid({name: made[name] for name in group}, (group,))
        codes = [made[n].values if np.asarray(made[n].values).dtype.kind == "U" else grid.codes(n) for n in group]
        seen: dict[Any, str] = {}
        for row, code in zip(
            zip(*(made[name].values for name in group), strict=True), zip(*codes, strict=True), strict=True
        ):
            said = ", ".join(map(str, row))
            if code in seen:
                as_what = "" if said == seen[code] else f", in 32 bits it is {seen[code]}"
                raise InputError(f"{' and '.join(group)}: {said} is given twice{as_what}")
            seen[code] = said
    return Grid(made, tuple(groups))


def _array(name: str, values: Any) -> np.ndarray:
    """Values as an array that keeps numbers and names apart."""
    try:
        array = np.asarray(values)
    except ValueError as error:  # ragged
        raise InputError(f"axis {name}: values are numbers or names, all of one kind, not {values!r}") from error
    if array.dtype.kind == "U" and array.ndim and not all(isinstance(v, str) for v in values):
        raise InputError(f"axis {name}: values are numbers or names, all of one kind, not {values!r}")
    return array


def _check(name: str, axis: Axis) -> None:
    if not name.isidentifier():
        raise InputError(f"axis name {name!r} is not a plain word")
    if len(axis.values) == 0:
        raise InputError(f"axis {name} has no values")
    values = _array(name, axis.values)
    if values.ndim != 1 or values.dtype.kind not in "fiubU":
        raise InputError(f"axis {name}: values are numbers or names, all of one kind, not {axis.values!r}")
    if axis.numbers is not None and (values.dtype.kind != "U" or len(axis.numbers) != len(values)):
        raise InputError(f"axis {name}: numbers are those of names, one of each")
    if values.dtype.kind == "f" and not (np.abs(values) <= np.finfo(np.float32).max).all():
        odd = values[~(np.abs(values) <= np.finfo(np.float32).max)][0]
        raise InputError(f"axis {name}: {odd} is not a finite number of 32 bits")
    if values.dtype.kind in "iu":
        odd = next((v for v in values.tolist() if abs(v) > 2**31 - 1), None)
        if odd is not None:
            raise InputError(f"axis {name}: {odd} does not fit 32 bits")

"""Conditions as they are typed, `beta>=0.1`, and the part of a sweep's results that keeps them."""

import re
from collections.abc import Callable, Sequence

import numpy as np
import xarray as xr

from ovibjax.errors import InputError
from ovibjax.report.labels import axes_of, find, grid_dims, items_of, listing, matches, same_number, text_of
from ovibjax.runtime.plain_numbers import plain_float

_ORDER: dict[str, Callable[[np.ndarray, float], np.ndarray]] = {
    # A value that is the number to float32 accuracy is the number: 0.1 is kept by beta<=0.1, however it was stored.
    "<=": lambda values, number: (values < number) | same_number(values, number),
    ">=": lambda values, number: (values > number) | same_number(values, number),
    "<": lambda values, number: (values < number) & ~same_number(values, number),
    ">": lambda values, number: (values > number) & ~same_number(values, number),
}


def taken_apart(condition: str) -> tuple[str, str, str] | None:
    """Name, sign and value of a condition.

    Args:
        condition: e.g. `beta>=0.1`; signs are =, !=, <, <=, > and >=.

    Returns:
        The three; None for text of another form.

    Example:
        >>> taken_apart("beta >= 0.1")
        ('beta', '>=', '0.1')
    """
    found = re.fullmatch(r"\s*([^=<>!]+?)\s*(<=|>=|!=|==|<|>|=)\s*(.+?)\s*", condition)
    if found is None:
        return None
    name, sign, value = found.groups()
    return name, "=" if sign == "==" else sign, value


def select(dataset: xr.Dataset, where: Sequence[str]) -> xr.Dataset:
    """Keep the points at which axes have given values; every dimension stays, if only with length one.

    Args:
        dataset: results.
        where: conditions that must all hold: `AXIS=VALUE`, `AXIS=VALUE,VALUE,...` or `AXIS!=VALUE,...`, and for axes
            of numbers `AXIS>=VALUE`, likewise with <=, < and >; numbers match to float32 accuracy.

    Returns:
        The selected part.

    Raises:
        InputError: an entry of another form, an unknown axis, a value that the axis does not have, or no value that
            keeps the condition; or there is no member yet.
    """
    if any(dataset.sizes[dim] == 0 for dim in grid_dims(dataset)):
        raise InputError("there is no member yet; start its command, or wait for the first (show --watch does)")
    for entry in where:
        axes, parts = axes_of(dataset), taken_apart(entry)
        if parts is None:
            raise InputError(
                f"--where {entry}: write AXIS=VALUE, AXIS=VALUE,VALUE or in quotes 'AXIS>=VALUE' "
                f"(axes: {', '.join(axes)})"
            )
        axis, sign, wanted = parts
        dim = axes[find(axis, axes, "axis")]
        values = dataset[axis].values
        keep = _ordered(entry, values, sign, wanted) if sign in _ORDER else _listed(entry, axis, values, wanted)
        if sign == "!=":
            keep = ~keep
        if not keep.any():
            raise InputError(f"--where {entry}: no value of {axis} is; it has {listing(values)}")
        if not keep.all():
            dataset = dataset.isel({dim: np.flatnonzero(keep)})
    return dataset


def _ordered(entry: str, values: np.ndarray, sign: str, wanted: str) -> np.ndarray:
    """Where numbers compare so."""
    if values.dtype.kind not in "fiu":
        raise InputError(f"--where {entry}: its values are names ({listing(values)}); compare them with = or !=")
    try:
        number = plain_float(wanted)
    except ValueError:
        raise InputError(f"--where {entry}: {wanted!r} is not a number; it has {listing(values)}") from None
    return _ORDER[sign](values.astype(np.float64), number)


def _listed(entry: str, axis: str, values: np.ndarray, wanted: str) -> np.ndarray:
    """Where an axis has one of the values in a list."""
    keep = np.zeros(len(values), bool)
    for part in items_of(wanted, map(text_of, values)):
        match = matches(values, part)
        if not match.any():
            raise InputError(f"--where {entry}: {axis} has no value {part!r}; it has {listing(values)}")
        keep |= match
    return keep

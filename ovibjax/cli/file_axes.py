"""Axes of a sweep file with the values, or ranges, that were typed: `--axis NAME=VALUE,VALUE`."""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ovibjax.cli.options import integers, numbers
from ovibjax.cli.search import SearchOptions, range_or_none, searched
from ovibjax.errors import InputError
from ovibjax.sweep.sampling import Range, parse

if TYPE_CHECKING:
    from ovibjax.sweep.from_file import SweepFile
    from ovibjax.sweep.grid import Axis

_LARGEST = 2**31 - 1
_LARGEST_FLOAT = 3.4028234663852886e38


def drawn_axes(
    axes: Mapping[str, "Axis | Range"], file: "SweepFile", search: SearchOptions
) -> tuple[dict[str, "Axis"], list[tuple[str, ...]]]:
    """Axes with points in place of ranges, and the groups of them that advance together.

    Args:
        axes: as `asked_axes` gives them.
        file: what the file says.
        search: how points are drawn.

    Returns:
        All axes, and the groups of the file and of the search.

    Raises:
        InputError: a range without a number of points, the reverse, or a range that the file zips with values.
    """
    values, groups = searched(axes, search, "--axis {}=".format)
    drawn = {name for group in groups for name in group}
    for group in file.options["zipped"]:
        apart = [name for name in group if name not in drawn]
        if not apart:
            continue  # the search zips them
        if len(apart) < len(group):
            given = next(name for name in group if name in drawn)
            raise InputError(f"--axis {given}: {file.path} zips it with {apart[0]}; give a range for both, or for none")
        groups.append(group)
    return {
        name: replace(file.axes[name], values=values[name]) if name in drawn else values[name] for name in axes
    }, groups


def asked_axes(entries: Sequence[str], file: "SweepFile") -> dict[str, "Axis | Range"]:
    """The axes of a file with the values, or ranges, that were typed.

    Args:
        entries: `NAME=VALUE,VALUE` each.
        file: what the file says.

    Returns:
        All axes of the file, in its order; names have the number of their place in the file.

    Raises:
        InputError: an entry of another form, an axis that the file does not have, or an impossible value.
    """
    axes: dict[str, Axis | Range] = dict(file.axes)
    given = set[str]()
    for entry in entries:
        name, equals, typed = entry.partition("=")
        if not equals or not typed:
            raise InputError(f"--axis {entry}: write NAME=VALUE,VALUE (axes: {', '.join(axes)})")
        if name not in axes:
            near = difflib.get_close_matches(name, list(axes), n=1)
            hint = f"did you mean {near[0]}? " if near else ""
            raise InputError(f"--axis {entry}: {file.path} has no axis {name}; {hint}it has {', '.join(axes)}")
        if name in given:
            raise InputError(f"--axis {entry}: values of {name} are given twice; write all after one {name}=")
        given.add(name)
        axis = file.axes[name]
        known, numbers = list(axis.values), axis.numbers
        if (drawn := _range(name, typed, known)) is not None:
            axes[name] = drawn
            continue
        values = _values(name, typed, known)
        if isinstance(known[0], str) and values != known:  # whichever are asked for, a name keeps its number
            places = [known.index(value) for value in values]
            numbers = places if numbers is None else [numbers[place] for place in places]
        axes[name] = replace(axis, values=tuple(values), numbers=numbers)
    return axes


def _range(name: str, typed: str, known: list[Any]) -> Range | None:
    """The range that was typed for an axis of numbers; None where values were."""
    import numpy as np

    kind = np.asarray(known).dtype.kind
    if kind in "Ub":
        if typed not in known and parse(typed) is not None:
            raise InputError(
                f"--axis {name}={typed}: its values are no numbers; list them: {', '.join(map(str, known))}"
            )
        return None
    return range_or_none(f"--axis {name}=", typed.split(","), lambda _: True, "numbers", whole=kind != "f")


def _values(name: str, typed: str, known: list[Any]) -> list[Any]:
    """Values of an axis as typed, of the kind that the file's are."""
    import numpy as np

    from ovibjax.report.labels import items_of

    items = items_of(typed, [str(value) for value in known])
    kind = np.asarray(known).dtype.kind
    if kind == "U":
        for item in items:
            if item not in known:
                raise InputError(f"--axis {name}={item}: no such name; the file has {', '.join(known)}")
        return items
    if kind == "b":
        truths = {"true": True, "1": True, "false": False, "0": False}
        for item in items:
            if item.lower() not in truths:
                raise InputError(f"--axis {name}={item}: values are true and false")
        return [truths[item.lower()] for item in items]
    if kind in "iu":
        return integers(f"axis {name}", items, -_LARGEST, _LARGEST)
    reals = numbers(f"axis {name}", items, lambda value: abs(value) <= _LARGEST_FLOAT, "numbers of 32 bits")
    # What the member function could not tell from a value of the file is that value.
    same = {np.float32(value): value for value in known}
    return [same.get(np.float32(value), value) for value in reals]

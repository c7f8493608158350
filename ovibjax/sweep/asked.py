"""What commands asked a store for: their grids, so that a reader knows which members are still to come.

`asked/` of a store holds a JSON file per grid, named after a digest of it. Members do not depend on these files:
without them a store shows what it has, and a grid that is no longer wanted goes with its file.
"""

import hashlib
import json
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np

from ovibjax.sweep.differences import canonical
from ovibjax.sweep.disk import of_this_process
from ovibjax.sweep.grid import Axis, Grid
from ovibjax.sweep.layout import Layout

_FOLDER = "asked"
_EXPECTED = "expected"


def announce(store: Path, grid: Grid) -> None:
    """Note that a grid was asked for; the same one is noted once, whoever does it.

    Args:
        store: the folder.
        grid: the grid.

    Raises:
        OSError: the disk refuses.
    """
    axes = {
        name: {"values": np.asarray(axis.values).tolist()}
        | ({"numbers": grid.codes(name).tolist()} if grid.has_names(name) else {})
        for name, axis in grid.axes.items()
    }
    text = canonical({"axes": axes, "groups": [list(group) for group in grid.groups]})
    folder = store / _FOLDER
    file = folder / f"{hashlib.sha256(text.encode()).hexdigest()[:24]}.json"
    if file.exists():
        return
    folder.mkdir(exist_ok=True)
    partial = file.with_name(f"{file.name}.{of_this_process()}.partial")
    try:
        partial.write_text(text, encoding="utf-8")
        partial.replace(file)
    except BaseException:
        with suppress(OSError):  # the first error is the one to tell
            partial.unlink(missing_ok=True)
        raise


def asked_grids(store: Path, layout: Layout) -> Iterator[Grid]:
    """The grids that a store was asked for; files that do not fit it say nothing.

    Args:
        store: the folder.
        layout: axes of the store.

    Yields:
        Grids of all its axes.
    """
    for file in sorted((store / _FOLDER).glob("*.json")):
        with suppress(OSError, ValueError, KeyError, TypeError, AttributeError):
            given = json.loads(file.read_text(encoding="utf-8"))
            axes = {
                name: Axis(tuple(given["axes"][name]["values"]), unit, given["axes"][name].get("numbers"))
                for name, unit in layout.units.items()
            }
            groups = tuple(tuple(group) for group in given["groups"])
            filled = all(len(axis.values) for axis in axes.values())
            if filled and {name for group in groups for name in group} == axes.keys():
                yield Grid(axes, groups)


def expect(store: Path | None, members: int | None) -> None:
    """Note how many members a store will hold at least, where which ones is found out on the way; None for an end.

    Args:
        store: the folder; nothing is noted where there is none.
        members: how many.
    """
    if store is None:
        return
    file = store / _FOLDER / _EXPECTED
    with suppress(OSError):  # only readers need it
        if members is None:
            file.unlink(missing_ok=True)
        else:
            file.parent.mkdir(exist_ok=True)
            file.write_text(str(members), encoding="utf-8")


def expected(store: Path | None) -> int:
    """How many members a store will hold at least; 0 if nothing is noted."""
    with suppress(OSError, ValueError):
        return 0 if store is None else int((store / _FOLDER / _EXPECTED).read_text(encoding="utf-8"))
    return 0

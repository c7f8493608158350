"""Members of a store in the format of before (Zarr arrays of fixed size), brought over into one that grows."""

from pathlib import Path
from typing import Any

import numpy as np
import zarr

from ovibjax.errors import InputError, one_line
from ovibjax.sweep.grid import Axis, Grid
from ovibjax.sweep.head import is_store
from ovibjax.sweep.layout import Variable, layout_of
from ovibjax.sweep.members import DIGEST_BYTES, rows_of
from ovibjax.sweep.store import Store


def upgrade(path: str | Path, out: str | Path) -> int:
    """Copy the finished members of an old store into a new one.

    The new store can be read and shown. It cannot grow: its members were computed by another program, whose bits may
    differ.

    Args:
        path: the old store, which stays as it is.
        out: the new one.

    Returns:
        Members brought over.

    Raises:
        InputError: no such store, a damaged one, or `out` cannot be used.
    """
    path = Path(path)
    if is_store(path):
        raise InputError(f"{path} has today's format already; there is nothing to bring over")
    try:
        group = zarr.open_group(path, mode="r", zarr_format=3)
        config, grid, variables, coords = _described(dict(group.attrs))
        members = _array(group, "grid_index")
        finished = _array(group, "finished")
        real = (members >= 0) & np.repeat(finished, len(members) // len(finished))
        outputs = {name: _array(group, name)[real] for name in variables}
        diverged = _array(group, "diverged")[real]
        digest = bytes.fromhex(config["data"])[:DIGEST_BYTES]
    except Exception as error:  # foreign or damaged metadata fail anywhere in the parsers
        raise InputError(f"{path} is no store of the format of before, or damaged ({one_line(error)})") from error
    rows = rows_of(grid, members[real], [digest] * int(real.sum()), outputs, diverged)
    with Store.open(out, layout_of(grid, variables, coords), {**config, "upgraded": True}) as kept:
        kept.lock()
        kept.join(rows, path)
    return len(rows)


def _described(attributes: dict[str, Any]) -> tuple[dict[str, Any], Grid, dict[str, Variable], dict[str, Axis]]:
    """Configuration, grid, outputs and their coordinates as an old store describes them."""
    if attributes["format"] != 1:
        raise ValueError(f"its format is {attributes['format']!r}, not 1")
    layout = attributes["layout"]

    def axes(given: dict[str, Any]) -> dict[str, Axis]:
        return {name: Axis(tuple(axis["values"]), axis["unit"]) for name, axis in given.items()}

    variables = {
        name: Variable(tuple(v["shape"]), np.dtype(v["dtype"]), tuple(v["dims"]), v["unit"])
        for name, v in layout["variables"].items()
    }
    grid = Grid(axes(layout["axes"]), tuple(tuple(names) for names in layout["groups"]))
    return attributes["config"], grid, variables, axes(layout["coords"])


def _array(group: zarr.Group, name: str) -> np.ndarray:
    array: Any = group[name]
    return np.asarray(array[:])

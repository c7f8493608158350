"""Members as rows of a table: what defines one, and what it gave.

A member is found by its point. A table has a row per member: its values on every axis, a digest of the data that it
saw, its outputs, and whether one of them is not finite. Tables of one sweep are concatenated freely; a member that
stands in several counts once, as its bits are the same in all of them.
"""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import jax
import numpy as np

from ovibjax.sweep.grid import Axis, Grid

DATA, DIVERGED = "data", "diverged"
"""Columns of a table beside `value.AXIS`, `code.AXIS` where values are names, and `out.OUTPUT`."""

DIGEST_BYTES = 16


def data_digest(shared: Any) -> bytes:
    """What identifies data: paths, types, shapes and values of all leaves."""
    digest = hashlib.blake2b(digest_size=DIGEST_BYTES)
    for path, leaf in jax.tree_util.tree_leaves_with_path(shared):
        array = np.ascontiguousarray(np.asarray(leaf))
        digest.update(f"{jax.tree_util.keystr(path)} {array.dtype} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.digest()


def rows_of(
    grid: Grid,
    members: np.ndarray,
    data: Sequence[bytes],
    outputs: Mapping[str, np.ndarray],
    diverged: np.ndarray,
) -> np.ndarray:
    """Members as rows.

    Args:
        grid: the grid.
        members: [n] flat indices into it.
        data: digest of the data of each.
        outputs: [n, ...] what each gave.
        diverged: [n] bool.

    Returns:
        [n] structured array.
    """
    index = np.unravel_index(members, grid.shape)
    columns: dict[str, np.ndarray] = {}
    for name, axis in sorted(grid.axes.items()):  # whatever the order of the command's
        at = index[grid.group_of(name)]
        values = np.asarray(axis.values)
        columns[f"value.{name}"] = values[at]
        if values.dtype.kind == "U":
            columns[f"code.{name}"] = grid.codes(name)[at]
    columns[DATA] = np.frombuffer(b"".join(data), np.uint8).reshape(-1, DIGEST_BYTES)
    columns[DIVERGED] = np.asarray(diverged, bool)
    columns |= {f"out.{name}": values for name, values in sorted(outputs.items())}
    rows = np.empty(len(members), [(name, column.dtype, column.shape[1:]) for name, column in columns.items()])
    for name, column in columns.items():
        rows[name] = column
    return rows


def point_keys(columns: Mapping[str, np.ndarray]) -> list[bytes]:
    """What tells points apart.

    Args:
        columns: [n] value on each axis, as the member function sees it.

    Returns:
        A key per point.
    """
    parts = [np.ascontiguousarray(columns[name]).reshape(-1, 1).view(np.uint8) for name in sorted(columns)]
    return [row.tobytes() for row in np.concatenate(parts, axis=1)]


def grid_keys(grid: Grid) -> list[bytes]:
    """Keys of every member of a grid, in its flat order."""
    return point_keys(grid.points(np.arange(grid.size), list(grid.axes)))


def row_keys(rows: np.ndarray, axes: Sequence[str]) -> list[bytes]:
    """Keys of rows."""
    return point_keys({name: row_codes(rows, name) for name in axes})


def row_codes(rows: np.ndarray, axis: str) -> np.ndarray:
    """[n] values of an axis as the member function sees them."""
    if f"code.{axis}" in (rows.dtype.names or ()):
        return np.asarray(rows[f"code.{axis}"])
    return Grid({axis: Axis(rows[f"value.{axis}"].tolist())}, ((axis,),)).codes(axis)


def together(tables: Iterable[np.ndarray], axes: Sequence[str]) -> np.ndarray | None:
    """Tables as one, every member once; None if there is none."""
    kept = [rows for rows in tables if len(rows)]
    if not kept:
        return None
    every = kept[0] if len(kept) == 1 else np.concatenate(kept)
    first: dict[bytes, int] = {}
    for position, key in enumerate(row_keys(every, axes)):
        first.setdefault(key, position)
    return every if len(first) == len(every) else every[list(first.values())]


def unequal(mine: np.ndarray, others: np.ndarray, axes: Sequence[str]) -> int:
    """How many of other rows are among one's own with other outputs."""
    at = {key: position for position, key in enumerate(row_keys(mine, axes))}
    common = [(at[key], n) for n, key in enumerate(row_keys(others, axes)) if key in at]
    outputs = [name for name in others.dtype.names or () if name.startswith("out.")]
    return sum(any(mine[name][i].tobytes() != others[name][n].tobytes() for name in outputs) for i, n in common)


def digests_of(rows: np.ndarray) -> list[bytes]:
    """Digest of the data that each row saw."""
    return [digest.tobytes() for digest in rows[DATA]]


def names_of(rows: np.ndarray, axis: str) -> dict[int, str]:
    """Names of an axis by the number they are passed as."""
    return dict(zip(row_codes(rows, axis).tolist(), rows[f"value.{axis}"].tolist(), strict=True))


def name_clash(there: Mapping[int, str], here: Mapping[int, str]) -> str | None:
    """What is wrong if a name has one number there and another here, so that two members could be taken for one."""
    for number, name in here.items():
        if there.get(number, name) != name:
            return f"number {number} is {there[number]} there and {name} here"
        numbers = [other for other, known in there.items() if known == name]
        # Zipped axes may name one value at several places; some of them may not be there yet.
        if numbers and not any(here.get(other) == name for other in numbers):
            return f"{name} is number {numbers[0]} there and {number} here"
    return None

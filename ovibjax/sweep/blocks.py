"""Files of finished members: written once, never changed, found by listing their folder.

A block is a table with a row per member, saved as a NumPy file without pickle. It is written aside and renamed, so that
a reader sees all of it or nothing, and it is named after a digest of its bytes: any number of processes may write to
one folder without a lock, as two blocks of one name have one content.
"""

import hashlib
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from io import BytesIO
from pathlib import Path

import numpy as np

from ovibjax.errors import InputError, one_line
from ovibjax.sweep.disk import is_abandoned, of_this_process

Columns = Mapping[str, tuple[np.dtype, tuple[int, ...]]]
"""Type and shape of columns of a table."""

_NAME = re.compile(r"(?P<count>\d+)-(?P<digest>[0-9a-f]{24})\.npy")
_PARTIAL = re.compile(r"\d+-[0-9a-f]{24}\.npy\.(?P<owner>.+)\.partial")
# NumPy bounds what it parses of files that may be hostile; a table may well have a thousand columns.
_MOST_HEADER_BYTES = 1 << 20


def write_block(folder: Path, rows: np.ndarray) -> Path:
    """Write one block.

    Args:
        folder: where blocks are; it exists.
        rows: [n] structured array.

    Returns:
        Its file.

    Raises:
        OSError: the disk refuses; nothing is left under the block's name.
    """
    buffer = BytesIO()
    # Version 3.0 holds any name of a column.
    np.lib.format.write_array(buffer, rows, version=(3, 0), allow_pickle=False)
    content = buffer.getbuffer()
    final = folder / f"{len(rows)}-{_digest(content)}.npy"
    partial = final.with_name(f"{final.name}.{of_this_process()}.partial")
    try:
        with partial.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(final)
    except BaseException:
        with suppress(OSError):  # the first error is the one to tell
            partial.unlink(missing_ok=True)
        raise
    return final


def read_blocks(folder: Path, columns: Columns) -> Iterator[np.ndarray]:
    """Every block of a folder, in the order of their names.

    Args:
        folder: where blocks are.
        columns: what a block must have.

    Yields:
        [n] structured arrays.

    Raises:
        InputError: a block is damaged.
    """
    known: dict[bytes, np.dtype] = {}  # parsing a header takes longer than all else
    for name in sorted(path.name for path in folder.iterdir()):
        found = _NAME.fullmatch(name)
        if found is None:
            continue
        path = folder / name
        try:
            content = path.read_bytes()
            if _digest(content) != found["digest"]:
                raise ValueError("its checksum does not fit")
            header = content[: 12 + int.from_bytes(content[8:12], "little")]
            if header not in known:
                known[header] = _dtype_of(content, int(found["count"]), columns)
            yield np.frombuffer(content, known[header], int(found["count"]), len(header))
        except (OSError, ValueError, EOFError) as error:
            raise InputError(
                f"{path} is damaged ({one_line(error)}); remove it and repeat the command to compute its members again"
            ) from error


def count_members(folder: Path) -> int:
    """Members in the blocks of a folder, by their names; one that stands in two blocks is counted twice."""
    found = (_NAME.fullmatch(path.name) for path in folder.glob("*.npy"))
    return sum(int(name["count"]) for name in found if name is not None)


def remove_abandoned(folder: Path) -> None:
    """Remove what killed processes of this machine left half written."""
    for path in folder.glob("*.partial"):
        found = _PARTIAL.fullmatch(path.name)
        if found is not None and is_abandoned(found["owner"]):
            path.unlink(missing_ok=True)


def _digest(content: bytes | memoryview) -> str:
    return hashlib.blake2b(content, digest_size=12).hexdigest()


def _dtype_of(content: bytes, count: int, columns: Columns) -> np.dtype:
    """Type of a block's rows; a ValueError if it is not the table that its name and its store say."""
    rows = np.load(BytesIO(content), allow_pickle=False, max_header_size=_MOST_HEADER_BYTES)
    fields = rows.dtype.fields or {}
    kinds = {name: (field[0].base, field[0].shape) for name, field in fields.items()}
    if rows.shape != (count,) or any(kinds.get(name) != kind for name, kind in columns.items()):
        raise ValueError("it holds another table than the store says")
    return rows.dtype

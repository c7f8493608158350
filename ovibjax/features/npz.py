"""Arrays of numbers and text in `.npz` archives that nobody vouches for; nothing is ever unpickled."""

import difflib
import io
import math
import os
import secrets
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from ovibjax.errors import InputError, StrPath, refusal, unreadable

MAX_TOTAL_BYTES = 16 * 2**30
"""Largest archive accepted, unpacked."""

_HEAD_BYTES = 16 * 2**10  # numpy itself refuses array headers over 10,000 characters
_CHUNK_BYTES = 16 * 2**20
_DEFLATE_MAX_RATIO = 1032  # what deflate can reach at all
_PLAIN_KINDS = "iufU"  # integers, real numbers, text


def _header(head: bytes) -> tuple[tuple[int, ...], bool, np.dtype[Any], int]:
    """Shape, Fortran order, dtype and length in bytes of a .npy header."""
    stream = io.BytesIO(head)
    version = npy.read_magic(stream)
    if version not in ((1, 0), (2, 0)):
        # Version 3 exists only for structured arrays, which are refused anyway.
        raise ValueError(f".npy version {version[0]}.{version[1]}")
    read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, fortran_order, dtype = read(stream)
    return shape, fortran_order, dtype, stream.tell()


def _declared_members(file: io.BufferedReader) -> int:
    """Members that the end record of an archive counts.

    `zipfile` ignores that count: where one damaged length swallows the next entry, it drops members silently.
    """
    start = max(0, file.seek(0, os.SEEK_END) - 22 - 2**16)
    file.seek(start)
    tail = file.read()
    at = tail.rfind(b"PK\x05\x06") + 10
    return int.from_bytes(tail[at : at + 2], "little")


def _read_member(archive: zipfile.ZipFile, info: zipfile.ZipInfo, path: Path, key: str) -> NDArray[Any]:
    """One array of an archive; every size is checked against the file before memory is taken."""
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise refusal(path, f"array {key!r} is packed by another method than numpy's; save it with numpy")
    held = info.file_size
    # A directory entry can claim any size; the bytes on disk bound what it can unpack to.
    ratio = 1 if info.compress_type == zipfile.ZIP_STORED else _DEFLATE_MAX_RATIO
    if info.compress_size > path.stat().st_size or held > ratio * info.compress_size:
        raise refusal(path, f"array {key!r} claims {held} bytes, more than the file can hold; it is corrupt")
    with archive.open(info) as member:
        head = member.read(_HEAD_BYTES)
        shape, fortran_order, dtype, start = _header(head)
        if dtype.hasobject:
            raise refusal(path, f"array {key!r} is pickled Python objects, never loaded; save plain numbers")
        if dtype.kind not in _PLAIN_KINDS or dtype.itemsize == 0:
            raise refusal(path, f"array {key!r} has dtype {dtype}, neither real numbers nor text")
        size = math.prod(shape) * dtype.itemsize
        if min(shape, default=0) < 0 or start + size != held:
            raise refusal(path, f"array {key!r} has shape {shape}, {size} bytes, but {held - start} bytes follow")
        raw = np.empty(size, np.uint8)
        done, chunk = 0, head[start:]
        while done < size and chunk:
            raw[done : done + len(chunk)] = np.frombuffer(chunk, np.uint8)
            done += len(chunk)
            chunk = member.read(min(_CHUNK_BYTES, size - done))
        if done < size:
            raise refusal(path, f"array {key!r} is truncated: {done} of {size} bytes")
    array = raw.view(dtype)
    if dtype.kind == "U" and (array.view(np.dtype(np.uint32).newbyteorder(dtype.byteorder)) > 0x10FFFF).any():
        raise refusal(path, f"array {key!r} is not valid text; it is corrupt")
    return array.reshape(shape[::-1]).T if fortran_order else array.reshape(shape)


def read_npz(path: StrPath, required: tuple[str, ...], optional: tuple[str, ...] = ()) -> dict[str, NDArray[Any]]:
    """Read named arrays from an `.npz` archive that nobody vouches for.

    Args:
        path: the archive, stored or deflated.
        required: arrays that must be there.
        optional: arrays that may be there; others are left unread, unless they may be one of these misspelt.

    Returns:
        Arrays of integers, real numbers or text by name, in the dtype and shape of the file.

    Raises:
        InputError: the file is missing, not an archive, truncated, corrupt, too large, lacks an array, seems
            to misspell one, or holds pickled objects.
    """
    path = Path(path)
    known = (*required, *optional)
    place = "the archive"
    try:
        if not path.exists():
            raise refusal(path, "no such file or folder")
        if not path.is_file():
            raise refusal(path, "not a regular file")
        # numpy warns of array headers from Python 2; they load all the same.
        with path.open("rb") as file, zipfile.ZipFile(file) as archive, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            total = sum(info.file_size for info in archive.infolist())
            if len(members) != len(archive.infolist()):
                raise refusal(path, "two arrays share a name; it is corrupt")
            if len(members) != _declared_members(file):
                raise refusal(path, f"corrupt; only {len(members)} of its arrays can be found")
            if total > MAX_TOTAL_BYTES:
                raise refusal(path, f"too large: {total} bytes unpacked, over {MAX_TOTAL_BYTES}; split it")
            for key in required:
                if key not in members:
                    raise refusal(path, f"missing array {key!r}; it needs {', '.join(required)}")
            for key in members.keys() - set(known):
                absent = [name for name in optional if name not in members]
                meant = [name for name in absent if name.startswith(f"{key}_")]
                meant = meant or difflib.get_close_matches(key, absent, n=1, cutoff=0.8)
                if meant:
                    raise refusal(path, f"unknown array {key!r}; did you mean {meant[0]!r}? Rename or remove it")
                # A name stands in two places; where they differ, one is damaged, and may be that of a known array.
                archive.open(members[key]).close()
            arrays = {}
            for key in [key for key in known if key in members]:
                place = f"array {key!r}"
                arrays[key] = _read_member(archive, members[key], path, key)
            return arrays
    except InputError:
        raise
    except Exception as error:
        # Corrupt bytes surface as a dozen exception types of zipfile, zlib, ast and numpy; all mean the same.
        raise unreadable(path, f"not an .npz file or corrupt; {place} cannot be read", error) from error


def write_npz(path: StrPath, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays to an uncompressed `.npz` archive, whole or not at all.

    Args:
        path: the file to write or replace; its folder must exist.
        arrays: plain arrays by name.

    Raises:
        InputError: the folder does not exist, or the system refuses the write.
    """
    path = Path(path)
    # Renaming within one folder is atomic, so a reader sees the old file or the new one, never a part.
    part = path.parent / f".{secrets.token_hex(8)}.part"
    try:
        if not path.parent.is_dir():
            raise refusal(path, "cannot be written: its folder does not exist; create the folder first")
        if path.is_dir():
            raise refusal(path, "cannot be written: it is a folder; name a file in it")
        try:
            with part.open("xb") as handle:
                with zipfile.ZipFile(handle, "w", zipfile.ZIP_STORED) as archive:
                    for key, array in arrays.items():
                        with archive.open(f"{key}.npy", "w", force_zip64=True) as member:
                            npy.write_array(member, array, allow_pickle=False)
                handle.flush()
                os.fsync(handle.fileno())
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)
    except InputError:
        raise
    except (OSError, ValueError) as error:
        raise unreadable(path, "cannot be written", error) from error

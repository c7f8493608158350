"""Archives in packings that cannot be entered in the middle: unpacked once into a temporary file that nobody sees."""

import bz2
import importlib
import lzma
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from ovibjax.errors import InputError, refusal
from ovibjax.features.images.source import OnStep

MAX_RATIO, FREE_BYTES = 50, 64 * 2**20
"""Images hardly shrink; what unpacks to more than so many times its size, and so much, is no data set."""

_MAGICS = {b"\x1f\x8b": "gzip", b"BZh": "bzip2", b"\xfd7zXZ": "xz", b"\x28\xb5\x2f\xfd": "zstd", b"PK\x03\x04": "zip"}
_CHUNK_BYTES = 2**20
_XZ_MEMORY_BYTES = 2**30


def packing_of(head: bytes) -> str:
    """What a file is packed with, by its first bytes: gzip, bzip2, xz, zstd, zip, or "" for none of them."""
    magics = {
        b"\x1f\x8b": "gzip",
        b"BZh": "bzip2",
        b"\xfd7zXZ": "xz",
        b"\x28\xb5\x2f\xfd": "zstd",
        b"PK\x03\x04": "zip",
    }
    return next((packing for magic, packing in magics.items() if head.startswith(magic)), "")


def unpacked(path: Path, file: BinaryIO, packing: str, on_step: OnStep | None = None) -> BinaryIO:
    """The content of a packed file, in a temporary file that goes when it is closed, or when the process ends.

    Args:
        path: what to call the file.
        file: it, at its start.
        packing: bzip2, xz or zstd.
        on_step: progress, in bytes.

    Returns:
        The open temporary file.

    Raises:
        InputError: truncated or corrupt, unpacks to far more than images do, there is no room, or zstd is missing.
    """
    size = path.stat().st_size
    done = 0
    target = tempfile.TemporaryFile()  # noqa: SIM115 (handed on)
    try:
        for piece in _pieces(path, file, packing):
            done += len(piece)
            if done > MAX_RATIO * size + FREE_BYTES:
                raise refusal(path, f"unpacks to over {MAX_RATIO} times its size; these are no images")
            try:
                target.write(piece)
            except OSError as error:
                where = f"no room to unpack it in {tempfile.gettempdir()} ({error.strerror})"
                raise refusal(path, f"{where}; set TMPDIR to a larger disk, or give a .tar") from error
            if on_step is not None:
                on_step(f"unpacking {path.name}", file.tell(), size)
        target.flush()
    except BaseException:
        target.close()
        raise
    return target


def _pieces(path: Path, file: BinaryIO, packing: str) -> Iterator[bytes]:
    """The content bit by bit; one stream after another, as parallel packers write them."""
    state, begun = _decompressor(path, packing), False
    try:
        while chunk := file.read(_CHUNK_BYTES):
            while chunk:
                if state.eof:
                    chunk = chunk.lstrip(b"\0")  # padding between streams
                    if not chunk:
                        break
                    state = _decompressor(path, packing)
                begun = True
                yield state.decompress(chunk, _CHUNK_BYTES)
                while not state.eof and not state.needs_input:
                    yield state.decompress(b"", _CHUNK_BYTES)
                chunk = state.unused_data if state.eof else b""
    except InputError:
        raise
    except Exception as error:
        # Each packing has errors of its own; all mean the same.
        raise refusal(path, f"corrupt {packing} file ({' '.join(str(error).split())[:80]})") from error
    if not begun or not state.eof:
        raise refusal(path, f"truncated {packing} file: it ends in the middle; copy it again")


def _decompressor(path: Path, packing: str) -> Any:
    """A fresh decompressor; all three are used alike."""
    if packing == "bzip2":
        return bz2.BZ2Decompressor()
    if packing == "xz":
        return lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=_XZ_MEMORY_BYTES)
    for module in ("compression.zstd", "backports.zstd"):  # the first from Python 3.14 on
        try:
            return importlib.import_module(module).ZstdDecompressor()
        except ImportError:
            continue
    raise refusal(path, 'is packed with zstd, which needs the extra [zstd]: pip install "ovibjax[zstd]"')

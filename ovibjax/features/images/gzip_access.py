"""Random access to the bytes inside a gzip file: one pass sets marks, later reads begin at the nearest one."""

import os
import threading
import zlib
from collections import OrderedDict
from typing import Any, NamedTuple

from ovibjax.errors import StrPath, refusal
from ovibjax.features.images.unpacking import FREE_BYTES, MAX_RATIO

_CHUNK_BYTES = 256 * 2**10
_BLOCK_BYTES = 4 * 2**20
_MARKS = 1024  # each keeps a 32 KB window of the decompressor
_CACHED_BLOCKS = 12  # five views and the metadata are read side by side


class _Mark(NamedTuple):
    """Where a block begins: offset of the next compressed byte, and the decompressor as it was there."""

    at: int
    state: Any


class GzipReader:
    """The unpacked content of a gzip file, by offset; safe from several threads.

    Args:
        path: what to call the file in messages.
        descriptor: the open file.
        size: its length in bytes.
    """

    def __init__(self, path: StrPath, descriptor: int, size: int) -> None:
        self._path, self._descriptor, self._size = path, descriptor, size
        self._block_bytes = max(_BLOCK_BYTES, size // _MARKS)
        self._marks = [_Mark(0, zlib.decompressobj(31))]
        self._end: int | None = None  # blocks in all, once known
        self._cache: OrderedDict[int, bytes] = OrderedDict()
        self._lock = threading.Lock()

    def read(self, count: int, offset: int) -> bytes:
        """Up to `count` bytes from `offset`; fewer at the end.

        Raises:
            InputError: the file is truncated or corrupt, or unpacks to far more than images do.
        """
        parts = []
        with self._lock:
            while count > 0:
                block, start = divmod(offset, self._block_bytes)
                part = self._block(block)[start : start + count]
                if not part:
                    break
                parts.append(part)
                offset, count = offset + len(part), count - len(part)
        return b"".join(parts)

    def check_rest(self) -> None:
        """Unpack what nobody asked for yet, up to the end, where the checksum is."""
        with self._lock:
            while self._end is None:
                self._unpack(len(self._marks) - 1)

    def _block(self, index: int) -> bytes:
        if index in self._cache:
            self._cache.move_to_end(index)
            return self._cache[index]
        while len(self._marks) <= index and self._end is None:
            self._unpack(len(self._marks) - 1)
        if self._end is not None and index >= self._end:
            return b""
        return self._unpack(index)

    def _unpack(self, index: int) -> bytes:
        """One block from its mark; sets the mark of the next block, or the end."""
        if index * self._block_bytes > MAX_RATIO * self._size + FREE_BYTES:
            raise refusal(self._path, f"unpacks to over {MAX_RATIO} times its size; these are no images")
        if index in self._cache:
            return self._cache[index]
        at, state = self._marks[index].at, self._marks[index].state.copy()
        parts, missing, ended = [], self._block_bytes, False
        while missing > 0 and not ended:
            chunk = os.pread(self._descriptor, _CHUNK_BYTES, at)
            if state.eof:
                # Files may be concatenated, and padded with zeros.
                at += len(chunk) - len(chunk.lstrip(b"\0"))
                if chunk and not chunk.strip(b"\0"):
                    continue
                ended = not chunk
                state = zlib.decompressobj(31)
                continue
            try:
                part = state.decompress(chunk, missing)
            except zlib.error as error:
                raise refusal(self._path, f"corrupt gzip file ({error})") from error
            if not part and not chunk and not state.eof:
                raise refusal(self._path, "truncated gzip file: it ends in the middle; copy it again")
            # At the end of a stream both hold what follows it.
            at += len(chunk) - len(state.unused_data if state.eof else state.unconsumed_tail)
            parts.append(part)
            missing -= len(part)
        block = b"".join(parts)
        if index == len(self._marks) - 1:
            if ended:
                self._end = index + (len(block) > 0)
            else:
                self._marks.append(_Mark(at, state))
        self._cache[index] = block
        while len(self._cache) > _CACHED_BLOCKS:
            self._cache.popitem(last=False)
        return block

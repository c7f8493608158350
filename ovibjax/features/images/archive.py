"""Files inside a `.tar` archive: one pass finds them, and they are read in place, also from a `.tar.gz`.

Other packings, bzip2, xz and zstd, cannot be entered in the middle: they go to a temporary file first.
"""

import io
import os
import tarfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import BinaryIO

from ovibjax.errors import InputError, refusal
from ovibjax.features.images.gzip_access import GzipReader
from ovibjax.features.images.member_names import clean_name
from ovibjax.features.images.source import OnStep
from ovibjax.features.images.unpacking import packing_of, unpacked

_MAX_HEADER_BYTES = 2**20  # long names and extended headers; tarfile would take whatever a header claims
_STEP_MEMBERS = 1000
_BELOW = ("Front/0.png", "0.png", "0.json")  # in place of `rgb`, of a camera's folder, of `metadata`


class TarFiles:
    """Regular files of an archive.

    Args:
        path: the archive, plain or packed.
        wanted: which names to keep in mind; a released town has a million members.
        on_step: progress of the one pass over the archive, in bytes.

    Raises:
        InputError: not a tar archive, truncated, corrupt, or a member has an absolute path or leads out of the
            archive, or one that is wanted is a link or a device.
    """

    def __init__(self, path: Path, wanted: Callable[[str], bool], on_step: OnStep | None = None) -> None:
        self.path = path
        self.sizes_bytes: dict[str, int] = {}
        self._offsets: dict[str, int] = {}
        try:
            self._file: BinaryIO = path.open("rb")
        except OSError as error:
            raise refusal(path, f"cannot be read ({error.strerror or error})") from error
        try:
            packing = packing_of(self._file.read(8))
            if packing in ("bzip2", "xz", "zstd"):
                self._file.seek(0)
                with self._file as packed:
                    self._file = unpacked(path, packed, packing, on_step)
            self._size = os.fstat(self._file.fileno()).st_size
            self._gzip = GzipReader(path, self._file.fileno(), self._size) if packing == "gzip" else None
            self._index(wanted, on_step)
        except BaseException:
            self._file.close()
            raise

    def pread(self, count: int, offset: int) -> bytes:
        """Bytes of the archive, unpacked, by offset."""
        if self._gzip is not None:
            return self._gzip.read(count, offset)
        try:
            return os.pread(self._file.fileno(), count, offset)
        except OSError as error:
            raise refusal(self.path, f"cannot be read ({error.strerror or error})") from error

    def read(self, name: str) -> bytes:
        """The content of a member."""
        size = self.sizes_bytes[name]
        content = self.pread(size, self._offsets[name])
        if len(content) != size:
            raise refusal(self.path, f"truncated: member {name} has {len(content)} of {size} bytes; copy it again")
        return content

    def by_place(self, names: Iterable[str]) -> list[str]:
        """The names in the order of the archive."""
        return sorted(names, key=self._offsets.__getitem__)

    def close(self) -> None:
        """Close the archive."""
        self._file.close()

    def _index(self, wanted: Callable[[str], bool], on_step: OnStep | None) -> None:
        stream = _Stream(self)
        count = 0
        try:
            with tarfile.open(fileobj=stream, mode="r:", encoding="utf-8", errors="surrogateescape") as tar:
                while (member := tar.next()) is not None:
                    tar.members = []  # type: ignore[attr-defined]  # tarfile would remember every one
                    self._take(member, wanted)
                    count += 1
                    if on_step is not None and count % _STEP_MEMBERS == 0:
                        on_step(f"finding images in {self.path.name}", min(member.offset_data, self._size), self._size)
                end = tar.offset
        except InputError:
            raise
        except Exception as error:
            # Corrupt headers surface as several exception types of tarfile; all mean the same.
            text = " ".join(str(error).split())[:80]
            raise refusal(self.path, f"not a tar archive, truncated or corrupt ({text})") from error
        # tarfile takes a damaged header, or the end of the file, for the end of the archive.
        if self.pread(512, end) != bytes(512):
            raise refusal(self.path, f"truncated or corrupt after {count} members; copy it again")
        if self._gzip is not None:
            self._gzip.check_rest()

    def _take(self, member: tarfile.TarInfo, wanted: Callable[[str], bool]) -> None:
        name = clean_name(self.path, member.name)
        # A link may also stand for a folder that would hold something wanted.
        link = member.issym() or member.islnk()
        needed = wanted(name) or (link and any(wanted(f"{name}/{file}") for file in _BELOW))
        if member.isdir() or not needed:
            return
        if not member.isreg() or member.issparse():
            special = "sparse" if member.isreg() else "a device or another special file"
            kind = "a link" if link else special
            raise refusal(self.path, f"member {name} is {kind}; a data set holds plain files only")
        at, size = member.offset_data, member.size
        if size < 0 or (self._gzip is None and at + size > self._size):
            raise refusal(self.path, f"truncated or corrupt: member {name} claims {size} bytes, more than follow")
        if not wanted(name):
            return
        if not name.isprintable():
            raise refusal(self.path, f"member {name} has a name that is not printable text; rename it")
        if name in self.sizes_bytes:
            raise refusal(self.path, f"member {name} occurs twice; make the archive anew")
        self.sizes_bytes[name] = size
        self._offsets[name] = at


class _Stream(io.RawIOBase):
    """What tarfile reads from: never backwards, never more than a header can need."""

    def __init__(self, files: TarFiles) -> None:
        self._files, self._at = files, 0

    def tell(self) -> int:
        return self._at

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        # One byte back is how tarfile checks that what precedes a header is there.
        if whence != os.SEEK_SET or offset < self._at - 1:
            raise refusal(self._files.path, "corrupt: a member has a negative size")
        self._at = offset
        return offset

    def read(self, size: int = -1) -> bytes:
        if not 0 <= size <= _MAX_HEADER_BYTES:
            raise refusal(self._files.path, f"corrupt: a header claims {size} bytes")
        part = self._files.pread(size, self._at)
        self._at += len(part)
        return part

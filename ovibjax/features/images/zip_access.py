"""Files inside a `.zip` archive, read in place."""

import stat
import zipfile
from collections.abc import Callable, Iterable
from pathlib import Path

from ovibjax.errors import InputError, refusal
from ovibjax.features.images.member_names import clean_name
from ovibjax.features.images.unpacking import FREE_BYTES, MAX_RATIO

_ENCRYPTED = 1


class ZipFiles:
    """Regular files of a zip archive.

    Args:
        path: the archive.
        wanted: which names to keep in mind.

    Raises:
        InputError: not a zip archive, truncated, corrupt, a member's name leads out of it, or one that is wanted is a
            link, encrypted or packed in a way that is not read.
    """

    def __init__(self, path: Path, wanted: Callable[[str], bool]) -> None:
        self.path = path
        self.sizes_bytes: dict[str, int] = {}
        self._members: dict[str, zipfile.ZipInfo] = {}
        try:
            self._zip = zipfile.ZipFile(path)
        except (OSError, ValueError, zipfile.BadZipFile, NotImplementedError) as error:
            raise refusal(path, f"not a zip archive, truncated or corrupt ({error})") from error
        try:
            for info in self._zip.infolist():
                self._take(info, wanted)
        except BaseException:
            self._zip.close()
            raise

    def _take(self, info: zipfile.ZipInfo, wanted: Callable[[str], bool]) -> None:
        # Some programs for Windows write its own separator.
        name = clean_name(self.path, info.filename.replace("\\", "/"))
        if info.is_dir() or not wanted(name):
            return
        mode = info.external_attr >> 16
        if stat.S_IFMT(mode) not in (0, stat.S_IFREG):
            kind = "a link" if stat.S_ISLNK(mode) else "a device or another special file"
            raise refusal(self.path, f"member {name} is {kind}; a data set holds plain files only")
        if info.flag_bits & _ENCRYPTED:
            raise refusal(self.path, f"member {name} is encrypted; unpack the archive with its password")
        if info.file_size > MAX_RATIO * info.compress_size + FREE_BYTES:
            raise refusal(self.path, f"member {name} unpacks to over {MAX_RATIO} times its size; this is no image")
        if name in self._members:
            raise refusal(self.path, f"member {name} occurs twice; make the archive anew")
        self._members[name], self.sizes_bytes[name] = info, info.file_size

    def read(self, name: str) -> bytes:
        """The content of a member."""
        try:
            return self._zip.read(self._members[name])
        except InputError:
            raise
        except Exception as error:
            # Corrupt bytes surface as several exception types of zipfile and its packings; all mean the same.
            raise refusal(self.path, f"member {name} is corrupt or packed in an unknown way ({error})") from error

    def by_place(self, names: Iterable[str]) -> list[str]:
        """The names in the order of the archive."""
        return sorted(names, key=lambda name: self._members[name].header_offset)

    def close(self) -> None:
        """Close the archive."""
        self._zip.close()

"""Files of a folder, read by name: the plain way in which images lie on a disk."""

import os
from collections.abc import Iterable, Mapping
from pathlib import Path

from ovibjax.errors import refusal


class FolderFiles:
    """Files below a folder."""

    def __init__(self, path: Path, sizes_bytes: Mapping[str, int]) -> None:
        self.path = path
        self.sizes_bytes = sizes_bytes

    def read(self, name: str) -> bytes:
        """The content of a file."""
        try:
            return (self.path / name).read_bytes()
        except OSError as error:
            raise refusal(self.path / name, f"cannot be read ({error.strerror or error})") from error

    def by_place(self, names: Iterable[str]) -> list[str]:
        """The names as they come."""
        return list(names)

    def close(self) -> None:
        """Nothing to release."""


def list_folder(root: Path, folders: Iterable[str]) -> dict[str, int]:
    """Lengths of the regular files in some folders below a root, those of other kinds left out.

    Args:
        root: where names begin.
        folders: relative, with forward slashes; those that do not exist hold nothing.

    Returns:
        Length in bytes by relative name.

    Raises:
        InputError: a folder cannot be read.
    """
    sizes: dict[str, int] = {}
    for folder in folders:
        try:
            with os.scandir(root / folder) as entries:
                for entry in entries:
                    if entry.is_file() and not entry.name.startswith("."):
                        sizes[f"{folder}/{entry.name}"] = entry.stat().st_size
        except (FileNotFoundError, NotADirectoryError):
            continue
        except OSError as error:
            raise refusal(root / folder, f"unreadable folder ({error.strerror or error})") from error
    return sizes

"""Whether something could be written to a place, before the work whose results are to go there."""

import os
from pathlib import Path

from ovibjax.errors import InputError, StrPath


def require_place(path: StrPath, option: str = "--out") -> None:
    """Refuse a path that nothing can be written to; nothing is made.

    Args:
        path: a file or folder that may exist or not.
        option: what names it, for the message.

    Raises:
        InputError: it lies below a file, in a folder that cannot be written, or has a name that no file can have.
    """
    place = Path(path)
    if "\0" in str(place):
        raise InputError(f"{option} {str(path)!r}: no file can have such a name; choose another path")
    try:
        while not place.exists():
            place = place.absolute().parent
        is_folder = place.is_dir()
    except (OSError, ValueError) as error:  # too long, a NUL, a folder that cannot be entered
        raise InputError(f"{option} {path}: cannot write there ({error}); choose another path") from error
    if place != Path(path) and not is_folder:
        raise InputError(f"{option} {path}: cannot write there, as {place} is a file; choose another path")
    if not os.access(place, os.W_OK | (os.X_OK if is_folder else 0)):
        raise InputError(f"{option} {path}: cannot write there, as {place} cannot be written; choose another path")

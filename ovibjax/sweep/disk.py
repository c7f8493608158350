"""The disk under a store: whose files these are, one whole sweep at a time, and refusals that say what is safe."""

import errno
import os
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from ovibjax.errors import InputError, one_line
from ovibjax.runtime.locks import Held, take_lock

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def of_this_process() -> str:
    """End of a temporary name: no other process that shares the disk has it."""
    return f"{socket.gethostname()}-{os.getpid()}"


def is_abandoned(owner: str) -> bool:
    """Whether the end of a temporary name is that of a process of this machine that is no more; no clock is asked."""
    host, _, number = owner.rpartition("-")
    # On Windows signal 0 is Ctrl-C.
    if host != socket.gethostname() or not number.isdecimal() or os.name == "nt":
        return False
    try:
        os.kill(int(number), 0)
    except ProcessLookupError:
        return True
    except (OSError, OverflowError):
        return False
    return False


def lock_of(path: Path, file: Path) -> IO[str] | None:
    """Take the lock of a store, which ends with the process.

    Args:
        path: the store as it was named.
        file: the lock's file.

    Returns:
        The lock, given back when it is closed; None on a file system that knows no locks.

    Raises:
        InputError: another process has it.
    """
    try:
        return take_lock(file)
    except Held as error:
        raise InputError(
            f"{path}: {error.strerror} is already working on this sweep; wait for it, split the work (--shard), "
            "or choose another --out"
        ) from None


@contextmanager
def writing(path: Path, kept: Callable[[], int]) -> Iterator[None]:
    """Turn what the disk refuses into a message that says what is safe.

    Args:
        path: the store as it was named.
        kept: counts the members that are on the disk.
    """
    try:
        yield
    except OSError as error:
        reason = error.strerror or one_line(error)
        if error.errno in (errno.EEXIST, errno.ENOTDIR):
            reason = f"{error.filename} is no folder"
        raise InputError(
            f"{path}: cannot write ({reason}); {kept()} members are kept; "
            f"{'make room' if error.errno in _FULL else 'mend that'} and repeat the command"
        ) from error

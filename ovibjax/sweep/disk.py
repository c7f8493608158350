"""The disk under a store: whose files these are, one whole sweep at a time, and refusals that say what is safe."""

import errno
import fcntl
import os
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from ovibjax.errors import InputError, one_line

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL)


def of_this_process() -> str:
    """End of a temporary name: no other process that shares the disk has it."""
    return f"{socket.gethostname()}-{os.getpid()}"


def is_abandoned(owner: str) -> bool:
    """Whether the end of a temporary name is that of a process of this machine that is no more; no clock is asked."""
    host, _, number = owner.rpartition("-")
    if host != socket.gethostname() or not number.isdecimal():
        return False
    try:
        os.kill(int(number), 0)
    except ProcessLookupError:
        return True
    except (OSError, OverflowError):
        return False
    return False


def take_lock(path: Path, file: Path) -> IO[str] | None:
    """Take the lock of a store, which ends with the process.

    The file is never removed: another process may have opened it meanwhile and would lock a file that a third one no
    longer finds.

    Args:
        path: the store as it was named.
        file: the lock's file.

    Returns:
        The lock, given back when it is closed; None on a file system that knows no locks.

    Raises:
        InputError: another process has it.
    """
    handle = file.open("a+")
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        handle.truncate(0)
        handle.write(f"process {os.getpid()} on host {socket.gethostname()}")
        handle.flush()
    except BlockingIOError:
        handle.seek(0)
        holder = handle.read() or "another process"
        handle.close()
        raise InputError(
            f"{path}: {holder} is already working on this sweep; wait for it, split the work (--shard), "
            "or choose another --out"
        ) from None
    except OSError as error:
        handle.close()
        if error.errno in _NO_LOCKS:
            return None
        raise
    except BaseException:
        handle.close()
        raise
    return handle


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

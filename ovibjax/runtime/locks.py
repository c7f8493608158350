"""Locks that end with their process, on any system: one process at a time works in a folder."""

import errno
import os
import socket
from pathlib import Path
from typing import IO

WITHOUT_LOCKS = "its file system knows no locks; do not start the same command twice at a time"
"""What to say of a lock's file where `take_lock` gave none."""

_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP, errno.EINVAL)


class Held(OSError):
    """Another process has the lock; the message says which one, as far as it is known."""


def take_lock(file: Path) -> IO[str] | None:
    """Take a lock without waiting.

    The file is never removed: another process may have opened it meanwhile and would lock a file that a third one no
    longer finds.

    Args:
        file: the lock's file, made if missing.

    Returns:
        The lock, given back when it is closed; None on a system or file system that knows no locks.

    Raises:
        Held: another process has it.
        OSError: the file cannot be made or written.
    """
    try:
        import portalocker
    except ImportError:  # a system without any of the ways it knows
        return None
    handle = file.open("a+")
    try:
        portalocker.lock(handle, portalocker.LOCK_EX | portalocker.LOCK_NB)
        handle.truncate(0)
        handle.write(f"process {os.getpid()} on host {socket.gethostname()}")
        handle.flush()
    except portalocker.AlreadyLocked:
        holder = _holder(handle)
        handle.close()
        raise Held(errno.EAGAIN, holder) from None
    except portalocker.LockException as error:
        handle.close()
        if _number(error) in _NO_LOCKS:
            return None
        raise OSError(_number(error) or errno.EIO, f"{file.name} cannot be locked") from error
    except BaseException:
        handle.close()
        raise
    return handle


def _holder(handle: IO[str]) -> str:
    """Who has the lock, as it wrote; a system may keep others from reading that."""
    try:
        handle.seek(0)
        return handle.read() or "another process"
    except OSError:
        return "another process"


def _number(error: BaseException) -> int | None:
    """The system's number of what lies under a library's error."""
    under: object = error
    for _ in range(4):
        if isinstance(under, OSError) and under.errno is not None:
            return under.errno
        if not isinstance(under, BaseException):
            return None
        under = under.__cause__ or under.__context__ or next(iter(under.args), None)
    return None

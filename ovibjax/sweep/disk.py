"""The disk under a store: one writer at a time, and refusals that say what is safe and what to do."""

import errno
import fcntl
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from ovibjax.errors import InputError, one_line


def take_lock(path: Path, real: Path) -> IO[str]:
    """Take the lock of a store, which ends with the process.

    The file lies beside the store, as it guards its creation too. It is never removed: another process may have
    opened it meanwhile and would lock a file that a third one no longer finds.
    """
    handle = real.with_name(f".{real.name}.lock").open("a+")
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
            f"{path}: {holder} is already working on this sweep; wait for it, or choose another --out"
        ) from None
    except BaseException:
        handle.close()
        raise
    return handle


@contextmanager
def writing(path: Path, count: int) -> Iterator[None]:
    """Turn what the disk refuses into a message that says what is safe."""
    try:
        yield
    except OSError as error:
        kept = len(list((path / "finished").glob("c.*[0-9]")))
        full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        reason = error.strerror or one_line(error)
        if error.errno in (errno.EEXIST, errno.ENOTDIR):
            reason = f"{error.filename} is no folder"
        raise InputError(
            f"{path}: cannot write ({reason}); {kept} of {count} chunks are kept; "
            f"{'make room' if full else 'mend that'} and repeat the command"
        ) from error

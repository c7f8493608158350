"""What edge and robots write down: JSON, one object a line, whole lines only, whatever ends the process.

Each line is one write to a file opened for appending, so that what was written stays after SIGKILL, and an edge that is
started again goes on in the same file. Every line has `event`, the first of a run is `start`, the last `summary`.
"""

import json
import math
import os
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

from ovibjax.errors import InputError, refusal, unreadable

REFUSALS_PER_S = 50
"""Refused connections that are written down in a second; the others are counted."""

LINE_LIMIT_BYTES = 1 << 16


class RequestLog:
    """A file of events; without a path nothing is written.

    Args:
        path: the file, which is created or continued.

    Raises:
        InputError: it cannot be opened.
    """

    def __init__(self, path: Path | None) -> None:
        self._file: int | None = None
        self._second, self._told, self._untold = 0, 0, 0
        if path is not None:
            try:
                self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
                _begin(path, self._file)
            except OSError as error:
                raise refusal(path, f"the log cannot be written ({error.strerror}); choose another --log") from error

    def __enter__(self) -> "RequestLog":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def write(self, event: str, **fields: Any) -> None:
        """Write one line."""
        if self._file is not None:
            told = {name: _plain(value) for name, value in fields.items() if value is not None}
            os.write(self._file, (json.dumps({"event": event, **told}) + "\n").encode())

    def refused(self, why: str, **fields: Any) -> None:
        """Write down a connection that was refused or dropped, unless there are too many of them in this second."""
        second = int(time.monotonic())
        if second != self._second:
            self._second, self._told = second, 0
        if self._told >= REFUSALS_PER_S:
            self._untold += 1
            return
        untold, self._untold = self._untold, 0
        self._told += 1
        self.write("refused", why=why, untold=untold or None, **fields)

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            os.close(self._file)
            self._file = None


def read_log(path: Path) -> Iterator[dict[str, Any]]:
    """Events of a file; a line that was cut off by the end of the machine is left out.

    Args:
        path: the file.

    Yields:
        One dictionary per line, with `event` among its names.

    Raises:
        InputError: the file cannot be read, or a line is no event.
    """
    damaged: InputError | None = None
    try:
        with path.open("rb") as file:
            for number, line in enumerate(iter(lambda: file.readline(LINE_LIMIT_BYTES), b""), start=1):
                found = _event(line)
                # Where a run died within a line, the next one begins.
                if damaged is not None and (found is None or found["event"] != "start"):
                    raise damaged
                damaged = None if found else refusal(path, "no event; it is no log of ovibjax edge, or damaged", number)
                if found is not None:
                    yield found
                elif number == 1:
                    raise damaged or AssertionError
        if damaged is not None and _ends_a_line(path):
            raise damaged
    except OSError as error:
        raise unreadable(path, "the log cannot be read", error) from error


def _event(line: bytes) -> dict[str, Any] | None:
    """The event on a line, if it is one."""
    try:
        found = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) and isinstance(found.get("event"), str) else None


def _ends_a_line(path: Path) -> bool:
    """Whether a file ends where a line does."""
    with path.open("rb") as file:
        if not file.seek(0, os.SEEK_END):
            return True
        file.seek(-1, os.SEEK_END)
        return file.read(1) == b"\n"


def _begin(path: Path, file: int) -> None:
    """Refuse a file of something else; where a run died within a line, begin a new one."""
    with path.open("rb") as reader:
        first = reader.readline(LINE_LIMIT_BYTES)
    if first and _event(first) is None:
        raise refusal(path, "not a log of ovibjax edge, and nothing is written into it; choose another --log")
    if not _ends_a_line(path):
        os.write(file, b"\n")


def _plain(value: Any) -> Any:
    """Numbers with as many digits as they deserve: microseconds, micrometres; none for what is no number."""
    if isinstance(value, float):
        return round(value, 6) if math.isfinite(value) else None
    return value

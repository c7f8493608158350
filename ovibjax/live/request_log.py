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

from ovibjax.errors import refusal, unreadable

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
                _end_last_line(path, self._file)
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
    try:
        with path.open("rb") as file:
            for number, line in enumerate(iter(lambda: file.readline(LINE_LIMIT_BYTES), b""), start=1):
                if not line.endswith(b"\n"):
                    if len(line) < LINE_LIMIT_BYTES:
                        return
                    raise refusal(path, "too long for an event; it is no log of ovibjax edge", number)
                try:
                    found = json.loads(line)
                except (ValueError, RecursionError) as error:
                    raise refusal(path, "no JSON; it is no log of ovibjax edge, or damaged", number) from error
                if not isinstance(found, dict) or not isinstance(found.get("event"), str):
                    raise refusal(path, "no event; it is no log of ovibjax edge", number)
                yield found
    except OSError as error:
        raise unreadable(path, "the log cannot be read", error) from error


def _end_last_line(path: Path, file: int) -> None:
    """Where the machine died within a line, begin a new one."""
    with path.open("rb") as reader:
        if reader.seek(0, os.SEEK_END) and reader.seek(-1, os.SEEK_END) >= 0 and reader.read(1) != b"\n":
            os.write(file, b"\n")


def _plain(value: Any) -> Any:
    """Numbers with as many digits as they deserve: microseconds, tenths of a millimetre; none for what is no number."""
    if isinstance(value, float):
        return round(value, 4) if math.isfinite(value) else None
    return value

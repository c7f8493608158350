"""Reading measured throughput traces from files that nobody vouches for.

Two formats, told apart by the first line that is neither blank nor a comment (`#` to the end of the line):

- no comma in it: two columns between white space, time in seconds and rate in Mbit/s, as in the Pensieve traces;
- a comma in it: CSV, and that line names two columns, a time and a rate. Names are case-sensitive, because MBps is
  not Mbps:

| column        | unit                                       |
|---------------|--------------------------------------------|
| `time_s`      | seconds from any origin                    |
| `timestamp`   | the same; Unix time in seconds             |
| `time_ms`     | milliseconds from any origin               |
| `mbit_s`      | 1,000,000 bit/s                            |
| `mbps`        | the same                                   |
| `kbps`        | 1,000 bit/s                                |
| `bps`         | bit/s                                      |
| `kb_per_s`    | KB/s, a KB of 1,024 bytes, as in the paper |
| `bytes_per_s` | byte/s                                     |
"""

import array
import codecs
import io
import itertools
import math
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ovibjax.errors import InputError
from ovibjax.link.traces import RATE_LIMIT_BPS, TIME_LIMIT_S, Trace, refusal

MAX_TRACE_BYTES = 50 * 2**20
"""Largest trace file accepted."""
MAX_GAP_S = 10.0
"""Longest interval between samples that is never a gap."""
MAX_GAP_INTERVALS = 5.0
"""Longest interval between samples that is not a gap, in median intervals of the trace."""

# A divisor, because 1,000 is exact in binary and 0.001 is not.
_UNITS_PER_SECOND = {"time_s": 1.0, "timestamp": 1.0, "time_ms": 1e3}
_BPS_PER_UNIT = {"mbit_s": 1e6, "mbps": 1e6, "kbps": 1e3, "bps": 1.0, "kb_per_s": 8192.0, "bytes_per_s": 8.0}
_TEXT_COLUMNS = ("time_s", "mbit_s")

_MAX_LINE = 1000


def _quoted(cell: str) -> str:
    """A cell as it may stand in a message."""
    return repr(cell if len(cell) <= 40 else cell[:37] + "...")


def _line_of(data: bytes, offset: int) -> int:
    """Number of the line that holds a byte."""
    before = data[:offset]
    return 1 + before.count(b"\n") + before.count(b"\r") - before.count(b"\r\n")


def _read_text(path: Path) -> bytes:
    """The bytes of a text file: UTF-8 without byte-order mark, no NUL, of bounded size."""
    try:
        if not path.exists():
            raise refusal(path, "no such file")
        if not path.is_file():
            raise refusal(path, "not a regular file; name one trace")
        if (size := path.stat().st_size) > MAX_TRACE_BYTES:
            raise refusal(path, f"too large: {size} bytes, over {MAX_TRACE_BYTES}; split it")
        with path.open("rb") as file:
            data = file.read(MAX_TRACE_BYTES).removeprefix(codecs.BOM_UTF8)
    except OSError as error:
        raise refusal(path, f"cannot be read ({error.strerror or type(error).__name__})") from error
    if (nul := data.find(b"\0")) >= 0:
        raise refusal(path, "a binary file or UTF-16 text; save it as UTF-8 text", _line_of(data, nul))
    try:
        data.decode()
    except UnicodeDecodeError as error:
        raise refusal(path, "not UTF-8 text; save it as UTF-8", _line_of(data, error.start)) from error
    return data


def _content(path: Path, data: bytes) -> Iterator[tuple[int, str]]:
    """Numbered lines with comments and surrounding space removed, blank ones left out."""
    for number, line in enumerate(io.TextIOWrapper(io.BytesIO(data), encoding="utf-8"), start=1):
        if content := line.partition("#")[0].strip():
            if len(content) > _MAX_LINE:
                raise refusal(path, f"{len(content)} characters, over {_MAX_LINE}; not a trace", number)
            yield number, content


def _cells(line: str) -> list[str]:
    """Cells of one CSV line; quotes around a cell are dropped."""
    return [cell.strip().strip('"') for cell in line.split(",")]


def _number(path: Path, line: int, column: str, cell: str) -> float:
    """A cell as a finite number in plain notation."""
    try:
        # Python would read 1_000 and digits of other scripts, which no measuring tool writes.
        value = float(cell) if cell.isascii() and "_" not in cell else None
    except ValueError:
        value = None
    if value is None:
        raise refusal(path, f"{column} {_quoted(cell)} is not a number; comment out text with #", line)
    if not math.isfinite(value):
        raise refusal(path, f"{column} {_quoted(cell)} is not finite", line)
    return value


def _csv_columns(path: Path, line: int, header: str) -> tuple[str, ...]:
    """Names of the two columns in a CSV header."""
    names = tuple(_cells(header))
    times, rates = ", ".join(_UNITS_PER_SECOND), ", ".join(_BPS_PER_UNIT)
    for name in names:
        if name not in _UNITS_PER_SECOND and name not in _BPS_PER_UNIT:
            known = f"the first line names a time ({times}) and a rate ({rates})"
            raise refusal(path, f"unknown column {_quoted(name)}; {known}", line)
    if len(names) != 2 or sum(name in _UNITS_PER_SECOND for name in names) != 1:
        needed = f"one time ({times}) and one rate ({rates})"
        raise refusal(path, f"columns {_quoted(', '.join(names))}; a trace has two, {needed}", line)
    return names


def _sample(path: Path, line: int, columns: tuple[str, ...], cells: list[str]) -> tuple[float, float]:
    """Time in seconds and rate in bit/s of one row, each within sane bounds."""
    if len(cells) != len(columns):
        expected = f"expected {len(columns)} ({', '.join(columns)})"
        raise refusal(path, f"{len(cells)} column{'s'[: len(cells) != 1]}, {expected}", line)
    time_s = rate_bps = 0.0
    for column, cell in zip(columns, cells, strict=True):
        value = _number(path, line, column, cell)
        if column in _UNITS_PER_SECOND:
            time_s = value / _UNITS_PER_SECOND[column]
            if abs(time_s) > TIME_LIMIT_S:
                raise refusal(
                    path, f"{column} {_quoted(cell)} is no time in its unit; milliseconds go in time_ms", line
                )
            continue
        rate_bps = value * _BPS_PER_UNIT[column]
        if rate_bps < 0:
            raise refusal(path, f"{column} {_quoted(cell)} is negative; a dead link has rate 0", line)
        if rate_bps > RATE_LIMIT_BPS:
            raise refusal(path, f"{column} {_quoted(cell)} is over {RATE_LIMIT_BPS:g} bit/s; check the unit", line)
    return time_s, rate_bps


def read_trace(path: str | os.PathLike[str], max_gap_s: float | None = None) -> Trace:
    """Read one trace, text or CSV (see the module's table); nothing in the file is ever executed.

    Args:
        path: the file, UTF-8.
        max_gap_s: longest interval allowed between consecutive samples; by default 10 s or 5 times the trace's
            median interval, whichever is larger. Infinity allows any.

    Returns:
        The trace in bits per second; times keep the file's origin.

    Raises:
        InputError: naming file and line: a column is unknown, missing or too many; a value is not a finite number;
            a time repeats or goes back; a rate is negative; there is a gap; the file is missing, empty, binary, not
            UTF-8 or over 50 MiB.
    """
    path = Path(path)
    if max_gap_s is not None and not max_gap_s > 0:
        raise InputError(f"max_gap_s must be positive seconds, not {max_gap_s}")
    rows = _content(path, _read_text(path))
    first = next(rows, None)
    if first is None:
        raise refusal(path, "no samples; the file is empty or holds only comments")
    is_csv = "," in first[1]
    columns = _csv_columns(path, *first) if is_csv else _TEXT_COLUMNS
    lines, times_s, rates_bps = array.array("q"), array.array("d"), array.array("d")
    for line, content in rows if is_csv else itertools.chain([first], rows):
        time_s, rate_bps = _sample(path, line, columns, _cells(content) if is_csv else content.split())
        if times_s and time_s <= times_s[-1]:
            how = "repeats" if time_s == times_s[-1] else "goes back from"
            reason = f"time {time_s!r} s {how} {times_s[-1]!r} s of line {lines[-1]}; sort the samples, one per time"
            raise refusal(path, reason, line)
        lines.append(line)
        times_s.append(time_s)
        rates_bps.append(rate_bps)
    if len(lines) < 2:
        found = "one sample has no duration" if lines else "no sample follows the header"
        raise refusal(path, f"{found}; a trace needs two or more", lines[0] if lines else first[0])
    intervals_s = np.diff(times_s)
    limit_s = max(MAX_GAP_S, MAX_GAP_INTERVALS * float(np.median(intervals_s))) if max_gap_s is None else max_gap_s
    if (late := intervals_s > limit_s).any():
        at = int(late.argmax())
        reason = f"gap of {intervals_s[at]:g} s after line {lines[at]}, over {limit_s:g} s"
        raise refusal(path, f"{reason}; cut the trace there or raise max_gap_s", lines[at + 1])
    return Trace(np.array(times_s), np.array(rates_bps), str(path))

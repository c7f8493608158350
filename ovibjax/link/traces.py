"""Measured throughput traces: reading files that nobody vouches for, and averaging them over slots.

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
import operator
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ovibjax.errors import InputError

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

_TIME_LIMIT_S = 1e11  # beyond the year 5000, but early in 1973 for a Unix time in milliseconds
_RATE_LIMIT_BPS = 1e15
_MAX_LINE = 1000
_MAX_REPEATS = 1e9
_SNAP = 1e-6  # of a slot


def _refusal(path: str | Path, reason: str, line: int | None = None) -> InputError:
    """The error for one bad file: `path: line 3: reason`, on one line whatever the file is called or holds."""
    place = f"{path}: " if line is None else f"{path}: line {line}: "
    return InputError("".join(c if c.isprintable() else ascii(c)[1:-1] for c in place + reason))


def _quoted(cell: str) -> str:
    """A cell as it may stand in a message."""
    return repr(cell if len(cell) <= 40 else cell[:37] + "...")


@dataclass(frozen=True, eq=False)
class Trace:
    """A measured throughput trace: piecewise constant, each sample the mean rate over the interval that it ends.

    So Pensieve's simulator reads its traces: `rate_bps[i]` holds from `time_s[i - 1]` to `time_s[i]`, the first rate
    closes no interval, and the trace lasts from the first time to the last.

    Attributes:
        time_s: [n] float64 seconds, increasing, from any origin; a read-only copy, as is the next.
        rate_bps: [n] float64 bits per second, zero or more.
        source: what messages call the trace; the file it was read from.

    Raises:
        InputError: fewer than two samples, differing lengths, a time that does not increase, or a rate that is
            negative or not finite.
    """

    time_s: NDArray[np.float64]
    rate_bps: NDArray[np.float64]
    source: str = "trace"

    def __post_init__(self) -> None:
        for name in ("time_s", "rate_bps"):
            column = np.array(getattr(self, name), np.float64)
            column.setflags(write=False)
            object.__setattr__(self, name, column)
        if self.time_s.shape != self.rate_bps.shape or self.time_s.ndim != 1 or self.time_s.size < 2:
            shapes = f"times of shape {self.time_s.shape} and rates of shape {self.rate_bps.shape}"
            raise _refusal(self.source, f"{shapes}; a trace needs two or more samples, one rate per time")
        if not np.all(np.abs(self.time_s) <= _TIME_LIMIT_S) or not np.all(np.diff(self.time_s) > 0):
            raise _refusal(self.source, "times must be finite seconds and increase")
        if not np.all((self.rate_bps >= 0) & (self.rate_bps <= _RATE_LIMIT_BPS)):
            raise _refusal(self.source, f"rates must be 0 to {_RATE_LIMIT_BPS:g} bit/s")

    @property
    def duration_s(self) -> float:
        """Seconds from the first sample to the last."""
        return float(self.time_s[-1] - self.time_s[0])


def _line_of(data: bytes, offset: int) -> int:
    """Number of the line that holds a byte."""
    before = data[:offset]
    return 1 + before.count(b"\n") + before.count(b"\r") - before.count(b"\r\n")


def _read_text(path: Path) -> bytes:
    """The bytes of a text file: UTF-8 without byte-order mark, no NUL, of bounded size."""
    try:
        if not path.exists():
            raise _refusal(path, "no such file")
        if not path.is_file():
            raise _refusal(path, "not a regular file; name one trace")
        if (size := path.stat().st_size) > MAX_TRACE_BYTES:
            raise _refusal(path, f"too large: {size} bytes, over {MAX_TRACE_BYTES}; split it")
        with path.open("rb") as file:
            data = file.read(MAX_TRACE_BYTES).removeprefix(codecs.BOM_UTF8)
    except OSError as error:
        raise _refusal(path, f"cannot be read ({error.strerror or type(error).__name__})") from error
    if (nul := data.find(b"\0")) >= 0:
        raise _refusal(path, "a binary file or UTF-16 text; save it as UTF-8 text", _line_of(data, nul))
    try:
        data.decode()
    except UnicodeDecodeError as error:
        raise _refusal(path, "not UTF-8 text; save it as UTF-8", _line_of(data, error.start)) from error
    return data


def _content(path: Path, data: bytes) -> Iterator[tuple[int, str]]:
    """Numbered lines with comments and surrounding space removed, blank ones left out."""
    for number, line in enumerate(io.TextIOWrapper(io.BytesIO(data), encoding="utf-8"), start=1):
        if content := line.partition("#")[0].strip():
            if len(content) > _MAX_LINE:
                raise _refusal(path, f"{len(content)} characters, over {_MAX_LINE}; not a trace", number)
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
        raise _refusal(path, f"{column} {_quoted(cell)} is not a number; comment out text with #", line)
    if not math.isfinite(value):
        raise _refusal(path, f"{column} {_quoted(cell)} is not finite", line)
    return value


def _csv_columns(path: Path, line: int, header: str) -> tuple[str, ...]:
    """Names of the two columns in a CSV header."""
    names = tuple(_cells(header))
    times, rates = ", ".join(_UNITS_PER_SECOND), ", ".join(_BPS_PER_UNIT)
    for name in names:
        if name not in _UNITS_PER_SECOND and name not in _BPS_PER_UNIT:
            known = f"the first line names a time ({times}) and a rate ({rates})"
            raise _refusal(path, f"unknown column {_quoted(name)}; {known}", line)
    if len(names) != 2 or sum(name in _UNITS_PER_SECOND for name in names) != 1:
        needed = f"one time ({times}) and one rate ({rates})"
        raise _refusal(path, f"columns {_quoted(', '.join(names))}; a trace has two, {needed}", line)
    return names


def _sample(path: Path, line: int, columns: tuple[str, ...], cells: list[str]) -> tuple[float, float]:
    """Time in seconds and rate in bit/s of one row, each within sane bounds."""
    if len(cells) != len(columns):
        expected = f"expected {len(columns)} ({', '.join(columns)})"
        raise _refusal(path, f"{len(cells)} column{'s'[: len(cells) != 1]}, {expected}", line)
    time_s = rate_bps = 0.0
    for column, cell in zip(columns, cells, strict=True):
        value = _number(path, line, column, cell)
        if column in _UNITS_PER_SECOND:
            time_s = value / _UNITS_PER_SECOND[column]
            if abs(time_s) > _TIME_LIMIT_S:
                raise _refusal(
                    path, f"{column} {_quoted(cell)} is no time in its unit; milliseconds go in time_ms", line
                )
            continue
        rate_bps = value * _BPS_PER_UNIT[column]
        if rate_bps < 0:
            raise _refusal(path, f"{column} {_quoted(cell)} is negative; a dead link has rate 0", line)
        if rate_bps > _RATE_LIMIT_BPS:
            raise _refusal(path, f"{column} {_quoted(cell)} is over {_RATE_LIMIT_BPS:g} bit/s; check the unit", line)
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
        raise _refusal(path, "no samples; the file is empty or holds only comments")
    is_csv = "," in first[1]
    columns = _csv_columns(path, *first) if is_csv else _TEXT_COLUMNS
    lines, times_s, rates_bps = array.array("q"), array.array("d"), array.array("d")
    for line, content in rows if is_csv else itertools.chain([first], rows):
        time_s, rate_bps = _sample(path, line, columns, _cells(content) if is_csv else content.split())
        if times_s and time_s <= times_s[-1]:
            how = "repeats" if time_s == times_s[-1] else "goes back from"
            reason = f"time {time_s!r} s {how} {times_s[-1]!r} s of line {lines[-1]}; sort the samples, one per time"
            raise _refusal(path, reason, line)
        lines.append(line)
        times_s.append(time_s)
        rates_bps.append(rate_bps)
    if len(lines) < 2:
        found = "one sample has no duration" if lines else "no sample follows the header"
        raise _refusal(path, f"{found}; a trace needs two or more", lines[0] if lines else first[0])
    intervals_s = np.diff(times_s)
    limit_s = max(MAX_GAP_S, MAX_GAP_INTERVALS * float(np.median(intervals_s))) if max_gap_s is None else max_gap_s
    if (late := intervals_s > limit_s).any():
        at = int(late.argmax())
        reason = f"gap of {intervals_s[at]:g} s after line {lines[at]}, over {limit_s:g} s"
        raise _refusal(path, f"{reason}; cut the trace there or raise max_gap_s", lines[at + 1])
    return Trace(np.array(times_s), np.array(rates_bps), str(path))


def _received_bits(trace: Trace, edges_s: NDArray[np.float64], snap_s: float) -> tuple[NDArray[np.float64], ...]:
    """Bits received and time passed between consecutive edges on the trace repeated end to end."""
    time_s = trace.time_s - trace.time_s[0]
    repeats, phase_s = np.divmod(edges_s, time_s[-1])
    # Edges that miss a sample by rounding would carry a trace of the neighbouring rate into a dead slot.
    after = np.searchsorted(time_s, phase_s).clip(1, time_s.size - 1)
    for sample_s in (time_s[after - 1], time_s[after]):
        phase_s = np.where(np.abs(phase_s - sample_s) <= snap_s, sample_s, phase_s)
    total_bits = np.concatenate([[0.0], np.cumsum(trace.rate_bps[1:] * np.diff(time_s))])
    bits = total_bits[after - 1] + trace.rate_bps[after] * (phase_s - time_s[after - 1])
    whole = np.diff(repeats)
    return whole * total_bits[-1] + np.diff(bits), whole * time_s[-1] + np.diff(phase_s)


def resample(trace: Trace, slot_s: float, n_slots: int, start_s: float = 0.0, loop: bool = True) -> NDArray[np.float32]:
    """Mean rate of a trace in each of a run of slots, weighted by time.

    Args:
        trace: the trace.
        slot_s: length of a slot in seconds.
        n_slots: number of slots.
        start_s: start of the first slot, in seconds after the trace's first sample.
        loop: whether a trace that is too short is repeated end to end, as Pensieve does, instead of refused.

    Returns:
        [n_slots] float32 bits per second; exactly 0 where the trace is 0 for a whole slot.

    Raises:
        InputError: the trace is too short and `loop` is off, it would repeat more than 1e9 times, or an argument is
            out of range.
    """
    n_slots = operator.index(n_slots)
    given = f"slot_s {slot_s}, n_slots {n_slots}, start_s {start_s}"
    if not (slot_s > 0 and n_slots >= 1 and start_s >= 0 and start_s + n_slots * slot_s <= _TIME_LIMIT_S):
        raise InputError(f"{given}: give one or more slots of positive finite length, from a start of 0 or later")
    edges_s: NDArray[np.float64] = start_s + slot_s * np.arange(n_slots + 1, dtype=np.float64)
    if not np.all(np.diff(edges_s) > 0.5 * slot_s):
        raise InputError(f"{given}: too short to tell slots apart at {edges_s[-1]:g} s; use longer slots")
    snap_s = _SNAP * slot_s
    if edges_s[-1] > trace.duration_s * (_MAX_REPEATS if loop else 1.0) + snap_s:
        asked = f"{n_slots} slots of {slot_s:g} s from {start_s:g} s end at {edges_s[-1]:g} s"
        remedy = "ask for fewer slots" + ("" if loop else " or let it loop")
        reason = f"too short: it lasts {trace.duration_s:g} s, but {asked}; {remedy}"
        raise _refusal(trace.source, reason)
    bits, elapsed_s = _received_bits(trace, edges_s, snap_s)
    return (bits / elapsed_s).astype(np.float32)

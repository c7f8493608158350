"""The forms in which throughput traces are kept, each read into samples: rates, and when each interval ended.

| form                   | a line                                    | rate of a sample                               |
|------------------------|-------------------------------------------|------------------------------------------------|
| two columns (Pensieve) | `0.51 4.97`: seconds, Mbit/s              | since the line before                          |
| named columns          | CSV, tabs or semicolons, a line of names  | since the line before                          |
| bare rates             | `0.27,Mbits/sec`, one a second            | over the second                                |
| Mahimahi               | `31`: millisecond of a 1,500-byte packet  | of the packets of a millisecond                |
| logs of bytes          | `unix ms latitude longitude bytes ms`     | bytes over the milliseconds in the last column |
| iperf3                 | JSON of `iperf3 --json`                   | `bits_per_second` of an interval               |
"""

import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ovibjax.errors import refusal
from ovibjax.link.trace_columns import UNITS_SHOWN, Columns, bps_per_unit, choose_columns, seconds_of
from ovibjax.link.traces import RATE_LIMIT_BPS, TIME_LIMIT_S
from ovibjax.runtime.text_tables import Rows, is_missing, number_of, quoted

_PACKET_BITS = 1500 * 8
_LOG_COLUMNS = 6


@dataclass
class Samples:
    """What a file holds, in its order.

    Attributes:
        form: what the file was taken for.
        line: where each sample stands; number of the interval in JSON.
        end_s: when its interval ended.
        rate_bps: its mean rate.
        covered_s: length of its interval; NaN where it began at the sample before.
        left_out: lines without a value.
        notes: what else to tell.
        whole: every moment is accounted for, so that there are no gaps.
    """

    form: str
    line: array.array = field(default_factory=lambda: array.array("q"))
    end_s: array.array = field(default_factory=lambda: array.array("d"))
    rate_bps: array.array = field(default_factory=lambda: array.array("d"))
    covered_s: array.array = field(default_factory=lambda: array.array("d"))
    left_out: int = 0
    notes: list[str] = field(default_factory=list)
    whole: bool = False

    def add(self, line: int, end_s: float, rate_bps: float, covered_s: float = float("nan")) -> None:
        """Append a sample."""
        self.line.append(line)
        self.end_s.append(end_s)
        self.rate_bps.append(rate_bps)
        self.covered_s.append(covered_s)


def table(path: Path, rows: Rows, names: Sequence[str], columns: Columns, form: str) -> Samples:
    """Samples of two columns of a table.

    Args:
        path: the file, for messages.
        rows: lines below the header.
        names: the columns.
        columns: which of them are meant.
        form: what to call the table.

    Returns:
        The samples; a line without a time or a rate (`-`, `NA`, empty) is left out and counted.

    Raises:
        InputError: a line has too few or too many cells, or a cell is no number of its kind.
    """
    found = Samples(form)
    time_name, rate_name = names[columns.time], names[columns.rate]
    for line, cells in rows:
        if len(cells) != len(names):
            known = ", ".join(names) if len(names) < 9 else f"{names[0]} to {names[-1]}"
            reason = f"{len(cells)} column{'s'[: len(cells) != 1]}, expected {len(names)} ({known})"
            raise refusal(path, reason, line)
        time, rate = cells[columns.time], cells[columns.rate]
        if is_missing(time) or is_missing(rate):
            found.left_out += 1
            continue
        found.add(line, _seconds(path, line, time_name, time, columns.per_second), 0.0)
        found.rate_bps[-1] = rate_of(path, line, rate_name, rate, columns.bps)
    ignored = [name for at, name in enumerate(names) if at not in (columns.time, columns.rate)]
    if ignored:
        more = f" and {len(ignored) - 4} more" if len(ignored) > 5 else ""
        shown = ignored[: 4 if more else 5]
        found.notes.append(f"column{'s'[: len(ignored) != 1]} {', '.join(shown)}{more} not read")
    return found


def bare_rates(path: Path, rows: Rows, bps: float | None) -> Samples:
    """One rate a second, each line a number with its unit or, where `bps` gives one, without."""
    found = Samples("bare rates, one a second", whole=True)
    for second, (line, cells) in enumerate(rows, start=1):
        unit = bps if len(cells) == 1 else bps_per_unit(cells[1]) if len(cells) == 2 else None
        if unit is None:
            reason = f"{quoted(' '.join(cells))} is no rate with its unit, as in '0.27 Mbits/sec'"
            raise refusal(path, f"{reason}; a file of rates without one needs --trace-unit, {UNITS_SHOWN}", line)
        found.add(line, float(second), rate_of(path, line, "rate", cells[0], unit), 1.0)
    return found


def mahimahi(path: Path, rows: Rows) -> Samples:
    """Milliseconds at which a packet of 1,500 bytes may leave, as Mahimahi has them; the file repeats at its end."""
    lines, stamps = array.array("q"), array.array("q")
    for line, cells in rows:
        if len(cells) != 1 or not (cells[0].isascii() and cells[0].isdigit()) or len(cells[0]) > 12:
            raise refusal(path, f"{quoted(' '.join(cells))} is no whole millisecond, as a packet trace has", line)
        stamp = int(cells[0])
        if stamps and stamp < stamps[-1]:
            reason = f"{stamp} goes back from {stamps[-1]} of line {lines[-1]}, so this is no packet trace"
            raise refusal(path, f"{reason}; one rate a second is read with --trace-unit, {UNITS_SHOWN}", line)
        lines.append(line)
        stamps.append(stamp)
    if not stamps or not stamps[-1]:
        raise refusal(path, "no packet after millisecond 0; a packet trace needs one to have a length")
    packets = np.bincount(np.maximum(stamps, 1)) if stamps[-1] < 10**8 else None
    if packets is None:
        raise refusal(path, f"millisecond {stamps[-1]} is over a day away; a packet trace counts from 0", lines[-1])
    found = Samples(f"Mahimahi, {len(stamps)} packets of 1,500 bytes", whole=True)
    # A packet counts in the millisecond that ends at its stamp; those at 0 begin the first, as the file repeats.
    busy = np.flatnonzero(packets)
    for previous, at in zip(np.concatenate([[0], busy]), busy, strict=False):
        if at > previous + 1:
            found.add(0, float(at - 1) / 1e3, 0.0, float(at - 1 - previous) / 1e3)
        found.add(0, float(at) / 1e3, float(packets[at]) * _PACKET_BITS * 1e3, 1e-3)
    return found


def byte_log(path: Path, rows: Rows) -> Samples:
    """The 4G and HSDPA logs: Unix time in s or ms, a clock in ms, latitude, longitude, bytes since, ms since."""
    found = Samples("log of bytes (unix, ms, latitude, longitude, bytes, ms)")
    for line, cells in rows:
        if len(cells) != _LOG_COLUMNS:
            raise refusal(
                path, f"{len(cells)} columns, expected {_LOG_COLUMNS} (unix ms latitude longitude bytes ms)", line
            )
        if any(is_missing(cells[at]) for at in (1, 4, 5)):
            found.left_out += 1
            continue
        end_s = _seconds(path, line, "clock", cells[1], 1e3)
        covered_s = _seconds(path, line, "interval", cells[5], 1e3)
        if covered_s < 0:
            raise refusal(path, f"interval {quoted(cells[5])} ms is negative", line)
        if covered_s == 0:
            found.left_out += 1
            continue
        found.add(line, end_s, rate_of(path, line, "bytes", cells[4], 8.0 / covered_s), covered_s)
    return found


def looks_like_byte_log(cells: Sequence[str]) -> bool:
    """Whether six numbers are a line of such a log: a Unix time, a clock, a place on earth, bytes and milliseconds."""
    values = [number_of(cell) for cell in cells]
    if len(values) != _LOG_COLUMNS or any(value is None for value in values):
        return False
    unix, _, latitude, longitude, count, covered = (value or 0.0 for value in values)
    return 1e8 < unix < 1e14 and abs(latitude) <= 90 and abs(longitude) <= 180 and count >= 0 and covered >= 0


def rate_of(path: Path, line: int, name: str, cell: str, bps: float) -> float:
    """A cell as a rate in bit/s, finite, not negative and within what is sane."""
    value = _finite(path, line, name, cell, number_of(cell))
    if value < 0:
        raise refusal(path, f"{name} {quoted(cell)} is negative; a dead link has rate 0", line)
    if value * bps > RATE_LIMIT_BPS:
        raise refusal(path, f"{name} {quoted(cell)} is over {RATE_LIMIT_BPS:g} bit/s; check --trace-unit", line)
    return value * bps


def _seconds(path: Path, line: int, name: str, cell: str, per_second: float) -> float:
    """A cell as a time in seconds, finite and within what is sane."""
    time_s = _finite(path, line, name, cell, seconds_of(cell, per_second))
    if abs(time_s) > TIME_LIMIT_S:
        reason = f"{name} {quoted(cell)} is no time in its unit; milliseconds are read with --trace-column"
        raise refusal(path, f"{reason} time_ms={name}", line)
    return time_s


def _finite(path: Path, line: int, name: str, cell: str, value: float | None) -> float:
    if value is None:
        raise refusal(path, f"{name} {quoted(cell)} is not a number; comment out text with #", line)
    if not abs(value) < float("inf"):
        raise refusal(path, f"{name} {quoted(cell)} is not finite", line)
    return value


def named_table(
    path: Path, line: int, names: Sequence[str], rows: Rows, wanted: Sequence[str], unit: str | None
) -> Samples:
    """Samples of a table whose first line names its columns."""
    columns = choose_columns(path, line, names, wanted, unit)
    return table(path, rows, names, columns, f"{names[columns.time]} and {names[columns.rate]}")

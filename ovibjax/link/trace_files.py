"""Reading measured throughput traces from files that nobody vouches for, in the form in which people have them.

The forms are those of `trace_formats`, told apart by what the file holds; a file that could be two of them is refused
with the option that settles it. `#` begins a comment.
"""

import math
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ovibjax.errors import InputError, refusal
from ovibjax.link.iperf_json import iperf3
from ovibjax.link.trace_columns import bps_per_unit, require_unit, seconds_of
from ovibjax.link.trace_formats import (
    Samples,
    bare_rates,
    byte_log,
    looks_like_byte_log,
    mahimahi,
    named_table,
)
from ovibjax.link.traces import Trace
from ovibjax.runtime.text_tables import (
    ContentLines,
    Rows,
    cells_of,
    is_missing,
    number_of,
    read_text,
    separator_of,
    with_points,
)

MAX_TRACE_BYTES = 50 * 2**20
"""Largest trace file accepted."""
MAX_GAP_S = 10.0
"""Longest interval between samples that is never a gap."""
MAX_GAP_INTERVALS = 5.0
"""Longest interval between samples that is not a gap, in median intervals of the trace."""

_MAX_LINE = 4000
# Rates that are no longer believed to be Mbit/s where nothing says so: beyond a phone, or so even that they are kbit/s.
_DOUBTFUL_MBPS, _DOUBTFUL_WHOLE_MBPS = 1000.0, 100.0
_DOUBTFUL_INTERVAL_S = 50.0
_TEXT = "two columns (s, Mbit/s)"


def read_trace(
    path: str | os.PathLike[str],
    max_gap_s: float | None = None,
    unit: str | None = None,
    columns: Sequence[str] = (),
) -> Trace:
    """Read one trace; nothing in the file is ever executed.

    Samples with the same time are averaged, and lines without a value (`-`, `NA`, empty) left out.

    Args:
        path: the file, UTF-8, in one of the forms of `ovibjax.link.trace_formats`.
        max_gap_s: longest interval allowed between consecutive samples; by default 10 s or 5 times the trace's
            median interval, whichever is larger. Between the two the link counts as dead, up to a median interval
            before the next sample. Infinity allows any.
        unit: of the rates, where the file does not say it, such as `kbit`.
        columns: which columns are meant: `NAME` of a time or a rate, or `KIND=NAME`, such as `time_ms=t`.

    Returns:
        The trace in bits per second; times keep the file's origin.

    Raises:
        InputError: naming file, line and, where one helps, the option: a column is unknown or there are several, a
            value is not a finite number, a time goes back, a rate is negative, there is a gap, or a unit is in doubt;
            or the file is missing, empty, binary, not UTF-8 or over 50 MiB.
    """
    path = Path(path)
    if max_gap_s is not None and not max_gap_s > 0:
        raise InputError(f"--max-gap {max_gap_s} is not a positive number of seconds")
    if unit is not None:
        require_unit(unit)
    found = _samples(path, read_text(path, MAX_TRACE_BYTES, "trace"), unit, columns)
    if not found.line:
        reason = f"{found.left_out} lines have no value" if found.left_out else "no sample follows the first line"
        raise refusal(path, f"{reason}; a trace needs two samples or more")
    return _trace(path, found, max_gap_s)


def _samples(path: Path, text: str, unit: str | None, columns: Sequence[str]) -> Samples:
    """The samples of a file in whichever form it is."""
    if text.lstrip().startswith("{"):
        _refuse_options(path, "iperf3 JSON", unit, ())
        return iperf3(path, text, columns)
    lines = ContentLines(text, inline_comments=True)
    first = next(iter(lines), None)
    if first is None:
        raise refusal(path, "no samples; the file is empty or holds only comments")
    separator = separator_of(first)
    rows = _rows(path, ContentLines(text, inline_comments=True), separator, separator in ";\t" or "," in first)
    line, cells = head = next(rows)
    data: Rows = _again(head, rows)
    if len(cells) == 2 and number_of(cells[0]) is not None and bps_per_unit(cells[1]):
        _refuse_options(path, "rates with units", unit, columns)
        return bare_rates(path, data, None)
    if not all(is_missing(cell) or seconds_of(cell, 0.0) is not None for cell in cells):
        return named_table(path, line, cells, rows, columns, unit)
    if len(cells) == 1:
        _refuse_options(path, "one column without a header", None, columns)
        return mahimahi(path, data) if unit is None else bare_rates(path, data, require_unit(unit))
    numbers = [str(number) for number in range(1, len(cells) + 1)]
    if columns:
        return named_table(path, line, numbers, data, columns, unit)
    if looks_like_byte_log(cells):
        _refuse_options(path, "log of bytes", unit, ())
        return byte_log(path, data)
    if len(cells) != 2:
        reason = f"{len(cells)} columns without names; say which two: --trace-column time_s=1 mbps={len(cells)}"
        raise refusal(path, reason, line)
    found = named_table(path, line, ["time", "mbit_s"], data, (), unit)
    found.form = _TEXT if unit is None else f"two columns (s, {unit})"
    if unit is None:
        _refuse_doubtful(path, found)
    return found


def _rows(path: Path, lines: ContentLines, separator: str, commas: bool) -> Rows:
    """Numbered lines with their cells, of bounded length; decimal commas, where there may be any, made points."""

    def bounded() -> Rows:
        for cells in cells_of(path, lines, separator):
            if (size := sum(map(len, cells)) + len(cells) - 1) > _MAX_LINE:
                raise refusal(path, f"{size} characters, over {_MAX_LINE}; not a trace", lines.number)
            yield lines.number, cells

    return with_points(path, bounded()) if commas and separator != "," else bounded()


def _again(head: tuple[int, list[str]], rows: Rows) -> Rows:
    yield head
    yield from rows


def _refuse_options(path: Path, form: str, unit: str | None, columns: Sequence[str]) -> None:
    """Options that the form of a file leaves no room for."""
    if unit is not None:
        raise refusal(path, f"{form}: its rates have their unit; leave out --trace-unit {unit}")
    if columns:
        raise refusal(path, f"{form}: leave out --trace-column {' '.join(columns)}")


def _refuse_doubtful(path: Path, found: Samples) -> None:
    """Two columns of numbers say no unit: refuse what can hardly be seconds and Mbit/s."""
    rates_mbps = np.array(found.rate_bps) / 1e6
    if (usual := rates_mbps[rates_mbps > 0]).size:
        whole = bool((usual == np.round(usual)).all())
        median = float(np.median(usual))
        if median > (_DOUBTFUL_WHOLE_MBPS if whole else _DOUBTFUL_MBPS):
            reason = f"rates around {median:g} in Mbit/s, the unit of such files, would be {median / 1e3:.3g} Gbit/s"
            raise refusal(path, f"{reason}; say what they are: --trace-unit kbit, or Mbit", found.line[0])
    intervals_s = np.diff(found.end_s)
    if intervals_s.size and intervals_s.min() >= _DOUBTFUL_INTERVAL_S and (intervals_s == np.round(intervals_s)).all():
        reason = f"intervals of {np.median(intervals_s):g} s or ms; say which: --trace-column time_ms=1 mbps=2"
        raise refusal(path, f"{reason}, or time_s=1", found.line[1])


def _trace(path: Path, found: Samples, max_gap_s: float | None) -> Trace:
    """Samples to a trace: repeats averaged, gaps refused or dead, the first interval opened where it is known."""
    line = np.array(found.line)
    end_s, rate_bps, covered_s = (np.array(column) for column in (found.end_s, found.rate_bps, found.covered_s))
    if (back := np.diff(end_s) < 0).any():
        at = int(back.argmax())
        times = f"time {float(end_s[at + 1])!r} s goes back from {float(end_s[at])!r} s"
        reason = f"{times} of line {line[at]}; sort the samples by time, or cut the trace there"
        raise refusal(path, reason, int(line[at + 1]))
    first = np.flatnonzero(np.concatenate([[True], np.diff(end_s) > 0]))
    repeats = end_s.size - first.size
    if repeats:
        count = np.diff(np.append(first, end_s.size))
        rate_bps = np.add.reduceat(rate_bps, first) / count
        covered_s, end_s, line = np.add.reduceat(covered_s, first) / count, end_s[first], line[first]
        found.notes.append(f"{repeats} repeated time{'s'[: repeats != 1]} averaged")
    if found.left_out:
        found.notes.append(f"{found.left_out} line{'s'[: found.left_out != 1]} without a value left out")
    if end_s.size < 2 and not np.isfinite(covered_s[0]):
        raise refusal(path, "one sample has no duration; a trace needs two or more", int(line[0]))
    if not found.whole:
        end_s, rate_bps, covered_s = _close_gaps(path, found, (line, end_s, rate_bps, covered_s), max_gap_s)
    if np.isfinite(covered_s[0]):
        end_s, rate_bps = np.append(end_s[0] - covered_s[0], end_s), np.append(rate_bps[0], rate_bps)
    form = ", ".join([f"{found.form}: {len(found.line)} samples", *found.notes])
    return Trace(end_s, rate_bps, str(path), form)


def _close_gaps(
    path: Path, found: Samples, samples: tuple[NDArray, ...], max_gap_s: float | None
) -> tuple[NDArray, NDArray, NDArray]:
    """Refuse intervals that are too long; fill those that only `max_gap_s` allows with a dead link."""
    line, end_s, rate_bps, covered_s = samples
    intervals_s = np.diff(end_s)
    if not intervals_s.size:
        return end_s, rate_bps, covered_s
    usual_s = float(np.median(intervals_s))
    known_s = np.where(np.isfinite(covered_s[1:]), covered_s[1:], 0.0)
    usual_limit_s = max(MAX_GAP_S, MAX_GAP_INTERVALS * usual_s)
    limit_s = usual_limit_s if max_gap_s is None else max_gap_s
    empty_s = intervals_s - known_s
    if (late := empty_s > limit_s).any():
        at = int(late.argmax())
        longest = math.ceil(float(empty_s.max()))
        reason = f"gap of {empty_s[at]:g} s after line {line[at]}, over {limit_s:g} s"
        raise refusal(path, f"{reason}; --max-gap {longest} takes the link for dead there", int(line[at + 1]))
    dead = empty_s > usual_limit_s
    if not dead.any():
        return end_s, rate_bps, covered_s
    where = np.flatnonzero(dead) + 1
    own_s = np.where(known_s[where - 1] > 0, known_s[where - 1], np.minimum(usual_s, intervals_s[where - 1] / 2))
    found.notes.append(f"{where.size} gap{'s'[: where.size != 1]}, {empty_s[dead].sum():.4g} s in all, at rate 0")
    end_s, rate_bps, covered_s = (
        np.insert(column, where, filled)
        for column, filled in ((end_s, end_s[where] - own_s), (rate_bps, 0.0), (covered_s, np.nan))
    )
    return end_s, rate_bps, covered_s

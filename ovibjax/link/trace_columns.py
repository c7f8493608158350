"""Columns of a throughput trace: what they may be called, in which units they count, and which of them are meant.

A column of times is known by its name, in any case:

| name                                                   | what is in it                                     |
|--------------------------------------------------------|---------------------------------------------------|
| `time_s`, `t_s`, `unix_s`, `seconds`, `sec`            | seconds from any origin                           |
| `time_ms`, `t_ms`, `unix_ms`, `milliseconds`, `ms`     | milliseconds from any origin                      |
| `timestamp`, `time`, `t`, `date`, `datetime`           | seconds, Unix time in s, ms, us or ns, or a date: |
|                                                        | `2019.12.16_13.40.04`, `2023-01-01 10:00:00.5Z`   |

and a column of rates by the unit at the end of its name, as in `mbps`, `throughput_kbps` or `Rate (Mbit/s)`. Case
counts there, because MBps is not Mbps:

| unit                                                     | bit/s         |
|----------------------------------------------------------|---------------|
| `bps`, `bit/s`, `bit`                                    | 1             |
| `kbps`, `Mbps`, `Gbps`; `mbit_s`, `Mbits/sec`, `kb/s`    | 1,000s of it  |
| `bytes_per_s`, `B/s`, `byte`                             | 8             |
| `kB/s`, `MB/s`, `GB/s`; `kB`, `MB`                       | 1,000s of it  |
| `KB/s`, `kb_per_s`, `KB`                                 | 8,192, as in the paper |
| `KBytes/sec`, `MBytes/sec`, `GBytes/sec`                 | 8 times 1,024, 1,024² and 1,024³, as iperf counts |

`DL_bitrate` and `UL_bitrate` of drive tests are in kbit/s.
"""

import datetime
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from ovibjax.errors import InputError, refusal
from ovibjax.runtime.text_tables import number_of, quoted

UNITS_SHOWN = "bit, kbit, Mbit, Gbit, byte, kB, KB or MB"

_SECONDS = ("time_s", "t_s", "unix_s", "seconds", "sec")
_MILLISECONDS = ("time_ms", "t_ms", "unix_ms", "milliseconds", "ms")
_TIMESTAMPS = ("timestamp", "time", "t", "date", "datetime")
# A divisor, because 1,000 is exact in binary and 0.001 is not; zero stands for what the values themselves tell.
_PER_SECOND = dict.fromkeys(_SECONDS, 1.0) | dict.fromkeys(_MILLISECONDS, 1e3) | dict.fromkeys(_TIMESTAMPS, 0.0)

_PREFIX = {"": 1.0, "k": 1e3, "m": 1e6, "g": 1e9}
_BITS = re.compile(r"(?i:([kmg]?)(?:bits?(?:/s|/sec|_s|ps|_per_s|)|bps))|([kKMG]b)/s")
_BYTES = re.compile(r"([kMG]?)(?:(?i:bytes?)|B)(?:/s|/sec|ps|_per_s|)")
_OTHER_UNITS = {"KB/s": 8192.0, "KB": 8192.0, "KBps": 8192.0, "kb_per_s": 8192.0}
_OTHER_UNITS |= {f"{p}Bytes{end}": 8.0 * 1024**n for n, p in enumerate("KMG", 1) for end in ("/sec", "/s", "")}
_RATE_NAMES = {"DL_bitrate": 1e3, "UL_bitrate": 1e3}
_DRIVE_TEST = "%Y.%m.%d_%H.%M.%S"


class Columns(NamedTuple):
    """Which two columns a trace is, by number from 0, and how they count.

    Attributes:
        time: column of times.
        per_second: their units in a second; 0 where the values tell.
        rate: column of rates.
        bps: bit/s in one unit of the rate.
    """

    time: int
    per_second: float
    rate: int
    bps: float


def bps_per_unit(word: str) -> float | None:
    """Bits per second in one unit of throughput, `Mbit/s` or `kB`; None if it is none."""
    if word in _OTHER_UNITS:
        return _OTHER_UNITS[word]
    if found := _BITS.fullmatch(word):
        # "MBps" is megabytes, whatever the rest of the pattern ignores.
        return (8.0 if word.endswith("Bps") else 1.0) * _PREFIX[(found[1] or found[2] or "")[:1].lower()]
    if found := _BYTES.fullmatch(word):
        return 8.0 * _PREFIX[found[1].lower()]
    return None


def require_unit(word: str) -> float:
    """Bits per second in the unit that somebody typed.

    Raises:
        InputError: no such unit.
    """
    if (bps := bps_per_unit(word)) is None:
        raise InputError(f"--trace-unit {word}: no unit of throughput; give {UNITS_SHOWN}")
    return bps


def unit_in_name(name: str) -> float | None:
    """Bits per second in the unit that a column's name ends with, as in `throughput_mbps`; None without one."""
    if name in _RATE_NAMES:
        return _RATE_NAMES[name]
    short = name.rstrip(" )]").replace("(", " ").replace("[", " ")
    # `mbit` alone is a unit if somebody types it; at the end of a name, `byte` would be a count.
    parts = [short, *(short[at.end() :] for at in re.finditer(r"[ _]", short))]
    return next((bps for part in parts if re.search(r"/s|_s|ps$", part) and (bps := bps_per_unit(part))), None)


def choose_columns(path: Path, line: int, names: Sequence[str], wanted: Sequence[str], unit: str | None) -> Columns:
    """Find the time and the rate among the columns of a table.

    Args:
        path: the file, for messages.
        line: number of the header.
        names: columns; numbers from 1 where the table has no header.
        wanted: what `--trace-column` says: `NAME` of a time or a rate, or `KIND=NAME`, such as `time_ms=t`.
        unit: what `--trace-unit` says of the rate.

    Returns:
        The columns.

    Raises:
        InputError: a column is missing, or several would do; the message names the option that settles it.
    """
    listed = ", ".join(names)
    times = {at: _PER_SECOND[name.lower()] for at, name in enumerate(names) if name.lower() in _PER_SECOND}
    rates = {at: bps for at, name in enumerate(names) if at not in times and (bps := unit_in_name(name))}
    for item in wanted:
        kind, name = _kind_and_name(item, names)
        at = names.index(name) if names.count(name) == 1 else -1
        if at < 0:
            often = "occurs more than once" if name in names else "no such column"
            raise refusal(path, f"--trace-column {item}: {often}; there are {listed}", line)
        if kind in _PER_SECOND:
            times = {at: _PER_SECOND[kind]}
        else:
            rates = {at: bps_per_unit(kind) or rates.get(at, 0.0)}
    if unit is not None:
        rates = dict.fromkeys(rates, require_unit(unit))
    if len(times) != 1:
        which = f"several times ({_listed(names, times)})" if times else f"no column of times among {listed}"
        free = [name for at, name in enumerate(names) if at not in rates]
        raise refusal(path, f"{which}; name it: --trace-column {_example(names, times, 'time_s', free)}", line)
    ((time, per_second),) = times.items()
    rates.pop(time, None)
    if len(rates) != 1:
        which = (
            f"several rates ({_listed(names, rates)})" if rates else f"no column of rates with a unit among {listed}"
        )
        free = [name for at, name in enumerate(names) if at != time]
        raise refusal(path, f"{which}; choose one: --trace-column {_example(names, rates, 'kbps', free)}", line)
    ((rate, bps),) = rates.items()
    if not bps:
        reason = f"the name of column {quoted(names[rate])} tells no unit; add --trace-unit, one of {UNITS_SHOWN}"
        raise refusal(path, reason, line)
    return Columns(time, per_second, rate, bps)


def _kind_and_name(item: str, names: Sequence[str]) -> tuple[str, str]:
    """What `--trace-column` says: a kind (`time_s`, `kbps`, or "" for a rate by its name), and a column."""
    kind, equals, name = item.partition("=")
    if not equals or item in names:
        return (item.lower() if item.lower() in _PER_SECOND else ""), item
    if kind not in _PER_SECOND and bps_per_unit(kind) is None:
        raise InputError(f"--trace-column {item}: {quoted(kind)} is neither a time (time_s, time_ms) nor a unit (kbps)")
    return kind, name


def _listed(names: Sequence[str], found: dict[int, float]) -> str:
    return ", ".join(names[at] for at in found)


def _example(names: Sequence[str], found: dict[int, float], kind: str, free: Sequence[str]) -> str:
    """What could be typed: one that was found, or else a column that is free, as this kind."""
    return names[next(iter(found))] if found else f"{kind}={(free or ['NAME'])[0]}"


def seconds_of(cell: str, per_second: float) -> float | None:
    """A time in seconds; None if the cell holds none.

    Args:
        cell: a number, or a date in the forms of the module's table; without a zone it counts as UTC.
        per_second: units in a second; 0 where the value itself tells.

    Returns:
        Seconds, possibly infinite or beyond what is sane.
    """
    value = number_of(cell)
    if value is not None:
        return value / (per_second or _unix_units(value))
    if per_second:
        return None
    try:
        moment = datetime.datetime.strptime(cell, _DRIVE_TEST) if "_" in cell else datetime.datetime.fromisoformat(cell)
    except ValueError:
        return None
    return (moment if moment.tzinfo else moment.replace(tzinfo=datetime.UTC)).timestamp()


def _unix_units(value: float) -> float:
    """Units in a second of a Unix time: the magnitudes of s, ms, us and ns since 1973 do not meet."""
    size = abs(value) if math.isfinite(value) else 0.0
    return next((units for limit, units in ((1e17, 1e9), (1e14, 1e6), (1e11, 1e3)) if size > limit), 1.0)

"""Traces from `iperf3 --json` and `iperf3 --json-stream`: the rate of every interval that it reports."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ovibjax.errors import refusal
from ovibjax.link.trace_formats import Samples
from ovibjax.link.traces import RATE_LIMIT_BPS


def iperf3(path: Path, text: str, wanted: Sequence[str]) -> Samples:
    """Intervals of `iperf3 --json` or `--json-stream`; `--trace-column` chooses of two directions."""
    intervals = _intervals(path, text)
    sums = sorted({key for one in intervals for key in one if key.startswith("sum")})
    if wanted and (len(wanted) != 1 or wanted[0] not in sums):
        raise refusal(path, f"--trace-column {' '.join(wanted)}: intervals have {', '.join(sums)}")
    if len(sums) > 1 and not wanted:
        raise refusal(path, f"two directions, {', '.join(sums)}; choose one: --trace-column {sums[0]}")
    key = wanted[0] if wanted else "sum"
    found = Samples("iperf3 JSON" if key == "sum" else f"iperf3 JSON, {key}")
    for number, interval in enumerate(intervals, start=1):
        about = interval.get(key)
        values = [about.get(name) if isinstance(about, dict) else None for name in ("start", "end", "bits_per_second")]
        if not all(isinstance(value, int | float) and abs(value) < RATE_LIMIT_BPS for value in values):
            raise refusal(path, f"interval {number}: {key} has no usable start, end and bits_per_second")
        start_s, end_s, rate_bps = (float(value) for value in values if value is not None)
        if isinstance(about, dict) and about.get("omitted") is True:
            found.left_out += 1
        elif not start_s < end_s or rate_bps < 0:
            raise refusal(path, f"interval {number}: from {start_s:g} to {end_s:g} s at {rate_bps:g} bit/s is none")
        else:
            found.add(number, end_s, rate_bps, end_s - start_s)
    return found


def _intervals(path: Path, text: str) -> list[dict[str, Any]]:
    """The list `intervals` of a JSON document, or the intervals of a stream of events, one a line."""
    try:
        try:
            told = json.loads(text)
        except json.JSONDecodeError as error:
            if not error.msg.startswith("Extra data"):
                raise
            events = [json.loads(line) for line in text.splitlines() if line.strip()]
            told = {
                "intervals": [e.get("data") for e in events if isinstance(e, dict) and e.get("event") == "interval"]
            }
    except json.JSONDecodeError as error:
        raise refusal(path, f"JSON that ends or breaks ({error.msg}); run iperf3 to its end", error.lineno) from error
    except (ValueError, RecursionError) as error:
        raise refusal(path, "JSON that cannot be read") from error
    intervals = told.get("intervals") if isinstance(told, dict) else None
    if not isinstance(intervals, list) or not intervals or not all(isinstance(one, dict) for one in intervals):
        why = told.get("error") if isinstance(told, dict) else None
        raise refusal(path, f"JSON without the intervals of iperf3 --json{f' ({why})' if why else ''}")
    return intervals

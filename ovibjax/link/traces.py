"""A measured throughput trace, and the mean rate it gives in each of a run of slots."""

import operator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ovibjax.errors import InputError, refusal

TIME_LIMIT_S = 1e11
"""Latest time accepted: beyond the year 5000, but early in 1973 for a Unix time in milliseconds."""
RATE_LIMIT_BPS = 1e15
"""Highest rate accepted."""

_MAX_REPEATS = 1e9
_SNAP = 1e-6  # of a slot


@dataclass(frozen=True, eq=False)
class Trace:
    """A measured throughput trace: piecewise constant, each sample the mean rate over the interval that it ends.

    So Pensieve's simulator reads its traces: `rate_bps[i]` holds from `time_s[i - 1]` to `time_s[i]`, the first rate
    closes no interval, and the trace lasts from the first time to the last.

    Attributes:
        time_s: [n] float64 seconds, increasing, from any origin; a read-only copy, as is the next.
        rate_bps: [n] float64 bits per second, zero or more.
        source: what messages call the trace; the file it was read from.
        form: what the file was taken for, its samples, and what was left out or added.

    Raises:
        InputError: fewer than two samples, differing lengths, a time that does not increase, or a rate that is
            negative or not finite.
    """

    time_s: NDArray[np.float64]
    rate_bps: NDArray[np.float64]
    source: str = "trace"
    form: str = ""

    def __post_init__(self) -> None:
        for name in ("time_s", "rate_bps"):
            column = np.array(getattr(self, name), np.float64)
            column.setflags(write=False)
            object.__setattr__(self, name, column)
        if self.time_s.shape != self.rate_bps.shape or self.time_s.ndim != 1 or self.time_s.size < 2:
            shapes = f"times of shape {self.time_s.shape} and rates of shape {self.rate_bps.shape}"
            raise refusal(self.source, f"{shapes}; a trace needs two or more samples, one rate per time")
        if not np.all(np.abs(self.time_s) <= TIME_LIMIT_S) or not np.all(np.diff(self.time_s) > 0):
            raise refusal(self.source, "times must be finite seconds and increase")
        if not np.all((self.rate_bps >= 0) & (self.rate_bps <= RATE_LIMIT_BPS)):
            raise refusal(self.source, f"rates must be 0 to {RATE_LIMIT_BPS:g} bit/s")

    @property
    def duration_s(self) -> float:
        """Seconds from the first sample to the last."""
        return float(self.time_s[-1] - self.time_s[0])

    def describe(self) -> str:
        """What was understood, in one line: form, samples, seconds, mean and peak rate."""
        mean_bps = float(self.rate_bps[1:] @ np.diff(self.time_s)) / self.duration_s
        form = self.form or f"{self.time_s.size} samples"
        rates = f"mean {_rate_text(mean_bps)}, peak {_rate_text(float(self.rate_bps[1:].max()))}"
        return f"{form}; {self.duration_s:.5g} s, {rates}"


def _rate_text(rate_bps: float) -> str:
    """A rate in the unit that suits its size."""
    prefix, unit_bps = next((u for u in (("G", 1e9), ("M", 1e6), ("k", 1e3)) if rate_bps >= u[1]), ("", 1.0))
    return f"{rate_bps / unit_bps:.3g} {prefix}bit/s"


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
    if not (slot_s > 0 and n_slots >= 1 and start_s >= 0 and start_s + n_slots * slot_s <= TIME_LIMIT_S):
        raise InputError(f"{given}: give one or more slots of positive finite length, from a start of 0 or later")
    edges_s: NDArray[np.float64] = start_s + slot_s * np.arange(n_slots + 1, dtype=np.float64)
    if not np.all(np.diff(edges_s) > 0.5 * slot_s):
        raise InputError(f"{given}: too short to tell slots apart at {edges_s[-1]:g} s; use longer slots")
    snap_s = _SNAP * slot_s
    if edges_s[-1] > trace.duration_s * (_MAX_REPEATS if loop else 1.0) + snap_s:
        asked = f"{n_slots} slots of {slot_s:g} s from {start_s:g} s end at {edges_s[-1]:g} s"
        remedy = "ask for fewer slots" + ("" if loop else " or let it loop")
        reason = f"too short: it lasts {trace.duration_s:g} s, but {asked}; {remedy}"
        raise refusal(trace.source, reason)
    bits, elapsed_s = _received_bits(trace, edges_s, snap_s)
    return (bits / elapsed_s).astype(np.float32)

"""Percentiles of any number of latencies in the same few kilobytes: counts in classes that are one per cent wide."""

import numpy as np

_LEAST_MS, _MOST_MS, _STEP = 1e-3, 1e7, 1.01
_CLASSES = int(np.ceil(np.log(_MOST_MS / _LEAST_MS) / np.log(_STEP))) + 1


class Latencies:
    """Latencies of a kind; a percentile is exact to one per cent.

    Attributes:
        count: how many there were.
        total_ms: their sum.
    """

    def __init__(self) -> None:
        self.count, self.total_ms = 0, 0.0
        self._counts = np.zeros(_CLASSES, np.int64)

    def add(self, latency_ms: float) -> None:
        """Count one."""
        self.count += 1
        self.total_ms += latency_ms
        at = np.log(min(max(latency_ms, _LEAST_MS), _MOST_MS) / _LEAST_MS) / np.log(_STEP)
        self._counts[int(at)] += 1

    def percentile_ms(self, percent: float) -> float:
        """The latency that so many per cent do not exceed; NaN of none."""
        if not self.count:
            return float("nan")
        at = np.searchsorted(np.cumsum(self._counts), max(1.0, np.ceil(self.count * percent / 100.0)))
        return float(_LEAST_MS * _STEP ** (at + 0.5))

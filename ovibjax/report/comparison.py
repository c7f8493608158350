"""The paper's numbers beside ours, point by point."""

import math
from dataclasses import dataclass

from ovibjax.report.claims import Interval

MOST = 10.0
"""Ratio at the ends of the strip that shows it; what lies beyond is drawn there."""


@dataclass(frozen=True)
class Pair:
    """One number of the paper, and ours.

    Attributes:
        figure: name of the figure that it belongs to.
        quantity: what was measured, and where.
        unit: of both; empty for a count.
        paper: the paper's.
        ours: ours; infinite half-width where there is no interval.
    """

    figure: str
    quantity: str
    unit: str
    paper: float
    ours: Interval

    @property
    def ratio(self) -> float | None:
        """Ours over the paper's; None where either is not positive."""
        return self.ours.mean / self.paper if self.ours.mean > 0 and self.paper > 0 else None

    def span(self) -> tuple[float, float, float] | None:
        """Low end, mean and high end of the ratio on a logarithmic strip from 0 to 1; 0.5 is where both agree."""
        if self.ratio is None:
            return None
        half = self.ours.cap / self.paper
        low, mean, high = (_place(ratio) for ratio in (self.ratio - half, self.ratio, self.ratio + half))
        return low, mean, high


def _place(ratio: float) -> float:
    """Place of a ratio between 1 / `MOST` and `MOST`."""
    if ratio <= 1 / MOST:
        return 0.0
    return min(1.0, 0.5 + 0.5 * math.log(ratio) / math.log(MOST))

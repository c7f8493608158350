"""Numbers as the cells of a table or a heat map: as many digits as their intervals deserve."""

import math
from collections.abc import Iterable

import numpy as np

from ovibjax.report.claims import Interval

SPREAD = " ± "
"""Between a mean and the half-width of its interval."""


def cells(mean: np.ndarray, half: np.ndarray, at: Iterable[int] | None = None) -> list[str]:
    """Text of means with intervals: two digits of the typical half-width, or four of the typical value.

    Args:
        mean: [P] means; NaN is written as a dash.
        half: [P] half-widths of intervals; not written where not finite.
        at: positions to write; all by default. The digits are those of all.

    Returns:
        The texts.
    """
    halves, sizes = half[np.isfinite(half) & (half > 0)], np.abs(mean[np.isfinite(mean) & (mean != 0)])
    digits = 0
    if halves.size:
        digits = 1 - math.floor(math.log10(np.median(halves)))
    elif sizes.size and (sizes % 1).any():
        digits = 3 - math.floor(math.log10(np.median(sizes)))
    # Columns over many decades, or far from one, are written number by number.
    fixed = digits <= 6 and (not sizes.size or (sizes.max() < 1e7 and sizes.min() >= 10.0 ** min(1 - digits, 0)))
    texts = []
    for i in range(len(mean)) if at is None else at:
        m, h = float(mean[i]), float(half[i])
        spread = f"{SPREAD}{h:.2g}" if math.isfinite(h) else ""
        text = Interval(m, h).text(digits=max(digits, 0)) if fixed else f"{m:.4g}{spread}"
        texts.append(text if math.isfinite(m) else "-")
    return texts

"""Scales of the axes of a drawing, from the numbers that stand on them."""

import math
from typing import Literal

import numpy as np
from matplotlib.axes import Axes

from ovibjax.report import figures as fig

LOG_SPAN = 30.0
"""Positive numbers that span so large a factor are drawn on a logarithmic scale."""


def scale_to(ax: Axes, which: Literal["x", "y"], values: np.ndarray, at_values: bool = False) -> None:
    """Scale and ticks of a numeric axis: logarithmic where its numbers span decades, unless they are evenly spaced.

    A zero among such numbers stands on a linear piece before the least of them.

    Args:
        ax: the panel.
        which: its abscissa or ordinate.
        values: [n] the numbers.
        at_values: whether ticks stand at the numbers, those that have room.
    """
    axis = ax.xaxis if which == "x" else ax.yaxis
    set_scale = ax.set_xscale if which == "x" else ax.set_yscale
    numbers = np.unique(values).astype(np.float64)
    positive = numbers[numbers > 0]
    even = len(numbers) > 2 and np.allclose(np.diff(numbers), numbers[1] - numbers[0], rtol=1e-3)
    log = bool(numbers[0] >= 0 and len(positive) > 1 and positive[-1] >= LOG_SPAN * positive[0] and not even)
    place = numbers
    if log and numbers[0] == 0:
        decades = float(np.clip(np.median(np.diff(np.log10(positive))), 0.3, 1.0))
        # The linear piece from 0 to the least value is as wide as linscale * 10 / 9 decades.
        set_scale("symlog", linthresh=positive[0], linscale=0.9 * decades)
        place = np.r_[np.log10(positive[0]) - decades, np.log10(positive)]
    elif log:
        set_scale("log")
        place = np.log10(numbers)
    if at_values and place[-1] > place[0]:
        axis.set_ticks(numbers, _texts(numbers, (place - place[0]) / (place[-1] - place[0]), log))
        axis.minorticks_off()
    elif log and numbers[0] > 0 and numbers[-1] < 1e3 * numbers[0]:
        fig.plain_log_ticks(axis)


def _texts(numbers: np.ndarray, places: np.ndarray, log: bool) -> list[str]:
    """Numbers as the ticks at their places, 0 to 1; empty where the one before leaves no room."""
    positive = numbers[numbers > 0]
    plain = positive.size == 0 or (positive[0] >= 1e-3 and positive[-1] < 1e5)
    texts, end = [], -math.inf
    for value, at in zip(numbers, places, strict=True):
        text = f"{value:g}" if plain or not log else _power(value)
        # Widths in the panel: seven-point digits on 2.7 inches.
        half_width = 0.5 * (0.022 * (4 if "$" in text else len(text)) + 0.02)
        texts.append(text if at - half_width >= end else "")
        end = at + half_width if texts[-1] else end
    return texts


def _power(value: float) -> str:
    if value == 0:
        return "0"
    mantissa, exponent = f"{value:.5e}".split("e")
    times = "" if float(mantissa) == 1 else rf"{float(mantissa):g}\cdot"
    return rf"${times}10^{{{int(exponent)}}}$"

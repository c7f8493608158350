"""What robot and edge must share to send codes as few bytes: steps and shares per coordinate, fitted on training codes.

All decisions that involve floats are made here, once; what is stored are whole numbers and float32 steps. A table goes
into files as plain arrays.
"""

from types import ModuleType
from typing import NamedTuple

import numpy as np

from ovibjax.link.codes.arithmetic import TOTAL
from ovibjax.link.codes.rounding import Array, Grid, numbers_of, values_of

CODES = ("float32", "int8", "int4", "entropy")
"""How coordinates are written: as they are, in a byte or half a byte each, or by an arithmetic coder."""

LEVELS = {"int8": 256, "int4": 16}

LOST = 0.0088
"""Share of the variance of a code that its rounding for `entropy` may cost, unless a step is given: that of steps of
0.5 on tuning seeds of the town, which cost no accuracy there at prefixes of 24 and more."""

PSEUDO_COUNT = 16.0
"""Training codes that the smooth guess of shares counts for against what was seen."""

RANGE_SHARES = np.linspace(0.25, 1.0, 16)
"""Shares of the range of training codes that the places of `int8` and `int4` may span; the rest saturates."""

_MOST_LEVELS = 4096
_FURTHEST = 1 << 20  # whole numbers that float32 holds exactly, with room


class CodeTable(NamedTuple):
    """Grids of K coordinates and, for `entropy`, how frequent their places are.

    Attributes:
        grid: grids of the coordinates.
        cumulative: [K, L + 1] int32, how many of 2^16 lie below each place of the grid, from 0; behind the last place
            2^16 again and again. Without columns where the code has no use for it.
    """

    grid: Grid
    cumulative: np.ndarray


def fit_table(code: str, codes: np.ndarray, step: np.ndarray | float | None = None) -> CodeTable | None:
    """Fit what a code needs on training codes.

    Args:
        code: one of `CODES`.
        codes: [N, K] training codes, finite.
        step: for `entropy`: the step, one or [K]; by default `fitted_step`. Those of `int8` and `int4` follow from the
            codes.

    Returns:
        The table; None for `float32`.

    Raises:
        ValueError: an unknown code, codes that are no finite table, a step that is not positive or far too small.
    """
    if code not in CODES:
        raise ValueError(f"code is one of {', '.join(CODES)}, not {code!r}")
    codes = np.asarray(codes, np.float32)
    if codes.ndim != 2 or not codes.size or not np.isfinite(codes).all():
        raise ValueError(f"codes are a finite table [N, K], not shape {codes.shape}")
    if code == "float32":
        return None
    if code == "entropy":
        chosen = fitted_step(np.var(codes.astype(np.float64), axis=0), np) if step is None else step
        return _frequencies(codes, np.broadcast_to(np.asarray(chosen, np.float32), codes.shape[1:]))
    return CodeTable(_even_grid(codes, LEVELS[code]), np.zeros((codes.shape[1], 0), np.int32))


def fitted_step(variance: Array, xp: ModuleType) -> Array:
    """The one step that costs the share `LOST` of the variance of codes.

    A coordinate loses a twelfth of the squared step, or all of its variance where that is less.

    Args:
        variance: [K] of the coordinates.
        xp: NumPy or `jax.numpy`.

    Returns:
        The step, a scalar; 1 where nothing varies.
    """
    ascending = xp.sort(variance)
    below = xp.cumsum(ascending) - ascending
    # What each of the others may lose if the m least variable coordinates lose everything; the first m that fits.
    left = (LOST * xp.sum(ascending) - below) / np.arange(len(variance), 0, -1).astype(np.float32)
    square = 12 * left[xp.argmax(ascending >= left)]
    return xp.where(square > 0, xp.sqrt(xp.maximum(square, 1e-30)), 1.0)


def check_table(table: CodeTable) -> None:
    """Refuse a table that somebody damaged.

    Args:
        table: whatever a file held.

    Raises:
        ValueError: steps that are not positive, bounds or shares that no fit gives.
    """
    (step, first, last), cumulative = table
    shapes = {np.shape(step), np.shape(first), np.shape(last), np.shape(cumulative)[:1]}
    if len(shapes) != 1 or np.ndim(cumulative) != 2:
        raise ValueError("a code table whose parts differ in length")
    if not (np.isfinite(step).all() and (np.asarray(step) > 0).all()):
        raise ValueError("a code table with a step that is not positive")
    levels = np.asarray(last, np.int64) - first + 1
    if levels.min() < 1 or levels.max() > _MOST_LEVELS or max(np.abs(first).max(), np.abs(last).max()) > _FURTHEST:
        raise ValueError("a code table with bounds that no grid has")
    for count, row in zip(levels, cumulative if cumulative.shape[1] else (), strict=False):
        inside, behind = row[: count + 1].astype(np.int64), row[count + 1 :]
        whole = len(inside) == count + 1 and inside[0] == 0 and inside[-1] == TOTAL
        if not whole or np.diff(inside).min() < 1 or (behind != TOTAL).any():
            raise ValueError("a code table whose shares do not add up")


def _even_grid(codes: np.ndarray, levels: int) -> Grid:
    """Per coordinate the part of its range that, cut into so many places, costs the least squared error."""
    low, high = codes.min(axis=0).astype(np.float64), codes.max(axis=0).astype(np.float64)
    middle, half = (high + low) / 2, (high - low) / 2
    # A coordinate that never moves still needs a step that its value is a small multiple of.
    least = np.maximum(np.abs(middle) / _FURTHEST * 2, 1e-20)
    grids, errors = [], []
    for share in RANGE_SHARES:
        step = np.maximum(2 * share * half / (levels - 2), least).astype(np.float32)
        first = np.floor((middle - share * half) / step).astype(np.int32)
        grids.append(Grid(step, first, first + np.int32(levels - 1)))
        received = values_of(grids[-1], numbers_of(grids[-1], codes))
        errors.append(np.mean((received.astype(np.float64) - codes) ** 2, axis=0))
    best, column = np.argmin(errors, axis=0), np.arange(codes.shape[1])
    return Grid(*(np.stack(part)[best, column] for part in zip(*grids, strict=True)))


def _frequencies(codes: np.ndarray, step: np.ndarray) -> CodeTable:
    """Places of a given step with how often each was seen, smoothed by a Gaussian."""
    if not (np.isfinite(step).all() and (step > 0).all()):
        raise ValueError("the step of a code is positive")
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        number = np.rint(codes * (np.float32(1) / step))
    if not np.abs(number).max() < _FURTHEST - _MOST_LEVELS:
        raise ValueError(f"a step of {step.min():g} is far below the range of the codes")
    number = number.astype(np.int64)
    low, high = number.min(axis=0), number.max(axis=0)
    margin = 2 + (high - low) // 8  # unseen codes go further
    first, last = low - margin, high + margin
    levels = last - first + 1
    if levels.max() > _MOST_LEVELS:
        raise ValueError(f"a step of {step.min():g} cuts a coordinate into more than {_MOST_LEVELS} places")
    cumulative = np.full((codes.shape[1], levels.max() + 1), TOTAL, np.int32)
    for j, count in enumerate(levels):
        seen = np.bincount(number[:, j] - first[j], minlength=count)
        place = np.arange(count) + first[j]
        width = np.sqrt(np.var(number[:, j]) + 1 / 12)
        bell = np.exp(-0.5 * ((place - number[:, j].mean()) / width) ** 2) + 1e-6
        share = (seen + PSEUDO_COUNT * bell / bell.sum()) / (len(codes) + PSEUDO_COUNT)
        cumulative[j, : count + 1] = np.concatenate([[0], np.cumsum(_whole(share))])
    grid = Grid(np.array(step, np.float32), first.astype(np.int32), last.astype(np.int32))
    return CodeTable(grid, cumulative)


def _whole(share: np.ndarray) -> np.ndarray:
    """Shares as whole numbers that add up to `TOTAL`, none of them zero: the largest remainders are rounded up."""
    exact = share / share.sum() * (TOTAL - len(share))
    counts = np.floor(exact).astype(np.int64)
    order = np.argsort(counts - exact, kind="stable")
    counts[order[: TOTAL - len(share) - counts.sum()]] += 1
    return counts + 1

"""Positions far from zero: kept in float64 as they come, and given to JAX in float32 as differences from an origin.

A national grid has coordinates of millions of metres, where float32 steps by half a metre. Near an origin of its own a
route of kilometres keeps its tenths of a millimetre.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

MAX_MAGNITUDE_M = 1e9
"""Largest coordinate taken for one."""
FINE_M = 1e-3
"""Steps between neighbouring numbers of a type that are as good as none."""

_GRID_M = 1024.0  # a power of two: float32 holds its multiples exactly up to 1.7e10 m


def origin_of(*positions_m: ArrayLike) -> NDArray[np.float64]:
    """The origin of some positions: the middle of their range, to the next multiple of 1,024 m.

    Zero for whatever lies within half a kilometre of zero, so that small scenes keep their coordinates.

    Args:
        positions_m: [N, D] each, N > 0, metres, finite.

    Returns:
        [D], exact in float32 too.
    """
    places = np.concatenate([np.asarray(part, np.float64) for part in positions_m])
    middle: NDArray[np.float64] = (places.min(axis=0) + places.max(axis=0)) / 2
    return np.round(middle / _GRID_M) * _GRID_M + 0.0  # no negative zero


def from_origin(positions_m: ArrayLike, origin_m: ArrayLike) -> NDArray[np.float32]:
    """Differences from an origin, subtracted in float64.

    Args:
        positions_m: [..., D] metres.
        origin_m: [D] metres, see `origin_of`.

    Returns:
        [..., D] in float32.
    """
    return (np.asarray(positions_m, np.float64) - np.asarray(origin_m, np.float64)).astype(np.float32)


def coarse_m(positions_m: NDArray[np.generic]) -> float:
    """What positions may have lost in their type: the step from the largest of them to the next number, metres.

    Args:
        positions_m: any shape, real or integer.

    Returns:
        The step; 0 for integers, and where it is fine.
    """
    if positions_m.dtype.kind != "f" or not positions_m.size:
        return 0.0
    step_m = float(np.spacing(np.abs(positions_m).max()))
    return step_m if step_m > FINE_M else 0.0

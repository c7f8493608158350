"""Grids that coordinates of a code are rounded to: whole multiples of a step, from a first to a last one.

A value on a grid is a whole number times a float32 step: one correctly rounded product, the same bits on any processor.
There is nothing to add to it, so that no compiler can fuse the product with a sum.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

Array = jax.Array | np.ndarray


class Grid(NamedTuple):
    """What the coordinates of a code are rounded to.

    Attributes:
        step: [K] float32 distance of neighbours, positive.
        first: [K] int32 number of the lowest multiple.
        last: [K] int32 number of the highest multiple; values beyond either saturate.
    """

    step: Array
    first: Array
    last: Array


def snapped(grid: Grid | None, z: jax.Array) -> jax.Array:
    """Codes as the edge receives them: each coordinate at the nearest place of its grid, of two the even one.

    Args:
        grid: grids of K coordinates; None leaves the code as it is.
        z: [..., K] codes.

    Returns:
        [..., K] float32, equal bit by bit to `values_of(grid, numbers_of(grid, z))`.
    """
    if grid is None:
        return z
    step, first, last = (along_last(jnp.asarray(part).astype(jnp.float32), z) for part in grid)
    return jnp.clip(jnp.rint(z * (1.0 / step)), first, last) * step


def along_last(row: jax.Array, z: jax.Array) -> jax.Array:
    """A row [K] with leading axes of length one, as many as a table [..., K] has."""
    return row.reshape((1,) * (z.ndim - 1) + row.shape)


def numbers_of(grid: Grid, prefix: np.ndarray) -> np.ndarray:
    """Whole numbers of a code's first coordinates.

    Args:
        grid: grids of K coordinates.
        prefix: [..., k] float32 coordinates, k at most K.

    Returns:
        [..., k] int64 multiples, from `first` to `last`; what is not a number becomes `first`.
    """
    step, first, last = (np.asarray(part)[: prefix.shape[-1]] for part in grid)
    with np.errstate(over="ignore", invalid="ignore"):
        # The reciprocal first: compilers make it of a quotient by constants, and their bits would be others.
        number = np.rint(np.asarray(prefix, np.float32) * (np.float32(1) / step))
    return np.where(np.isnan(number), first, np.clip(number, first, last)).astype(np.int64)


def values_of(grid: Grid, numbers: np.ndarray) -> np.ndarray:
    """Coordinates that whole numbers stand for: [..., k] float32 of [..., k] multiples."""
    return numbers.astype(np.float32) * np.asarray(grid.step, np.float32)[: numbers.shape[-1]]

"""The rungs of a halving: where a training is cut, which members there are on each, and which points go on."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray

from ovibjax.errors import InputError
from ovibjax.sweep.grid import Axis, Grid
from ovibjax.sweep.program import SEED
from ovibjax.sweep.staged import STEPS

_SHORTEST = 9
"""The first rung is about this part of the whole training, where nobody says how many rungs there are."""


def cuts_of(steps: int, every: int, factor: int, rungs: int | None = None) -> tuple[int, ...]:
    """How long members have been trained at the end of each rung.

    Args:
        steps: of the whole training.
        every: cuts fall on multiples of so many steps.
        factor: each rung ends at this multiple of the one before, rounded up.
        rungs: how many; by default so many that the first is about a ninth of the training, where it has enough steps.

    Returns:
        Numbers of steps, ascending, the last one `steps`.

    Raises:
        InputError: a factor below two, or more rungs than there are places to cut at.

    Example:
        >>> cuts_of(10_000, 27, 3)
        (1134, 3348, 10000)
        >>> cuts_of(4, 1, 3)
        (1, 2, 4)
    """
    if factor < 2 or (rungs is not None and rungs < 1):
        raise InputError(
            f"halving by {factor} in {rungs or 'some'} rungs: the factor is 2 or more, the rungs 1 or more"
        )
    units = -(-steps // every)
    for count in [rungs] if rungs is not None else range(1 + max(1, round(math.log(_SHORTEST, factor))), 0, -1):
        cuts = [-(-units // factor ** (count - 1 - rung)) for rung in range(count)]
        if len(set(cuts)) == count:
            return (*(every * cut for cut in cuts[:-1]), steps)
    raise InputError(
        f"{rungs} rungs by {factor}: a training of {units} pieces cannot be cut so often; ask for fewer rungs"
    )


@dataclass(frozen=True)
class Points:
    """Points of a grid, as members that are trained for different numbers of steps.

    Attributes:
        grid: what was asked for.
        together: its axes that differ between points: those with several values, but for the seed.
        at: per axis of these the index [n] of each point's value.
    """

    grid: Grid
    together: tuple[str, ...]
    at: dict[str, np.ndarray]

    def __len__(self) -> int:
        return len(self.at[self.together[0]])

    @property
    def seeds(self) -> int:
        """Members of a point."""
        return self.grid.size // len(self)

    def trained(self, points: np.ndarray, steps: Sequence[int] | np.ndarray) -> Grid:
        """Some points with the steps that they are trained for.

        Args:
            points: [m] which.
            steps: [m] for how long.

        Returns:
            A grid on which all axes that differ between points advance together, with `STEPS` as one more.
        """
        axes: dict[str, Axis] = {}
        for name, axis in self.grid.axes.items():
            if name in self.together:
                at = self.at[name][points]
                numbers = self.grid.codes(name)[at].tolist() if self.grid.has_names(name) else None
                axis = Axis(tuple(axis.values[i] for i in at.tolist()), axis.unit, numbers)
            axes[name] = axis
        axes[STEPS] = Axis(tuple(int(step) for step in steps))
        groups: dict[tuple[str, ...], None] = {}
        for group in self.grid.groups:
            groups[(*self.together, STEPS) if group[0] in self.together else group] = None
        return Grid(axes, tuple(groups))


def points_of(grid: Grid) -> Points:
    """The points of a grid.

    Args:
        grid: what is asked for.

    Returns:
        All its points, in its order, whatever seeds it has.

    Raises:
        InputError: an axis that is called `STEPS`, a seed that advances with another axis, or fewer than two points.
    """
    if STEPS in grid.axes:
        raise InputError(f"axis {STEPS}: halving has one of this name, for how long a member was trained; rename yours")
    groups = [group for group in grid.groups if group != (SEED,)]
    if any(SEED in group for group in groups):
        raise InputError("axis seed advances with another one; seeds of a point live and die together, so let it cross")
    sizes = [len(grid.axes[group[0]].values) for group in groups]
    index = np.unravel_index(np.arange(math.prod(sizes)), sizes) if groups else ()
    at = {name: part for group, part, size in zip(groups, index, sizes, strict=True) if size > 1 for name in group}
    if not at:
        raise InputError("halving chooses between points, and there is only one; give an axis several values")
    return Points(grid, tuple(at), at)


def best_points(dataset: xarray.Dataset, score: str, dim: str, keep: int) -> np.ndarray:
    """The points with the lowest mean score over their members.

    Args:
        dataset: all members of a rung.
        score: the output; means are taken over its own dimensions too.
        dim: the dimension of the points.
        keep: how many.

    Returns:
        Their positions, ascending; the first of equals. A point of which a member diverged is not among them, so that
        there may be fewer.
    """

    def by_point(name: str) -> np.ndarray:
        return dataset[name].transpose(dim, ...).values.reshape(dataset.sizes[dim], -1)

    values = by_point(score).astype(np.float64)
    lost = np.asarray(by_point("diverged").any(axis=1) | ~np.isfinite(values).all(axis=1))
    mean = np.where(lost, np.inf, np.where(lost[:, None], 0.0, values).mean(axis=1))
    return np.sort(np.argsort(mean, kind="stable")[: min(keep, int((~lost).sum()))])

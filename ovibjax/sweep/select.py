"""Pick members out of batched results: of a parameter tree with leading member axes, or of a dataset."""

from collections.abc import Sequence
from typing import Any, TypeVar

import jax
import numpy as np
import xarray

from ovibjax.errors import InputError

Tree = TypeVar("Tree")


def take(tree: Tree, index: int | tuple[int, ...]) -> Tree:
    """One member of a batched tree.

    Args:
        tree: a pytree whose leaves have leading member axes.
        index: its position on these axes.

    Returns:
        The tree without them.
    """
    return jax.tree.map(lambda leaf: leaf[index], tree)


def best(tree: Tree, metric: Any, minimise: bool = True) -> tuple[tuple[int, ...], Tree]:
    """The member with the lowest (or highest) metric; members whose metric is not finite are passed over.

    Args:
        tree: a pytree whose leaves have the leading axes of `metric`.
        metric: array, one number per member.
        minimise: whether lower is better.

    Returns:
        Its position, and its tree.

    Raises:
        InputError: no member has a finite metric.

    Example:
        >>> best({"w": np.array([[1, 2], [3, 4], [5, 6]])}, metric=[0.5, 0.1, np.nan])
        ((1,), {'w': array([3, 4])})
    """
    values = np.asarray(metric, np.float64)
    if not np.isfinite(values).any():
        raise InputError("no member has a finite metric: all diverged, or none is finished")
    ranked = np.where(np.isfinite(values), values if minimise else -values, np.inf)
    index = tuple(int(i) for i in np.unravel_index(np.argmin(ranked), values.shape))
    return index, take(tree, index)


def tree_of(dataset: xarray.Dataset, name: str, where: dict[str, Any] | None = None) -> Any:
    """A nested output, such as the parameters, of some members.

    Args:
        dataset: results of a sweep.
        name: what the member function called it.
        where: coordinate values to select.

    Returns:
        Nested dictionaries of arrays, with the grid axes that were not selected in front.

    Raises:
        InputError: there is no such output.
    """
    part = dataset.sel(where or {})
    tree: dict[str, Any] = {}
    for variable in part.data_vars:
        path = str(variable).split(".")
        if path[0] == name:
            _insert(tree, path[1:], np.asarray(part[variable]))
    if not tree:
        raise InputError(f"the sweep has no output {name!r}; it has {', '.join(map(str, part.data_vars))}")
    return tree


def _insert(tree: dict[str, Any], path: Sequence[str], leaf: np.ndarray) -> None:
    for step in path[:-1]:
        tree = tree.setdefault(step, {})
    tree[path[-1]] = leaf

"""Which axis of a grid moves a metric: variance shares of a full factorial design."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import xarray

from ovibjax.errors import InputError


def variance_shares(metric: xarray.DataArray, axes: Sequence[str] | None = None, order: int = 2) -> dict[str, float]:
    """Shares of the variance of a metric over its grid by axis and by interaction of axes.

    Effects are those of the analysis of variance of a balanced design: the effect of a set of axes is the mean over
    all others, less the effects of its subsets; effects are orthogonal, so their mean squares add up to the variance.

    Args:
        metric: values on a full grid, one dimension per axis.
        axes: dimensions to tell apart; all by default.
        order: largest number of axes in one named interaction; what lies beyond is `rest`.

    Returns:
        Share by name, `beta` or `beta x k`, in the order of size of the set, and `rest`; all zero for a constant.

    Raises:
        InputError: values that are not finite, or an axis that the metric does not have.

    Example:
        >>> metric = xarray.DataArray([[0.0, 1.0], [2.0, 3.0]], dims=["beta", "k"])
        >>> variance_shares(metric)
        {'beta': 0.8, 'k': 0.2, 'beta x k': 0.0, 'rest': 0.0}
    """
    names = [str(dim) for dim in metric.dims] if axes is None else list(axes)
    for name in names:
        if name not in metric.dims:
            raise InputError(f"{metric.name} has no axis {name!r}; it has {', '.join(map(str, metric.dims))}")
    values = metric.transpose(*names, ...).values.astype(np.float64)
    if not np.isfinite(values).all():
        raise InputError(f"{metric.name} is not finite on the whole grid; variance shares need a complete one")
    total = float(values.var())
    effects: dict[tuple[int, ...], np.ndarray] = {(): np.asarray(values.mean())}
    shares: dict[str, float] = {}
    for size in range(1, min(order, len(names)) + 1):
        for subset in combinations(range(len(names)), size):
            others = tuple(i for i in range(values.ndim) if i not in subset)
            effect = values.mean(axis=others, keepdims=True)
            for smaller, known in effects.items():
                if set(smaller) < set(subset):
                    effect = effect - known
            effects[subset] = effect
            label = " x ".join(names[i] for i in subset)
            shares[label] = float(np.mean(effect**2)) / total if total > 0 else 0.0
    return shares | {"rest": max(0.0, 1.0 - sum(shares.values())) if total > 0 else 0.0}

"""The order of a table's rows: by the mean of a metric or along an axis; rows without a mean come last."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from ovibjax.errors import InputError
from ovibjax.report.labels import axes_of, find, labels_of, metrics
from ovibjax.report.means import average, laid_out


@dataclass(frozen=True)
class Ranking:
    """How rows are ordered and how many are kept.

    Attributes:
        by: a metric or an axis; None for the order of the grid.
        descending: whether the highest comes first.
        top: rows to keep at most; None for all.
    """

    by: str | None = None
    descending: bool = False
    top: int | None = None

    def named(self, dataset: xr.Dataset, shown: Sequence[str]) -> "Ranking":
        """The same ranking with its metric or axis checked, or chosen where only one metric is shown.

        Args:
            dataset: results.
            shown: metrics of the table.

        Returns:
            The ranking.

        Raises:
            InputError: an unknown name, or several metrics to choose from.
        """
        known = metrics(dataset)
        if self.by is not None:
            find(self.by, [*known, *axes_of(dataset)], "metric or axis")
        elif (self.top is not None or self.descending) and len(shown) == 1:
            return Ranking(shown[0], self.descending, self.top)
        elif self.top is not None or self.descending:
            option = "--descending" if self.top is None else f"--top {self.top}"
            raise InputError(f"{option}: say by what with --sort NAME, a metric ({', '.join(known)}) or an axis")
        return self

    def order(self, data: xr.Dataset, rows: Sequence[str], along: Sequence[str]) -> tuple[np.ndarray, str]:
        """Positions of the rows that are kept, in order.

        Args:
            data: results, prepared, with the metric.
            rows: dimensions of the rows, the first slowest.
            along: dimensions that are averaged over.

        Returns:
            Flat positions, and how they are ordered, in words; no words for the order of the grid.

        Raises:
            InputError: an axis that is no column of the rows.
        """
        if self.by is None:
            return np.arange(int(np.prod([data.sizes[dim] for dim in rows]))), ""
        key, said = self._key(data, rows, along, self.by)
        order = np.argsort(-key if self.descending else key, kind="stable")  # NaN comes last
        if self.top is not None:
            order = order[np.isfinite(key[order])][: self.top]
        return order, f"sorted by {said}, {'highest' if self.descending else 'lowest'} first"

    def _key(self, data: xr.Dataset, rows: Sequence[str], along: Sequence[str], by: str) -> tuple[np.ndarray, str]:
        """[rows] numbers to sort by, and what they are."""
        if by in data.data_vars:
            values: Any = data[by]
            trailing = [str(dim) for dim in values.dims if dim not in (*rows, *along)]
            last = values.isel({dim: [-1] for dim in trailing})
            place = " ".join(labels_of(last, trailing)[0])
            return laid_out(data, average(data, last, along)[0], rows).values.ravel(), f"{by} {place}".strip()
        dim = axes_of(data).get(by)
        if dim in along:
            raise InputError(f"--sort {by}: the mean is taken over it; choose another axis or a metric")
        if dim is None or dim not in rows:
            raise InputError(f"--sort {by}: the rows do not differ in it; choose another axis or a metric")
        # Numbers by size, names by the alphabet.
        ranks = np.unique(data[by].values, return_inverse=True)[1].astype(np.float64)
        return laid_out(data, xr.DataArray(ranks, dims=[dim]), rows).values.ravel(), by

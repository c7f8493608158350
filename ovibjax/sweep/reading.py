"""Results of a sweep on disk under the name that one looks for: `ovibjax.sweep.open`."""

from pathlib import Path

import xarray

from ovibjax.sweep.store import open_dataset


def open(path: str | Path) -> xarray.Dataset:
    """Read the results of a sweep from its store; the sweep may still be running.

    Args:
        path: the store, a folder that `run` or `ovibjax sweep` wrote.

    Returns:
        One dimension per axis (or zipped group) with coordinates and units, every output of the member function over
        them, and the booleans `finished` and `diverged`; members not finished are NaN, 0 or False. What the sweep was
        started with is the attribute `config`.

    Raises:
        InputError: there is no store, or a damaged one.

    Example:
        >>> from tempfile import TemporaryDirectory
        >>> from ovibjax import sweep
        >>> with TemporaryDirectory() as folder:
        ...     store, grid = f"{folder}/mine.zarr", {"a": [1.0, 2.0], "seed": [0, 1]}
        ...     made = sweep.run(lambda key, point, shared: {"y": point["a"] ** 2}, grid, store=store)
        ...     dataset = sweep.open(store)
        >>> dataset.y.where(dataset.finished & ~dataset.diverged).mean("seed").sel(a=2.0).item()
        4.0
    """
    return open_dataset(path)

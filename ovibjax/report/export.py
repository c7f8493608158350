"""A sweep's results as a file for other programs: every finished member a row, as CSV or Parquet."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import xarray as xr

from ovibjax.errors import InputError, doubt
from ovibjax.report.labels import axes_of, find, grid_dims, metrics


def exported(dataset: xr.Dataset, metric: str | None, path: Path) -> xr.Dataset:
    """What goes into a file; what cannot is named.

    Args:
        dataset: results.
        metric: the one that is wanted; all by default.
        path: the file, for messages.

    Returns:
        The metric or all of them, with `finished` and `diverged`.

    Raises:
        InputError: no such metric, or none at all that a row could hold.
    """
    held = metrics(dataset)
    bare = [str(name) for name in dataset.data_vars if name not in (*held, "finished", "diverged")]
    named = metric if metric in bare else ", ".join(bare[:3]) + (f" and {len(bare) - 3} more" if len(bare) > 3 else "")
    why = f"no rows for {named}: not numbers along dimensions with values (coords); ovibjax.sweep.open has all"
    if metric in bare or not held:
        raise InputError(f"{path}: {why}")
    chosen = held if metric is None else [find(metric, held, "metric")]
    if metric is None and bare:
        doubt(path, why)
    return dataset[[*chosen, "finished", "diverged"]]


def write_csv(dataset: xr.Dataset, path: Path) -> None:
    """Write one row per finished member and point of the trailing dimensions.

    Columns are the axes, the trailing coordinates, the metrics and `diverged`. A metric is repeated along trailing
    dimensions that it lacks; metrics whose trailing dimensions differ (prefix, epoch) have rows of their own, empty
    elsewhere.

    Args:
        dataset: results.
        path: CSV file to write.

    Raises:
        InputError: the file cannot be written.
    """
    columns = _columns(dataset)
    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            for i, frame in enumerate(_frames(dataset)):
                frame.reindex(columns=columns).to_csv(file, index=False, header=i == 0)
    except OSError as error:
        raise InputError(f"{path}: cannot write there ({error.strerror}); choose another file") from error


def write_parquet(dataset: xr.Dataset, path: Path) -> None:
    """Write the rows of `write_csv` as a Parquet file, types kept; what a row lacks is null.

    Args:
        dataset: results.
        path: Parquet file to write.

    Raises:
        InputError: pyarrow is not installed, or the file cannot be written.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise InputError(
            f"{path}: Parquet files need pyarrow; pip install 'ovibjax[parquet]', or write a CSV file"
        ) from None
    tables = [pyarrow.Table.from_pandas(frame, preserve_index=False) for frame in _frames(dataset)]
    merged = pyarrow.concat_tables(tables, promote_options="default")
    try:
        pyarrow.parquet.write_table(merged.select(_columns(dataset)), path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"{path}: cannot write there ({reason}); choose another file") from error


def _blocks(dataset: xr.Dataset) -> list[list[str]]:
    """Sets of trailing dimensions that have rows of their own; those contained in another are not among them."""
    grid = grid_dims(dataset)
    trailing = [[str(dim) for dim in dataset[name].dims if dim not in grid] for name in metrics(dataset)]
    spans = {frozenset(dims): dims for dims in trailing} or {frozenset(): []}
    return [dims for span, dims in spans.items() if not any(span < other for other in spans)]


def _columns(dataset: xr.Dataset) -> list[str]:
    used = [*grid_dims(dataset), *dict.fromkeys(dim for dims in _blocks(dataset) for dim in dims)]
    return [*axes_of(dataset, used), *metrics(dataset), "diverged"]


def _frames(dataset: xr.Dataset) -> Iterator[Any]:
    """Data frames of the finished members, one per block of trailing dimensions."""
    grid = grid_dims(dataset)
    for dims in _blocks(dataset):
        inside = [name for name in metrics(dataset) if set(dataset[name].dims) <= {*grid, *dims}]
        frame = dataset[[*inside, "finished", "diverged"]].to_dataframe([*grid, *dims]).reset_index()
        kept = [name for name in _columns(dataset) if name in frame.columns]
        yield frame.loc[frame["finished"], kept]

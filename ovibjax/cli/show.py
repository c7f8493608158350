"""The command `ovibjax show`: the results of a sweep as a table, a file or a plot, also while it is running."""

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from ovibjax.cli.options import require_positive
from ovibjax.errors import InputError
from ovibjax.runtime.plain_numbers import plain_float
from ovibjax.runtime.progress import console, width_of

if TYPE_CHECKING:
    import xarray as xr
    from rich.table import Table

_EVERY_S = 2.0


@dataclass(frozen=True)
class Show:
    """Show the results of a sweep: a table here, a file for other programs, or a plot; also while it is running.

    A row of the table is a point of the grid, with the mean over its seeds and a 95 % interval; members that diverged
    or are unfinished count in no mean, and a note says how many are missing. Examples:

    ovibjax show runs/mine.zarr --metric test_mean_m --where prefix=8,35 'beta>=1e-3' --top 5

    ovibjax show runs/mine.zarr --metric test_mean_m --where prefix=35 --plot gamma --hue beta

    ovibjax show runs/mine.zarr --watch
    """

    path: tyro.conf.Positional[Path]
    """The store, a folder that `ovibjax sweep` wrote."""
    metric: str | None = None
    """What to show; all metrics by default."""
    where: tuple[str, ...] = ()
    """Conditions that must all hold: prefix=16,35 beta!=1e-3 'gamma>=0.1' 'gamma<1' (< and > in quotes)."""
    over: tuple[str, ...] = ("seed",)
    """The axes to average over, with 95 % intervals; none shows every member by itself."""
    sort: str | None = None
    """Order rows by this metric (its mean, at the last point of its own axes) or axis, the lowest first."""
    descending: bool = False
    """The highest first."""
    top: int | None = None
    """Show only so many rows, by --sort, else by --metric."""
    rows: int = 40
    """Rows of the table at most."""
    watch: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="[SECONDS]")] = None
    """Redraw the table every 2 or so many seconds until all is finished, or Ctrl-C; waits for a store to come."""
    csv: Path | None = None
    """Write every finished member as a row of this CSV file, with --metric or all metrics."""
    parquet: Path | None = None
    """Write the same rows as a Parquet file (extra [parquet])."""
    plot: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="AXIS [AXIS]")] = None
    """Plot the metric along this axis; over two axes, a heat map with the values in its cells, or points where the
    two were drawn together (--sobol)."""
    hue: str | None = None
    """One line of the plot per value of this axis."""
    out: Path | None = None
    """File of the plot (.png, .pdf or .svg); PATH with .png by default."""

    def run(self) -> None:
        """Run the command."""
        from rich.console import Console

        from ovibjax.report.selection import select
        from ovibjax.sweep.store import open_dataset

        self._check()
        if self.watch is not None:
            self._watch(_seconds(self.watch))
            return
        dataset = select(open_dataset(self.path), self.where)
        files = self._files(dataset)
        for path, write in files:
            _writing(path, write)
        if not files:
            Console(width=width_of(sys.stdout)).print(self._table(dataset, None))

    def _check(self) -> None:
        """Refuse options that go nowhere together."""
        require_positive(self, "rows", "top")
        files = [f"--{name}" for name in ("csv", "parquet", "plot") if getattr(self, name) is not None]
        ordered = [name for name, given in (("--sort", self.sort), ("--top", self.top)) if given is not None]
        ordered += ["--descending"] * self.descending
        if files and ordered:
            raise InputError(f"{ordered[0]} is for the table, and {files[0]} shows every member; leave one out")
        if files and self.watch is not None:
            raise InputError(f"--watch draws the table, and {files[0]} a file once; leave one out")
        if self.plot is not None and not 1 <= len(self.plot) <= 2:
            raise InputError(f"--plot {' '.join(self.plot)}: give one axis for lines, or two for a heat map")
        for name in ("hue", "out"):
            if getattr(self, name) is not None and self.plot is None:
                raise InputError(f"--{name} {getattr(self, name)}: it is for --plot; give that too")

    def _table(self, dataset: "xr.Dataset", most: int | None) -> "Table":
        from ovibjax.report.ranking import Ranking
        from ovibjax.report.show import table

        rows = self.rows if most is None else min(self.rows, most)
        return table(dataset, self.metric, self.over, rows, Ranking(self.sort, self.descending, self.top))

    def _watch(self, every_s: float) -> None:
        from ovibjax.report.live import watch
        from ovibjax.report.selection import select
        from ovibjax.sweep.store import open_dataset

        def read() -> "xr.Dataset | None":
            if not self.path.exists():
                return None
            try:
                dataset = open_dataset(self.path)
            except InputError:
                time.sleep(0.5)  # a writer may have been between two files
                dataset = open_dataset(self.path)
            return select(dataset, self.where) if dataset.finished.size else None

        watch(read, self._table, str(self.path), every_s)

    def _files(self, dataset: "xr.Dataset") -> list[tuple[Path, Callable[[Path], Any]]]:
        """What to write, and how."""
        from ovibjax.report.export import exported, write_csv, write_parquet

        files: list[tuple[Path, Callable[[Path], Any]]] = []
        for path, write in ((self.csv, write_csv), (self.parquet, write_parquet)):
            if path is not None:
                files.append((path, partial(write, exported(dataset, self.metric, path))))
        if self.plot is not None:
            from ovibjax.report.plotting import plot

            x, y = self.plot[0], self.plot[1] if len(self.plot) > 1 else None
            draw = partial(plot, dataset, x=x, metric=self.metric, hue=self.hue, over=self.over, y=y)
            files.append((self.out or self.path.with_suffix(".png"), draw))
        return files


def _seconds(given: tuple[str, ...]) -> float:
    """Seconds between two looks."""
    try:
        every_s = [plain_float(text) for text in given] or [_EVERY_S]
    except ValueError:
        every_s = []
    if len(every_s) != 1 or not (isfinite(every_s[0]) and every_s[0] > 0):
        raise InputError(f"--watch {' '.join(given)}: give one positive number of seconds, or none for {_EVERY_S:g}")
    return every_s[0]


def _writing(path: Path, write: Callable[[Path], Any]) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(path)
    except OSError as error:
        raise InputError(f"{path}: cannot write there ({error.strerror}); choose another file") from error
    console.print(f"written: {path}")

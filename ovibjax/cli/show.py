"""The command `ovibjax show`: the results of a sweep as a table, a CSV file or a plot."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from ovibjax.errors import InputError
from ovibjax.runtime.progress import console


@dataclass(frozen=True)
class Show:
    """Show the results of a sweep: a table here, a CSV file, or a plot; also while the sweep is running.

    Example: ovibjax show runs/mine.zarr --metric test_mean_m --where prefix=35 --plot gamma --hue beta
    """

    path: tyro.conf.Positional[Path]
    """The store, a folder that `ovibjax sweep` wrote."""
    metric: str | None = None
    """What to show; all metrics by default."""
    where: tuple[str, ...] = ()
    """Points to keep, e.g. prefix=16,35 beta=1e-3."""
    over: str = "seed"
    """The axis to average over, with 95 % intervals."""
    rows: int = 40
    """Rows of the table at most."""
    csv: Path | None = None
    """Write every member as a row of this CSV file."""
    plot: str | None = None
    """Plot the metric against this axis."""
    hue: str | None = None
    """One line per value of this axis."""
    out: Path | None = None
    """File of the plot (.png, .pdf or .svg); PATH with .png by default."""

    def run(self) -> None:
        """Run the command."""
        from rich.console import Console

        from ovibjax.report.labels import select
        from ovibjax.report.lines import plot
        from ovibjax.report.show import table, write_csv
        from ovibjax.sweep.store import open_dataset

        dataset = select(open_dataset(self.path), self.where)
        if self.csv is not None:
            _writing(self.csv, lambda path: write_csv(dataset, path))
        if self.plot is not None:
            _writing(
                self.out or self.path.with_suffix(".png"),
                lambda path: plot(dataset, path, self.plot or "", self.metric, self.hue, self.over),
            )
        if self.csv is None and self.plot is None:
            Console().print(table(dataset, self.metric, self.over, self.rows))


def _writing(path: Path, write: Callable[[Path], Any]) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(path)
    except OSError as error:
        raise InputError(f"{path}: cannot write there ({error.strerror}); choose another file") from error
    console.print(f"written: {path}")

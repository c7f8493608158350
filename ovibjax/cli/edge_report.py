"""The command `ovibjax edge report`: tables and a figure of what edges and robots wrote down."""

import csv
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from ovibjax.errors import InputError
from ovibjax.runtime.progress import console, width_of

if TYPE_CHECKING:
    from rich.table import Table


@dataclass(frozen=True)
class EdgeReport:
    """Turn logs of `ovibjax edge serve` and `drive` into a table per side, and on request a figure.

    Beside the measured latencies of an edge stand those of the replay of the same requests (`modelled`), given their
    times of service. Given logs of both sides, it also says whether they agree on every question.

    Example: ovibjax edge report edge.jsonl robots.jsonl --plot
    """

    logs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Logs, of either side."""
    plot: bool = False
    """Draw latencies, stages and route errors."""
    out: Path = Path("edge.png")
    """File of the figure."""
    csv: Path | None = None
    """File for the rows of the tables, every column in full."""

    def run(self) -> None:
        """Run the command."""
        from ovibjax.live.log_report import agreement, edge_rows, read_runs, robot_rows, sides
        from ovibjax.live.modelled import side_by_side

        if not self.logs:
            raise InputError("give one or more logs: ovibjax edge report edge.jsonl")
        edges, robots = sides(read_runs(self.logs))
        of_edges, of_robots = edge_rows(edges), robot_rows(robots)
        for row, run in zip(of_edges, edges, strict=True):
            row |= side_by_side(run)
        for rows in (of_edges, of_robots):
            if rows:
                _console().print(_table(rows))
        if agreed := agreement(edges, robots):
            print(
                "both sides: {questions} questions, {answered} answered as the edge says, {unknown} otherwise, "
                "{unanswered} without an answer; {unasked} requests that no robot asked".format(**agreed)
            )
        if self.csv is not None:
            self._write([{"side": "edge", **row} for row in of_edges] + [{"side": "robots", **r} for r in of_robots])
        if self.plot:
            from ovibjax.live.log_drawing import draw_log

            try:
                draw_log(self.out, edges, robots)
            except OSError as error:
                raise InputError(f"{self.out}: cannot write there ({error.strerror}); choose another --out") from error
            console.print(f"figure: {self.out}")

    def _write(self, rows: list[dict[str, Any]]) -> None:
        assert self.csv is not None
        names = list(dict.fromkeys(name for row in rows for name in row))
        try:
            with self.csv.open("w", newline="") as file:
                writer = csv.DictWriter(file, names)
                writer.writeheader()
                writer.writerows(rows)
        except OSError as error:
            raise InputError(f"{self.csv}: cannot write there ({error.strerror}); choose another --csv") from error
        console.print(f"rows: {self.csv}")


def _console() -> Any:
    from rich.console import Console

    return Console(width=width_of(sys.stdout))


def _table(rows: Sequence[dict[str, Any]]) -> "Table":
    """Columns that say something; stages are for the figure and the CSV."""
    from rich.table import Table

    from ovibjax.live.log_report import STAGES

    table = Table()
    hidden = {f"{stage}_ms" for stage in STAGES} | {"killed"}
    names = [name for name in rows[0] if name not in hidden]
    for name in names:
        table.add_column(_heading(name), justify="left" if name in ("rule", "policy") else "right")
    for row in rows:
        first = f"{row[names[0]]} (killed)" if row["killed"] else str(row[names[0]])
        table.add_row(first, *(_cell(row[name]) for name in names[1:]))
    return table


def _heading(name: str) -> str:
    base, _, unit = name.rpartition("_")
    if name == "per_s":
        return "per s"
    return f"{base.replace('_', ' ')} ({unit})" if unit in ("ms", "m") else name


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return "" if value != value else f"{value:.3g}" if value < 1000 else f"{value:.0f}"
    return str(value)

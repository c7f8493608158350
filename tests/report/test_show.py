"""A sweep as a table."""

import io

import numpy as np
import pytest
import xarray as xr
from rich.console import Console
from rich.table import Table

from ovibjax.errors import InputError
from ovibjax.report.claims import interval
from ovibjax.report.selection import select
from ovibjax.report.show import MAX_METRICS, table
from tests.report.cases import made_results, zipped


@pytest.fixture
def results() -> xr.Dataset:
    return made_results()


def text(made: Table) -> list[list[str]]:
    """The cells' text, row by row."""
    return [list(row) for row in zip(*([str(cell) for cell in column.cells] for column in made.columns), strict=True)]


def bold(made: Table) -> list[tuple[int, int]]:
    cells = [list(column.cells) for column in made.columns]
    return [(r, c) for c, column in enumerate(cells) for r, cell in enumerate(column) if getattr(cell, "style", "")]


def heads(made: Table) -> list[str]:
    return [str(column.header) for column in made.columns]


def test_table_holds_means_and_intervals_of_the_members_that_count(results) -> None:
    made = table(results, "latency")
    assert heads(made) == ["beta (1/bit)", "gamma", "latency (ms)", "note"]
    rows = text(made)
    assert len(rows) == 12 and rows[1][:2] == ["0.001", "0.01"]
    assert rows[1][2] == interval(results["latency"].values[0, 1]).text(digits=1)
    assert rows[8] == ["0.1", "0", interval(results["latency"].values[2, 0, 2:]).text(digits=1), rows[8][3]]
    assert rows[8][3] == "3 of 5 seeds: 1 diverged, 1 unfinished"
    assert rows[11][2:] == ["-", "0 of 5 seeds: 5 diverged"]
    assert {row[3] for row in rows[:8]} == {""}


def test_lowest_is_bold_and_diverged_members_never_win(results) -> None:
    made = table(results, "mean_m")
    assert heads(made)[2:4] == ["mean_m (m)\nprefix 5", "mean_m (m)\nprefix 35"]
    # Gamma 0.1 at beta 0.01 is row 6; diverged members hold 1e-9.
    assert (6, 3) in bold(made) and len(bold(made)) == 2
    assert text(made)[6][3].startswith("0.52 ± ")
    assert "lowest in bold" in str(made.caption) and "5 values of seed" in str(made.caption)


def test_table_of_all_metrics_is_printable(results) -> None:
    made = table(select(results, ["gamma=0"]))
    assert heads(made)[1:] == ["mean_m (m)\nprefix 35", "latency (ms)", "loss\nepoch 6", "note"]
    console = Console(file=io.StringIO(), width=100)
    console.print(made)
    printed = console.file.getvalue()
    assert "gamma = 0" in printed and "(not shown: params.* (2))" in " ".join(printed.split())
    assert "--metric loss" in printed


def test_many_trailing_points_become_rows_and_the_best_is_always_shown(results) -> None:
    results["loss"][1, 3, :, 4] = 0.01
    made = table(results, "loss", max_rows=5)
    rows = text(made)
    assert heads(made)[:3] == ["beta (1/bit)", "gamma", "epoch"] and len(rows) == 5
    assert rows[-1][:3] == ["0.01", "1", "5"] and bold(made) == [(4, 3)]
    assert "5 of 72 rows" in str(made.caption)
    last = text(table(results, "loss", max_rows=100))
    assert len(last) == 72 and last[48][4] == last[53][4] == "3 of 5 seeds: 1 diverged, 1 unfinished"
    assert not last[47][4]


def test_without_seeds_there_is_no_interval(results) -> None:
    made = table(results.isel(seed=1), "latency")
    rows = text(made)
    assert not any("±" in row[2] for row in rows) and "95 %" not in str(made.caption)
    assert float(rows[0][2]) == pytest.approx(float(results["latency"][0, 0, 1]), rel=1e-3)
    assert rows[8][2:] == ["-", "diverged"]
    assert text(table(results.isel(seed=0, drop=True), "latency"))[8][3] == "unfinished"


def test_small_and_wide_columns_keep_their_digits(results) -> None:
    one = results.isel(beta=0, seed=0)
    one["latency"][:] = [1e-9, 2e-9, 3e-9, 4.5e-9]
    assert [row[-1] for row in text(table(one, "latency"))] == ["1e-09", "2e-09", "3e-09", "4.5e-09"]
    one["latency"][:] = [1e-5, 0.1, 20.0, 4000.0]
    assert [row[-1] for row in text(table(one, "latency"))] == ["1e-05", "0.1", "20", "4000"]
    one["latency"][:] = [1.0, 20.0, 300.0, np.nan]
    assert [row[-1] for row in text(table(one, "latency"))] == ["1", "20", "300", "-"]


def test_other_axes_can_be_averaged_over(results) -> None:
    made = table(select(results, ["seed=2"]), "latency", over="gamma")
    assert heads(made)[:2] == ["beta (1/bit)", "latency (ms)"]
    assert text(made)[0][1] == interval(results["latency"].values[0, :, 2]).text(digits=1)
    assert "seed = 2" in str(made.title)
    made = table(results, "latency", over=("seed", "gamma"))
    assert heads(made) == ["beta (1/bit)", "latency (ms)", "note"]
    assert text(made)[0][1] == interval(results["latency"].values[0].mean(axis=0)).text(digits=1)
    assert text(made)[2][2] == "13 of 20 members: 6 diverged, 1 unfinished"
    assert "5 values of seed, each a mean over gamma" in str(made.caption)


def test_what_cannot_be_shown(results) -> None:
    with pytest.raises(InputError, match="no metric 'los'; did you mean loss"):
        table(results, "los")
    with pytest.raises(InputError, match="nothing to show"):
        table(results[["params.a.bias", "finished", "diverged"]])
    with pytest.raises(InputError, match="no swept axis 'prefix'"):
        table(results, "mean_m", over="prefix")


def test_zipped_axes_have_a_column_each(results) -> None:
    data = zipped(results)
    assert heads(table(data, "latency"))[:2] == ["beta (1/bit)", "gamma"]
    assert text(table(data, "latency"))[1][:2] == ["0.01", "0.1"]


def test_many_metrics_are_named_instead_of_squeezed_in():
    dims = ("beta", "seed")
    data = {f"m{i}": (dims, np.arange(4.0).reshape(2, 2) + i) for i in range(12)}
    data["wide"] = ((*dims, "k"), np.zeros((2, 2, 3)))
    flags = {name: (dims, np.full((2, 2), name == "finished")) for name in ("finished", "diverged")}
    made = xr.Dataset(data | flags, coords={"beta": [0.1, 0.2], "seed": [0, 1], "k": [1, 2, 3]})
    shown = table(made)
    heads = [str(column.header) for column in shown.columns]
    assert sum(head.startswith("m") for head in heads) == MAX_METRICS
    assert "also: m9, m10, m11, wide" in str(shown.caption)

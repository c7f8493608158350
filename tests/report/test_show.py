import csv
import io
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from rich.console import Console
from rich.table import Table

from ovibjax.errors import InputError
from ovibjax.report.claims import interval
from ovibjax.report.labels import metrics, select
from ovibjax.report.lines import line_figure, plot
from ovibjax.report.show import MAX_METRICS, table, write_csv

GRID = ("beta", "gamma", "seed")
BETA, GAMMA, PREFIX = np.float32([1e-3, 1e-2, 1e-1]), np.float32([0.0, 0.01, 0.1, 1.0]), [5, 35]


@pytest.fixture
def results() -> xr.Dataset:
    """At (0.1, 0) one member is unfinished and one diverged; at (0.1, 1) all diverged."""
    rng = np.random.default_rng(0)
    shape = (3, 4, 5)
    finished, diverged = np.ones(shape, bool), np.zeros(shape, bool)
    finished[2, 0, 0], diverged[2, 0, 1], diverged[2, 3] = False, True, True
    mean_m = rng.uniform(1.0, 2.0, (*shape, 2))
    mean_m[1, 2, :, 1] = 0.5 + 0.01 * np.arange(5)
    mean_m[diverged] = 1e-9
    latency, loss = rng.uniform(20.0, 30.0, shape), rng.uniform(0.1, 1.0, (*shape, 6)).astype(np.float32)
    for values in (mean_m, latency, loss):
        values[~finished] = np.nan
    return xr.Dataset(
        {
            "mean_m": ((*GRID, "prefix"), mean_m, {"units": "m"}),
            "latency": (GRID, latency, {"units": "ms"}),
            "loss": ((*GRID, "epoch"), loss),
            "params.a.kernel": ((*GRID, "d0", "d1"), np.zeros((*shape, 2, 2))),
            "params.a.bias": ((*GRID, "d0"), np.zeros((*shape, 2))),
            "bits": ("prefix", np.array([160, 1120])),
            "finished": (GRID, finished),
            "diverged": (GRID, diverged),
        },
        coords={
            "beta": ("beta", BETA, {"units": "1/bit"}),
            "gamma": GAMMA,
            "seed": range(5),
            "prefix": PREFIX,
            "epoch": np.arange(1, 7),
        },
    )


def zipped(results: xr.Dataset) -> xr.Dataset:
    """Gamma chosen per beta, along one dimension."""
    data = results.isel(gamma=0, drop=True).rename_dims(beta="beta_gamma").reset_index("beta")
    return data.assign_coords(gamma=("beta_gamma", GAMMA[1:]))


def text(made: Table) -> list[list[str]]:
    """The cells' text, row by row."""
    return [list(row) for row in zip(*([str(cell) for cell in column.cells] for column in made.columns), strict=True)]


def bold(made: Table) -> list[tuple[int, int]]:
    cells = [list(column.cells) for column in made.columns]
    return [(r, c) for c, column in enumerate(cells) for r, cell in enumerate(column) if getattr(cell, "style", "")]


def heads(made: Table) -> list[str]:
    return [str(column.header) for column in made.columns]


def test_metrics_are_labelled_numbers_over_the_grid(results) -> None:
    assert metrics(results) == ["mean_m", "latency", "loss"]
    with pytest.raises(InputError, match=r"not a sweep's results.*'finished'"):
        metrics(results.drop_vars("finished"))


def test_table_holds_means_and_intervals_of_the_members_that_count(results) -> None:
    made = table(results, "latency")
    assert heads(made) == ["beta (1/bit)", "gamma", "latency (ms)", "note"]
    rows = text(made)
    assert len(rows) == 12 and rows[1][:2] == ["0.001", "0.01"]
    assert rows[1][2] == interval(results["latency"].values[0, 1]).text(digits=1)
    assert rows[8] == ["0.1", "0", interval(results["latency"].values[2, 0, 2:]).text(digits=1), rows[8][3]]
    assert rows[8][3] == "diverged 1 of 5, unfinished 1 of 5"
    assert rows[11][2:] == ["-", "diverged 5 of 5"]
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
    assert len(last) == 72 and last[48][4] == last[53][4] == "diverged 1 of 5, unfinished 1 of 5" and not last[47][4]


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


def test_csv_round_trip(results, tmp_path) -> None:
    write_csv(results, tmp_path / "out.csv")
    with (tmp_path / "out.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == [*GRID, "prefix", "epoch", "mean_m", "latency", "loss", "diverged"]
    # 59 finished members; two prefixes and six epochs each, apart.
    assert len(rows) == 59 * (2 + 6) and sum(row["prefix"] != "" for row in rows) == 59 * 2
    assert sum(row["diverged"] == "True" for row in rows) == 6 * 8
    for row in rows:
        at = {axis: row[axis] for axis in GRID}
        member = select(results, [f"{axis}={value}" for axis, value in at.items()]).squeeze()
        assert float(row["latency"]) == pytest.approx(float(member["latency"]), rel=1e-12)
        trailing, metric = ("prefix", "mean_m") if row["prefix"] else ("epoch", "loss")
        point = member[metric].sel({trailing: int(row[trailing])})
        assert float(row[metric]) == pytest.approx(float(point), rel=1e-6)


def test_csv_of_scalars_and_zipped_axes(results, tmp_path) -> None:
    path = tmp_path / "out.csv"
    write_csv(zipped(results)[["latency", "finished", "diverged"]], path)
    rows = list(csv.DictReader(path.read_text().splitlines()))
    assert list(rows[0]) == ["beta", "gamma", "seed", "latency", "diverged"] and len(rows) == 14
    assert {(row["beta"], row["gamma"]) for row in rows} == {("0.001", "0.01"), ("0.01", "0.1"), ("0.1", "1.0")}
    with pytest.raises(InputError, match="cannot write there"):
        write_csv(results, tmp_path / "missing" / "out.csv")


def test_select_matches_float32_names_and_zipped_axes(results) -> None:
    small = select(results, ["beta=1e-3,0.1", "prefix=35"])
    assert dict(small.sizes)["beta"] == 2 and small["prefix"].values.tolist() == [35]
    np.testing.assert_array_equal(small["mean_m"].values[..., 0], results["mean_m"].values[[0, 2], ..., 1])
    assert select(zipped(results), ["gamma=0.1"])["beta"].values.tolist() == [BETA[1]]
    named = results.assign_coords(beta=["mono", "left, right", "ring"])
    assert select(named, ["beta=left, right"])["beta"].values.tolist() == ["left, right"]
    assert select(named, ["beta=mono,ring"])["beta"].values.tolist() == ["mono", "ring"]


@pytest.mark.parametrize(
    ("where", "message"),
    [
        ("beta", "write AXIS=VALUE.*beta, gamma, seed"),
        ("beta=", "write AXIS=VALUE"),
        ("betta=1", "no axis 'betta'; did you mean beta.*gamma"),
        ("zzz=1", "no axis 'zzz'; there is: beta"),
        ("beta=0.0011", "beta has no value '0.0011'; it has 0.001, 0.01, 0.1"),
        ("beta=0.01,2", "beta has no value '2'"),
        ("gamma=none", "gamma has no value 'none'"),
        ("gamma=nan", "gamma has no value 'nan'"),
    ],
)
def test_select_says_what_there_is(results, where: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        select(results, [where])


def test_plot_draws_a_line_per_hue_with_means_and_bands(results) -> None:
    one = select(results, ["prefix=35"])
    (ax,) = line_figure(one, "gamma", "mean_m", "beta").axes
    assert len(ax.lines) == 3 and len(ax.collections) == 3
    assert ax.get_xscale() == "symlog" and [t.get_text() for t in ax.get_xticklabels()] == ["0", "0.01", "0.1", "1"]
    assert ax.get_xlabel() == "gamma" and ax.get_ylabel() == "mean (m)"
    np.testing.assert_allclose(ax.lines[0].get_xdata(), GAMMA)
    y = np.asarray(ax.lines[2].get_ydata())
    np.testing.assert_allclose(y[0], results["mean_m"].values[2, 0, 2:, 1].mean())
    assert np.isnan(y[3])
    assert "prefix = 35" in ax.get_title("left")
    assert "6 diverged and 1 unfinished" in " ".join(ax.get_title("left").split())
    span = interval(results["mean_m"].values[0, 0, :, 1])
    edges = ax.collections[0].get_paths()[0].vertices
    np.testing.assert_allclose(sorted(set(edges[edges[:, 0] == 0, 1].round(9))), [span.low, span.high], atol=1e-8)


def test_scales_follow_the_values(results) -> None:
    (ax,) = line_figure(select(results, ["gamma=0"]), "beta", "latency").axes
    assert ax.get_xscale() == "log" and ax.get_xlabel() == "beta (1/bit)" and len(ax.lines) == 1
    assert ax.get_yscale() == "linear" and not ax.figure.legends
    (ax,) = line_figure(select(results, ["gamma=0", "beta=0.001"]), "epoch").axes
    assert ax.get_xscale() == "linear"
    even = select(results, ["gamma=0", "beta=0.001"]).assign_coords(epoch=np.arange(1, 102, 20))
    assert line_figure(even, "epoch").axes[0].get_xscale() == "linear"
    falling = results.assign(loss=results["loss"] * 10.0 ** -results["epoch"])
    assert line_figure(select(falling, ["gamma=0"]), "epoch", "loss", "beta").axes[0].get_yscale() == "log"


def test_names_are_points_and_negative_values_have_bands(results) -> None:
    named = select(results, ["prefix=5"]).assign_coords(beta=["mono", "stereo", "ring"])
    (ax,) = line_figure(named, "beta", "mean_m", "gamma").axes
    assert len(ax.containers) == 4 and [t.get_text() for t in ax.get_xticklabels()] == ["mono", "stereo", "ring"]
    (ax,) = line_figure(select(results.assign(loss=-results["loss"]), ["gamma=1"]), "epoch", "loss", "beta").axes
    assert len(ax.lines) == 3
    assert "0.1 (none)" in [entry.get_text() for entry in ax.figure.legends[0].get_texts()]


def test_zipped_axes(results) -> None:
    data = zipped(results)
    assert heads(table(data, "latency"))[:2] == ["beta (1/bit)", "gamma"]
    assert text(table(data, "latency"))[1][:2] == ["0.01", "0.1"]
    (ax,) = line_figure(data, "gamma", "latency").axes
    np.testing.assert_allclose(ax.lines[0].get_xdata(), GAMMA[1:])
    with pytest.raises(InputError, match="--hue beta: it advances together with gamma"):
        line_figure(data, "gamma", "latency", "beta")


@pytest.mark.parametrize("name", ["plot.png", "plot.PDF"])
def test_plot_is_written(results, tmp_path, name: str) -> None:
    plot(select(results, ["prefix=35"]), tmp_path / name, "beta", "mean_m", "gamma")
    assert (tmp_path / name).stat().st_size > 5000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"x": "gama"}, "no axis 'gama'; did you mean gamma"),
        ({"x": "beta"}, "choose what to draw along beta with --metric: mean_m, latency, loss"),
        ({"x": "beta", "metric": "latancy"}, "no metric 'latancy'; did you mean latency"),
        (
            {"x": "beta", "metric": "latency"},
            r"gamma has 4 values \(0, 0.01, 0.1, 1\).*--where gamma=1 or.*--hue gamma",
        ),
        ({"x": "beta", "metric": "mean_m", "hue": "gamma"}, "prefix has 2 values .*--where prefix=35$"),
        ({"x": "prefix", "metric": "loss"}, "--x prefix: loss does not depend on it"),
        ({"x": "beta", "metric": "latency", "hue": "epoch"}, "--hue epoch: latency does not depend on it"),
        ({"x": "seed", "metric": "latency"}, "--x seed: the mean is taken along it"),
        ({"x": "beta", "metric": "latency", "over": "sede"}, "no swept axis 'sede'; did you mean seed"),
        ({"x": "beta", "metric": "latency", "hue": "beta"}, "--hue beta: it advances together with beta"),
    ],
)
def test_plot_says_what_to_choose(results, arguments: dict[str, str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        line_figure(results, **arguments)


def test_what_cannot_be_shown(results, tmp_path) -> None:
    with pytest.raises(InputError, match="no metric 'los'; did you mean loss"):
        table(results, "los")
    with pytest.raises(InputError, match="nothing to show"):
        table(results[["params.a.bias", "finished", "diverged"]])
    with pytest.raises(InputError, match="no swept axis 'prefix'"):
        table(results, "mean_m", over="prefix")
    with pytest.raises(InputError, match="nothing to draw"):
        line_figure(select(results, ["gamma=1", "beta=0.1"]), "epoch")
    many = select(results, ["gamma=0"]).isel(beta=[0, 1, 2] * 3).assign_coords(beta=range(9))
    with pytest.raises(InputError, match=r"9 lines are too many.*--where beta=0,1,..."):
        line_figure(many, "epoch", "loss", "beta")
    one = select(results, ["gamma=0"])
    with pytest.raises(InputError, match=r"\.png, \.pdf or \.svg"):
        plot(one, tmp_path / "plot.jpq", "beta", "latency")
    with pytest.raises(InputError, match="cannot write there"):
        plot(one, Path(tmp_path / "missing" / "plot.png"), "beta", "latency")


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

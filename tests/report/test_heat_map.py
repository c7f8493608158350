"""A sweep over two axes: what stands in which cell, how holes look, and that the numbers can be read."""

import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import LogNorm

from ovibjax.errors import InputError
from ovibjax.report import figures as fig
from ovibjax.report.heat_map import heat_figure
from ovibjax.report.plotting import plot
from ovibjax.report.selection import select
from tests.report.cases import GAMMA, made_results, zipped


@pytest.fixture
def results() -> xr.Dataset:
    return made_results()


def written(figure) -> np.ndarray:
    """[rows, columns] texts of the cells, by their place."""
    ax = figure.axes[0]
    places = {tuple(int(at) for at in text.get_position()[::-1]): text.get_text() for text in ax.texts}
    shape = ax.images[0].get_array().shape
    return np.array([[places[row, column] for column in range(shape[1])] for row in range(shape[0])])


def test_cells_hold_means_intervals_and_what_is_missing(results) -> None:
    figure = heat_figure(results, "gamma", "beta", "latency")
    ax, texts = figure.axes[0], written(figure)
    use = results["finished"] & ~results["diverged"]
    mean = results["latency"].where(use).mean("seed").values
    np.testing.assert_allclose(ax.images[0].get_array().filled(np.nan), mean)
    first = [cell.split("\n")[0] for cell in texts.ravel()]
    assert [float(cell) for cell in first[:-1]] == pytest.approx(mean.ravel()[:-1].tolist(), abs=0.06)
    assert texts[0, 0].count("±") == 1 and texts[2, 0].endswith("\n3/5") and "/" not in texts[0, 0]
    assert texts[2, 3] == "-" and len(ax.patches) == 1 and ax.patches[0].get_xy() == (2.5, 1.5)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("gamma", "beta (1/bit)")
    assert figure.axes[1].get_ylabel() == "latency (ms)"
    assert [tick.get_text() for tick in ax.get_xticklabels()] == [f"{value:g}" for value in GAMMA]
    assert not ax.yaxis_inverted(), "numbers grow upwards"
    caption = " ".join(figure.get_suptitle().split())
    assert "5 values of seed" in caption and "6 diverged and 1 unfinished" in caption


def test_numbers_are_in_order_and_names_as_they_are(results) -> None:
    mixed = results.isel(gamma=[2, 0, 3, 1]).assign_coords(beta=["ring", "mono", "stereo"])
    figure = heat_figure(mixed, "gamma", "beta", "latency")
    ax = figure.axes[0]
    assert [tick.get_text() for tick in ax.get_xticklabels()] == [f"{value:g}" for value in GAMMA]
    assert [tick.get_text() for tick in ax.get_yticklabels()] == ["ring", "mono", "stereo"] and ax.yaxis_inverted()
    plain = heat_figure(results, "gamma", "beta", "latency")
    np.testing.assert_array_equal(written(figure), written(plain))


def test_axes_of_the_outputs_and_averages_over_others(results) -> None:
    figure = heat_figure(select(results, ["gamma=0"]), "prefix", "beta", "mean_m")
    assert written(figure).shape == (3, 2) and written(figure)[2, 0].endswith("3/5")
    figure = heat_figure(results, "prefix", "beta", "mean_m", over=("seed", "gamma"))
    assert "each a mean over gamma" in " ".join(figure.get_suptitle().split())
    assert written(figure)[2, 0].endswith("13/20")


def test_colours_are_logarithmic_over_decades(results) -> None:
    falling = results.assign(latency=results["latency"] * 10.0 ** -xr.DataArray(range(4), dims="gamma"))
    assert isinstance(heat_figure(falling, "gamma", "beta", "latency").axes[0].images[0].norm, LogNorm)
    assert not isinstance(heat_figure(results, "gamma", "beta", "latency").axes[0].images[0].norm, LogNorm)


def wide(columns: int) -> xr.Dataset:
    """Three seeds on a grid of `columns` by three."""
    rng, dims = np.random.default_rng(0), ("x", "y", "seed")
    shape = (columns, 3, 3)
    flags = {name: (dims, np.full(shape, name == "finished")) for name in ("finished", "diverged")}
    coords = {"x": np.arange(columns), "y": [1, 2, 3], "seed": range(3)}
    return xr.Dataset({"m": (dims, rng.uniform(1.0, 2.0, shape))} | flags, coords)


@pytest.mark.parametrize("columns", [2, 6, 10, 20, 60])
def test_every_number_fits_its_cell_or_is_left_out(columns: int) -> None:
    figure = heat_figure(wide(columns), "x", "y")
    figure.canvas.draw()
    ax = figure.axes[0]
    cell_px = ax.get_window_extent().width / columns
    for text in ax.texts:
        assert text.get_window_extent().width <= cell_px and text.get_fontsize() >= 5.0
    shown = {text.get_text() for text in ax.texts} != {""}
    assert shown == (columns <= 20)
    assert figure.get_figwidth() == (fig.COLUMN_IN if columns in (2, 6, 10, 60) else fig.PAGE_IN)
    assert len([tick for tick in ax.get_xticklabels() if tick.get_text()]) <= 30


def test_a_heat_map_is_written(results, tmp_path) -> None:
    plot(results, tmp_path / "map.png", "gamma", "latency", y="beta")
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"x": "beta", "y": "gama"}, "no axis 'gama'; did you mean gamma"),
        ({"x": "beta", "y": "gamma"}, "choose what to draw along beta with --metric: mean_m, latency, loss"),
        ({"x": "beta", "y": "seed", "metric": "latency"}, "--plot seed: the mean is taken along it"),
        ({"x": "beta", "y": "beta", "metric": "latency"}, "--plot beta: it advances together with beta"),
        (
            {"x": "beta", "y": "prefix", "metric": "mean_m"},
            r"gamma has 4 values .*: choose one with --where gamma=1 or average over it with --over seed gamma$",
        ),
    ],
)
def test_a_heat_map_says_what_to_choose(results, arguments: dict[str, str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        heat_figure(results, **arguments)


def test_what_cannot_be_a_heat_map(results, tmp_path) -> None:
    with pytest.raises(InputError, match="--plot gamma: it advances together with beta"):
        heat_figure(zipped(results), "beta", "gamma", "latency")
    with pytest.raises(InputError, match="nothing to draw"):
        heat_figure(select(results, ["gamma=1", "beta=0.1"]), "beta", "gamma", "latency")
    with pytest.raises(InputError, match="--hue beta: a heat map of gamma and beta has no lines"):
        plot(results, tmp_path / "map.png", "gamma", "latency", hue="beta", y="beta")

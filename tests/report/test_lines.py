"""A sweep drawn along an axis: what is drawn, on which scale, and what the user has to choose first."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from ovibjax.errors import InputError
from ovibjax.report.claims import interval
from ovibjax.report.lines import line_figure
from ovibjax.report.plotting import plot
from ovibjax.report.selection import select
from tests.report.cases import GAMMA, made_results, zipped


@pytest.fixture
def results() -> xr.Dataset:
    return made_results()


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
            r"gamma has 4 values \(0, 0.01, 0.1, 1\).*--where gamma=1 or.*--hue gamma or.*--over seed gamma$",
        ),
        ({"x": "beta", "metric": "mean_m", "hue": "gamma"}, "prefix has 2 values .*--where prefix=35$"),
        ({"x": "prefix", "metric": "loss"}, "--plot prefix: loss does not depend on it"),
        ({"x": "beta", "metric": "latency", "hue": "epoch"}, "--hue epoch: latency does not depend on it"),
        ({"x": "seed", "metric": "latency"}, "--plot seed: the mean is taken along it"),
        ({"x": "beta", "metric": "latency", "over": "sede"}, "no swept axis 'sede'; did you mean seed"),
        ({"x": "beta", "metric": "latency", "hue": "beta"}, "--hue beta: it advances together with beta"),
    ],
)
def test_plot_says_what_to_choose(results, arguments: dict[str, str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        line_figure(results, **arguments)


def test_what_cannot_be_drawn(results, tmp_path) -> None:
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

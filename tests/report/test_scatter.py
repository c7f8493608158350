"""A search drawn: points over one axis or two, without lines between what no path joins."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from ovibjax.errors import InputError
from ovibjax.report.lines import line_figure
from ovibjax.report.plotting import plot
from ovibjax.report.scatter import scatter_figure
from ovibjax.report.show import table


@pytest.fixture
def search() -> xr.Dataset:
    """32 points of beta and share, an axis with one value zipped with them, 4 seeds; one point is not finished."""
    rng = np.random.default_rng(0)
    beta, share = 10 ** rng.uniform(-4, 0, 32), rng.uniform(0, 1, 32)
    cost = (np.log10(beta) + 2) ** 2 + share
    finished = np.arange(32) != 5
    dims = ("beta_share_depth", "seed")
    values = np.where(finished, cost, np.nan)[:, None] + 0.01 * rng.normal(size=(32, 4))
    flags = np.broadcast_to(finished[:, None], (32, 4)).copy()
    coords = {
        "beta": (dims[0], beta),
        "share": (dims[0], share),
        "depth": (dims[0], np.ones(32, int)),
        "seed": range(4),
    }
    data = {"cost": (dims, values, {"units": "m"}), "finished": (dims, flags), "diverged": (dims, ~flags & False)}
    return xr.Dataset(data, coords)


def test_points_over_one_axis_are_not_joined(search) -> None:
    (ax,) = line_figure(search, "beta", "cost").axes
    (bars,) = ax.containers
    assert bars[0].get_linestyle() == "None" and len(bars[0].get_xdata()) == 32 and ax.get_xscale() == "log"
    (ax,) = line_figure(search.isel(seed=[0]), "share", "cost").axes
    assert ax.get_xscale() == "linear"


def test_over_two_axes_the_colour_is_the_mean(search, tmp_path: Path) -> None:
    figure = scatter_figure(search, "beta", "share", "cost")
    ax, bar = figure.axes
    (points,) = ax.collections
    mean = search.cost.mean("seed").values
    order = np.argsort(-np.delete(mean, 5))
    np.testing.assert_allclose(points.get_array(), np.delete(mean, 5)[order])
    np.testing.assert_allclose(points.get_offsets()[:, 0], np.delete(search.beta.values, 5)[order])
    lost, ring = ax.lines
    best = int(np.nanargmin(mean))
    assert ring.get_xdata() == [search.beta.values[best]] and lost.get_ydata() == [search.share.values[5]]
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "linear")
    assert bar.get_ylabel() == "cost (m)" and "without 4 unfinished; lowest ringed" in figure.get_suptitle()
    plot(search, tmp_path / "a.png", "beta", "cost", y="share")
    assert (tmp_path / "a.png").stat().st_size > 5000


def test_what_cannot_be_drawn(search) -> None:
    named = search.assign_coords(share=("beta_share_depth", [f"a{i}" for i in range(32)]))
    with pytest.raises(InputError, match="--plot beta share: share has names"):
        scatter_figure(named, "beta", "share", "cost")
    with pytest.raises(InputError, match="nothing to draw"):
        scatter_figure(search.isel(beta_share_depth=[5]), "beta", "share", "cost")
    with pytest.raises(InputError, match=r"beta has 32 values .* choose one with --where beta="):
        line_figure(search.expand_dims(k=[1, 2]), "k", "cost")
    with pytest.raises(InputError, match="it advances together with beta"):
        plot(search, Path("a.png"), "beta", "cost", y="beta")


def test_an_axis_with_one_value_stands_above_the_table(search) -> None:
    made = table(search, "cost")
    assert str(made.title) == "depth = 1"
    assert [str(column.header) for column in made.columns] == ["beta", "share", "cost (m)", "note"]

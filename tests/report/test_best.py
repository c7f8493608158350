"""The point a sweep's reader asks for, and the command that reruns it; variance shares of a grid."""

import numpy as np
import pytest
import xarray as xr

from ovibjax.errors import InputError
from ovibjax.report.best import choose, command
from ovibjax.report.claims import interval
from ovibjax.report.shares import variance_shares


@pytest.fixture
def dataset():
    rng = np.random.default_rng(0)
    dims = ("beta", "seed")
    error = np.array([[5.0, 5.2, 4.8], [3.0, 3.2, 2.8], [1.0, 1.2, 0.8]])
    cost = rng.uniform(1, 2, (3, 3, 2, 2)) + np.array([3.0, 0.0, 5.0])[:, None, None, None]
    cost[1, :, 1, 0] = 0.1
    return xr.Dataset(
        {
            "mean_route_m": (dims, error, {"units": "m"}),
            "kb": (dims, np.array([[1.0] * 3, [2.0] * 3, [3.0] * 3])),
            "top_cost": ((*dims, "k", "scheduler"), cost),
            "finished": (dims, np.ones((3, 3), bool)),
            "diverged": (dims, np.zeros((3, 3), bool)),
        },
        coords={"beta": [1e-4, 1e-3, 1e-2], "seed": [100, 101, 102], "k": [8, 16], "scheduler": ["fifo", "edf"]},
    )


def test_the_lowest_mean_within_the_bounds(dataset):
    found = choose(dataset, "mean_route_m", ["kb<=2.1"])
    assert found.point == {"beta": 1e-3} and found.feasible == 2 and found.points == 3
    assert found.means["mean_route_m"] == pytest.approx(3.0) and found.halves["mean_route_m"] > 0
    assert np.isnan(found.means["top_cost"])  # depends on axes that were not chosen along
    assert choose(dataset, "mean_route_m").point == {"beta": 1e-2}
    assert found.over == {"seed": [100, 101, 102]}


def test_bounds_on_metrics_over_more_axes(dataset):
    found = choose(dataset, "mean_route_m", ["top_cost<0.5", "kb>1"])
    assert found.point == {"beta": 1e-3, "k": 16, "scheduler": "fifo"} and found.feasible == 1
    assert found.means["top_cost"] == pytest.approx(0.1)
    assert choose(dataset, "top_cost").point == {"beta": 1e-3, "k": 16, "scheduler": "fifo"}


def test_the_runner_up_is_compared_on_the_seeds_that_both_have(dataset):
    """Seeds differ by more than the points do; the paired difference does not."""
    above_m = np.array([[1.0, 1.2, 1.1], [0.5, 0.6, 0.4], [0.0, 0.0, 0.0]])
    dataset["mean_route_m"][:] = np.array([0.0, 10.0, 20.0]) + above_m
    found = choose(dataset, "mean_route_m").runner_up
    span = interval([0.5, 0.6, 0.4])
    assert found.point == {"beta": 1e-3} and found.common == 3 and found.apart and (found.tied, found.others) == (0, 2)
    assert (found.difference.mean, found.difference.half) == pytest.approx((span.mean, span.half))
    dataset["finished"][2, 0] = False  # the lowest lacks its lowest seed, and is the lowest no more
    found = choose(dataset, "mean_route_m")
    assert found.point == {"beta": 1e-3} and found.runner_up.point == {"beta": 1e-4}
    assert not found.missing
    dataset["finished"][0, 1] = False
    found = choose(dataset, "mean_route_m", ["mean_route_m>=11"])
    assert found.missing == "2 of 3 seeds: 1 unfinished"
    found = found.runner_up
    assert found.point == {"beta": 1e-2} and found.common == 1 and not found.apart and np.isinf(found.difference.half)


def test_points_that_cannot_be_told_apart_are_counted(dataset):
    noise = np.array([[0.3, -0.2, 0.4], [0.0, 0.0, 0.0], [2.0, 2.1, 1.9]])
    dataset["mean_route_m"][:] = 5.0 + noise
    found = choose(dataset, "mean_route_m")
    assert found.point == {"beta": 1e-3} and not found.runner_up.apart
    assert found.runner_up.point == {"beta": 1e-4} and (found.runner_up.tied, found.runner_up.others) == (1, 2)
    assert choose(dataset, "mean_route_m", ["mean_route_m<=5"]).runner_up is None


def test_the_runner_up_is_another_point_of_the_metric(dataset):
    """A bound on more axes leaves many points with one and the same route error."""
    found = choose(dataset, "mean_route_m", ["top_cost>0"])
    assert found.point == {"beta": 1e-2, "k": 8, "scheduler": "fifo"} and found.runner_up.point == {"beta": 1e-3}
    found = choose(dataset, "top_cost").runner_up
    assert set(found.point) == {"beta", "k", "scheduler"} and found.others == 11


def test_several_axes_are_averaged_over(dataset):
    found = choose(dataset, "top_cost", over=("seed", "beta"))
    cost = dataset["top_cost"].mean("beta")
    best = np.unravel_index(int(np.argmin(cost.mean("seed").values)), (2, 2))
    assert found.point == {"k": [8, 16][best[0]], "scheduler": ["fifo", "edf"][best[1]]}
    assert found.halves["top_cost"] == pytest.approx(interval(cost.values[:, best[0], best[1]]).half)
    assert found.over == {"seed": [100, 101, 102], "beta": [1e-4, 1e-3, 1e-2]}


def test_a_diverged_member_counts_in_no_mean(dataset):
    dataset["mean_route_m"][2, 0] = np.nan
    dataset["diverged"][2, 0] = True
    assert choose(dataset, "mean_route_m").means["mean_route_m"] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("metric", "bounds", "message"),
    [
        ("mean_route", [], "did you mean mean_route_m"),
        ("kb", ["kb=2"], "write METRIC<=NUMBER"),
        ("kb", ["kb<=much"], "'much' is not a number"),
        ("kb", ["bk<=2"], "no metric 'bk'"),
        ("kb", ["kb<=0.5"], "no finished point keeps kb<=0.5"),
    ],
)
def test_what_cannot_be_chosen_is_refused(dataset, metric, bounds, message):
    with pytest.raises(InputError, match=message):
        choose(dataset, metric, bounds)


def test_the_command_that_reruns_the_point():
    config = {
        "function": "ovibjax.system.chain.System",
        "settings": {"k": [8, 16], "data": "embedded", "kb_per_s": 4.0, "scheduler": ["fifo", "edf"]},
    }
    axes, point = ["beta", "seed"], {"beta": 1e-3, "k": 16, "scheduler": "edf"}
    line = command(config, axes, point, {"seed": [100, 101]}, "a b.zarr")
    assert line == (
        "ovibjax sweep system --k 16 --kb-per-s 4 --scheduler edf --beta 0.001 --seed 100 101 --out 'a b.zarr'"
    )
    assert "--beta 0.00012345678 " in command(config, axes, {"beta": 0.00012345678}, {}, "x"), "the bits of the point"
    with pytest.raises(InputError, match="made from Python by mine"):
        command({**config, "function": "mine.fn"}, [], {}, {}, "x")


def test_shares_of_a_sum_and_of_a_product():
    x, y = xr.DataArray([0.0, 1.0, 2.0], dims="x"), xr.DataArray([0.0, 3.0], dims="y")
    shares = variance_shares((x + y).rename("sum"))
    assert shares["x"] == pytest.approx(np.var(x) / (np.var(x) + np.var(y)))
    assert shares["x x y"] == pytest.approx(0.0, abs=1e-12) and shares["rest"] == pytest.approx(0.0, abs=1e-12)
    product = ((x - 1.0) * (y - 1.5)).rename("product")
    assert variance_shares(product)["x x y"] == pytest.approx(1.0)
    assert variance_shares(product, order=1)["rest"] == pytest.approx(1.0)
    assert set(variance_shares((0.0 * product).rename("none")).values()) == {0.0}


def test_shares_add_up_on_random_grids():
    rng = np.random.default_rng(3)
    grid = xr.DataArray(rng.normal(size=(3, 4, 2, 5)), dims=("a", "b", "c", "seed"), name="m")
    assert sum(variance_shares(grid).values()) == pytest.approx(1.0)
    assert sum(variance_shares(grid, order=4).values()) == pytest.approx(1.0)
    assert variance_shares(grid, order=4)["rest"] == pytest.approx(0.0, abs=1e-9)
    assert sum(variance_shares(grid, axes=["b", "a"]).values()) == pytest.approx(1.0)
    with pytest.raises(InputError, match="no axis 'z'"):
        variance_shares(grid, axes=["z"])
    with pytest.raises(InputError, match="not finite"):
        variance_shares(grid.where(grid > 0))

"""Rows of a table by metric or axis: order, holes last, how many are kept."""

import numpy as np
import pytest
import xarray as xr

from ovibjax.errors import InputError
from ovibjax.report.ranking import Ranking
from ovibjax.report.show import table
from tests.report.cases import made_results
from tests.report.test_show import heads, text


@pytest.fixture
def results() -> xr.Dataset:
    return made_results()


def mean_latency(results: xr.Dataset) -> np.ndarray:
    use = results["finished"] & ~results["diverged"]
    return results["latency"].where(use).mean("seed").values


@pytest.mark.parametrize("descending", [False, True])
def test_rows_by_a_metric_have_holes_last(results, descending: bool) -> None:
    made = table(results, "latency", ranking=Ranking("latency", descending))
    mean = mean_latency(results)
    flat = np.where(np.isnan(mean), np.inf, -mean if descending else mean).ravel()
    places = [np.unravel_index(i, (3, 4)) for i in np.argsort(flat, kind="stable")]
    wanted = [[f"{results['beta'].values[b]:g}", f"{results['gamma'].values[g]:g}"] for b, g in places]
    assert [row[:2] for row in text(made)] == wanted
    assert text(made)[-1][2:] == ["-", "0 of 5 seeds: 5 diverged"]
    assert f"sorted by latency, {'highest' if descending else 'lowest'} first" in str(made.caption)


def test_the_first_rows_are_kept_and_a_hole_is_not_among_them(results) -> None:
    made = table(results, "latency", ranking=Ranking(top=2))
    places = np.argwhere(mean_latency(results) <= np.sort(mean_latency(results).ravel())[1])
    wanted = [[f"{results['beta'].values[b]:g}", f"{results['gamma'].values[g]:g}"] for b, g in places]
    assert sorted(row[:2] for row in text(made)) == sorted(wanted)
    assert "2 of 12 rows" in str(made.caption)
    assert len(text(table(results, "latency", ranking=Ranking(top=12)))) == 11
    assert len(text(table(results, "latency", max_rows=3, ranking=Ranking("latency")))) == 3


def test_another_metric_sorts_by_its_last_point(results) -> None:
    made = table(results.isel(beta=[0]), "latency", ranking=Ranking("mean_m"))
    order = np.argsort(results["mean_m"].values[0, :, :, 1].mean(axis=1))
    assert [row[0] for row in text(made)] == [f"{value:g}" for value in results["gamma"].values[order]]
    assert "sorted by mean_m prefix 35" in str(made.caption) and "mean_m (m)" not in str(heads(made))


def test_rows_by_an_axis(results) -> None:
    named = results.assign_coords(beta=["ring", "mono", "stereo"])
    made = table(named, "latency", ranking=Ranking("beta"))
    assert [row[0] for row in text(made)[::4]] == ["mono", "ring", "stereo"]
    made = table(results, "loss", max_rows=100, ranking=Ranking("epoch", descending=True))
    assert [row[2] for row in text(made)] == [str(epoch) for epoch in range(6, 0, -1) for _ in range(12)]
    assert text(made)[8][:3] == ["0.1", "0", "6"] and text(made)[8][4].startswith("3 of 5")


@pytest.mark.parametrize(
    ("ranking", "message"),
    [
        (Ranking("latancy"), "no metric or axis 'latancy'; did you mean latency"),
        (Ranking(top=3), r"--top 3: say by what with --sort NAME, a metric \(mean_m, latency, loss\)"),
        (Ranking(descending=True), "--descending: say by what"),
        (Ranking("seed"), "--sort seed: the mean is taken over it"),
        (Ranking("epoch"), "--sort epoch: the rows do not differ in it"),
    ],
)
def test_what_cannot_be_sorted_by(results, ranking: Ranking, message: str) -> None:
    with pytest.raises(InputError, match=message):
        table(results, ranking=ranking)

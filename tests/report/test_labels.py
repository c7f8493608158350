"""Axes and metrics of results, and selections among them."""

import numpy as np
import pytest
import xarray as xr

from ovibjax.errors import InputError
from ovibjax.report.labels import metrics, select
from tests.report.cases import BETA, made_results, zipped


@pytest.fixture
def results() -> xr.Dataset:
    return made_results()


def test_metrics_are_labelled_numbers_over_the_grid(results) -> None:
    assert metrics(results) == ["mean_m", "latency", "loss"]
    with pytest.raises(InputError, match=r"not a sweep's results.*'finished'"):
        metrics(results.drop_vars("finished"))


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

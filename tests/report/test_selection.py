"""Axes and metrics of results, and selections among them."""

import numpy as np
import pytest
import xarray as xr

from ovibjax.errors import InputError
from ovibjax.report.labels import metrics
from ovibjax.report.selection import select, taken_apart
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
    assert select(named, ["beta!=mono,ring"])["beta"].values.tolist() == ["left, right"]


def test_a_condition_is_taken_apart() -> None:
    assert taken_apart(" beta>=0.1 ") == ("beta", ">=", "0.1") and taken_apart("k==8") == ("k", "=", "8")
    assert taken_apart("kind = left, right") == ("kind", "=", "left, right")
    assert taken_apart("beta") is None and taken_apart("beta<") is None and taken_apart("=3") is None


@pytest.mark.parametrize(
    ("where", "kept"),
    [
        # 0.1 in float32 lies above 0.1, and is 0.1 all the same.
        (["beta<=0.1"], [0, 1, 2]),
        (["beta<0.1"], [0, 1]),
        (["beta>1e-3"], [1, 2]),
        (["beta>=0.001", "beta<=0.01"], [0, 1]),
        (["beta!=0.01"], [0, 2]),
        (["beta!=0.01,0.1", "seed>2"], [0]),
    ],
)
def test_numbers_are_compared_to_float32_accuracy(results, where: list[str], kept: list[int]) -> None:
    np.testing.assert_array_equal(select(results, where)["beta"].values, BETA[kept])


def test_what_the_table_shows_of_a_value_finds_it(results) -> None:
    searched = results.assign_coords(beta=[1.23456789e-4, 0.0123456, 0.5])
    assert select(searched, ["beta=0.000123457"])["beta"].values.tolist() == [1.23456789e-4]


@pytest.mark.parametrize(
    ("where", "message"),
    [
        ("beta", "write AXIS=VALUE.*beta, gamma, seed"),
        ("beta=", "write AXIS=VALUE"),
        ("betta=1", "no axis 'betta'; did you mean beta.*gamma"),
        ("zzz=1", "no axis 'zzz'; there is: beta"),
        ("beta=0.0011", "beta has no value '0.0011'; it has 0.001, 0.01, 0.1"),
        ("beta!=2", "beta has no value '2'"),
        ("beta=0.01,2", "beta has no value '2'"),
        ("gamma=none", "gamma has no value 'none'"),
        ("gamma=nan", "gamma has no value 'nan'"),
        ("gamma>=nan", "no value of gamma is"),
        ("beta>0.1", "--where beta>0.1: no value of beta is; it has 0.001, 0.01, 0.1"),
        ("beta<few", "'few' is not a number; it has 0.001"),
    ],
)
def test_select_says_what_there_is(results, where: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        select(results, [where])


def test_names_may_hold_commas(results) -> None:
    named = results.isel(seed=slice(0, 3)).assign_coords(seed=["a", "a,b", "c,d"])
    for wanted, kept in (("a,b", ["a,b"]), ("a,c,d", ["a", "c,d"]), ("c,d,a,b", ["a,b", "c,d"])):
        assert select(named, [f"seed={wanted}"]).seed.values.tolist() == kept
    with pytest.raises(InputError, match="seed has no value 'c'"):
        select(named, ["seed=a,c"])


def test_names_have_no_order(results) -> None:
    named = results.assign_coords(beta=["mono", "stereo", "ring"])
    with pytest.raises(InputError, match=r"--where beta>=mono: its values are names \(mono, stereo, ring\)"):
        select(named, ["beta>=mono"])


def test_a_store_without_members_is_told(results) -> None:
    with pytest.raises(InputError, match="no member yet"):
        select(results.isel({str(results.finished.dims[0]): slice(0)}), [])

"""Grids hold what was asked for, and refuse the rest by name."""

import time
from itertools import product

import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.sweep.grid import Axis, make_grid


def refusal(*args, **options):
    with pytest.raises(InputError) as caught:
        make_grid(*args, **options)
    message = str(caught.value)
    assert "\n" not in message, message
    return message


def test_cartesian():
    grid = make_grid({"beta": [0.1, 0.2, 0.3], "seed": range(4), "last": [True, False]})
    assert grid.dims == ("beta", "seed", "last")
    assert grid.shape == (3, 4, 2) and grid.size == 24
    points = grid.points(np.arange(24), ["beta", "seed", "last"])
    expected = list(product([0.1, 0.2, 0.3], range(4), [True, False]))
    np.testing.assert_array_equal(points["beta"], np.float32([row[0] for row in expected]))
    np.testing.assert_array_equal(points["seed"], [row[1] for row in expected])
    np.testing.assert_array_equal(points["last"], [row[2] for row in expected])


def test_points_keep_the_shape_of_members():
    grid = make_grid({"a": [1, 2], "b": [3.0, 4.0, 5.0]})
    points = grid.points(np.array([[0, 5], [4, 2]]), ["b", "a"])
    assert list(points) == ["b", "a"]
    assert points["a"].tolist() == [[1, 2], [2, 1]]
    assert points["b"].tolist() == [[3, 5], [4, 5]]


def test_zipped_axes_share_a_dimension():
    grid = make_grid({"a": [1, 2, 3], "b": [0.5, 0.6], "c": ["x", "y", "x"]}, zipped=[("a", "c")])
    assert grid.dims == ("a_c", "b") and grid.shape == (3, 2)
    assert grid.group_of("c") == grid.group_of("a") == 0 and grid.group_of("b") == 1
    points = grid.points(np.arange(6), ["a", "b", "c"])
    assert points["a"].tolist() == [1, 1, 2, 2, 3, 3]
    assert points["c"].tolist() == [0, 0, 1, 1, 2, 2]


def test_zipped_order_is_the_callers_and_place_the_first_axis():
    grid = make_grid({"a": [1, 2], "b": [7], "c": [3, 4]}, zipped=[["c", "a"]])
    assert grid.dims == ("c_a", "b")


@pytest.mark.parametrize(
    ("values", "codes", "dtype"),
    [
        ([0.1, 2], [0.1, 2], np.float32),
        (np.linspace(0, 1, 3), [0, 0.5, 1], np.float32),
        (np.float16([1, 2]), [1, 2], np.float32),
        (range(2, 5), [2, 3, 4], np.int32),
        (np.arange(3, dtype=np.uint8), [0, 1, 2], np.int32),
        ((-5, 2**31 - 1), [-5, 2**31 - 1], np.int32),
        ([True, False], [True, False], np.bool_),
        (["mean", "max", "vit"], [0, 1, 2], np.int32),
        (np.array(["b", "a"]), [0, 1], np.int32),
        (3, [3], np.int32),
        ("mean", [0], np.int32),
        (Axis((1.0, 2.0), "m"), [1, 2], np.float32),
        (Axis(range(3)), [0, 1, 2], np.int32),
        (Axis(np.arange(3)), [0, 1, 2], np.int32),
    ],
)
def test_codes(values, codes, dtype):
    grid = make_grid({"x": values})
    assert grid.codes("x").dtype == dtype
    np.testing.assert_array_equal(grid.codes("x"), np.asarray(codes, dtype))
    assert grid.shape == (len(codes),)


def test_units():
    grid = make_grid({"distance": Axis((1, 2), "m"), "x": [1]})
    assert grid.axes["distance"].unit == "m" and grid.axes["x"].unit == ""


@pytest.mark.parametrize(
    ("axes", "words"),
    [
        ({"beta": []}, ["beta", "no values"]),
        ({"beta": Axis(())}, ["beta", "no values"]),
        ({"beta": [0.1, np.nan]}, ["beta", "nan"]),
        ({"beta": [-np.inf, 1]}, ["beta", "-inf"]),
        ({"beta": [1, 2, 1]}, ["beta", "1 is given twice"]),
        ({"kind": ["a", "b", "a"]}, ["kind", "a is given twice"]),
        ({"beta": [None, 1]}, ["beta", "None"]),
        ({"beta": [1j]}, ["beta", "1j"]),
        ({"beta": {"a": 1}}, ["beta"]),
        ({"beta": np.ones((2, 2))}, ["beta"]),
        ({"n": [2**31]}, ["n", "2147483648", "32 bits"]),
        ({"n": [-(2**40), 0]}, ["n", "-1099511627776", "32 bits"]),
        ({"n": [2**70]}, ["n"]),
        ({"two words": [1]}, ["'two words'"]),
        ({"a-b": [1]}, ["'a-b'"]),
        ({"": [1]}, ["''"]),
    ],
)
def test_bad_axes_are_named(axes, words):
    message = refusal(axes)
    assert all(word in message for word in words), message


@pytest.mark.parametrize(
    ("axes", "words"),
    [
        pytest.param({"beta": [1.0, 1e39]}, ["beta", "1e+39"], id="beyond float32"),
        pytest.param({"n": [-(2**63), 0]}, ["n", "32 bits"], id="the one integer without absolute value"),
        pytest.param({"kind": ["a", 1]}, ["kind"], id="a number among names"),
        pytest.param({"beta": [[1], [1, 2]]}, ["beta"], id="ragged"),
        pytest.param({"beta": [0.1, 0.1 + 1e-12]}, ["beta", "twice"], id="equal in float32"),
    ],
)
def test_axes_that_the_member_function_could_not_tell_or_hold(axes, words):
    message = refusal(axes)
    assert all(word in message for word in words), message


def test_no_axis():
    assert refusal({}) == "the grid has no axis"


def test_bad_zips():
    axes = {"a": [1, 2], "b": [1, 2, 3], "c": [1, 2]}
    assert "zipped axes a and b have different lengths" in refusal(axes, [("a", "b")])
    assert "zipped axis 'd' is not in the grid; it has a, b, c" in refusal(axes, [("a", "d")])
    assert "zipped twice" in refusal({**axes, "b": [3, 4]}, [("a", "b"), ("b", "c")])
    assert "zipped twice" in refusal(axes, [("a", "a")])
    assert "a and b: 1, 2 is given twice" in refusal({"a": [1, 1], "b": [2, 2]}, [("a", "b")])


def test_zip_of_unknown_axes_only():
    assert "'u'" in refusal({"a": [1, 2]}, [("u", "v")])


def test_a_long_axis_takes_no_time():
    start = time.process_time()
    assert make_grid({"x": range(8000)}).size == 8000
    assert time.process_time() - start < 0.5


def test_repeated_values_in_a_zip_are_fine_while_rows_differ():
    assert make_grid({"a": [1, 1], "b": [2, 3]}, [("a", "b")]).size == 2

"""Points drawn from ranges: spread, readable, the same for whoever draws more of them."""

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import qmc

from ovibjax.errors import InputError
from ovibjax.sweep import program
from ovibjax.sweep.engine import run
from ovibjax.sweep.sampling import Range, parse, random_points, sobol
from ovibjax.sweep.store import open_dataset
from tests.sweep.members import DATA, same, small

RANGES = {"beta": Range(1e-5, 1e-1, log=True), "share": Range(-1, 1), "depth": Range(1, 64, log=True, whole=True)}
BOTH = pytest.mark.parametrize("draw", [sobol, random_points])


@BOTH
@given(st.integers(1, 300), st.integers(1, 300), st.integers(0, 5))
def test_a_larger_number_extends_a_smaller_one(draw, n, m, seed):
    few, many = sorted((n, m))
    one, other = draw(RANGES, few, seed), draw(RANGES, many, seed)
    assert all(other[name][:few] == one[name] and len(other[name]) == many for name in RANGES)


@BOTH
def test_points_differ_and_stay_inside_and_do_not_depend_on_the_order_of_axes(draw):
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # scipy warns where points would be unbalanced
        points = draw(RANGES, 1000, 3)
    assert list(points) == list(RANGES) and len(set(zip(*points.values(), strict=True))) == 1000
    for name, drawn in RANGES.items():
        values = np.array(points[name])
        assert drawn.low <= values.min() and values.max() <= drawn.high
        # A tenth of the range, or of its decades, holds about a tenth of the points.
        place = (np.log if drawn.log else np.asarray)([*values, drawn.low, drawn.high])
        counts = np.histogram(place[:-2], 10, place[-2:])[0]
        assert drawn.whole or (abs(counts - 100) < 30).all(), name
    assert set(range(1, 9)) <= set(points["depth"]) and all(isinstance(value, int) for value in points["depth"])
    turned = draw(dict(reversed(RANGES.items())), 1000, 3)
    assert turned == points and list(turned) != list(points)
    assert draw(RANGES, 10, 4) != draw(RANGES, 10, 3)


def test_sobol_points_are_those_of_scipy():
    shares = qmc.Sobol(2, rng=np.random.default_rng(7)).random_base2(5)
    points = sobol({"b": Range(1, 3), "a": Range(1e-3, 1, log=True)}, 32, 7)
    np.testing.assert_allclose(points["a"], 10 ** (3 * shares[:, 0] - 3), rtol=5e-4)
    np.testing.assert_allclose(points["b"], 1 + 2 * shares[:, 1], rtol=5e-4)


@BOTH
def test_a_value_can_be_typed_and_is_the_same_number(draw):
    for name in ("beta", "share"):
        for value in draw(RANGES, 500)[name]:
            assert float(f"{value:.4g}") == value == float(str(value)) and str(value) != "-0.0"


@BOTH
def test_equal_points_are_drawn_once_and_no_more_than_there_are(draw):
    assert sorted(draw({"n": Range(1, 5, whole=True)}, 5)["n"]) == [1, 2, 3, 4, 5]
    assert len(set(draw({"x": Range(1, 1.01)}, 11)["x"])) == 11
    for ranges, n in (({"n": Range(1, 5, whole=True)}, 6), ({"x": Range(1, 1.01)}, 30)):
        with pytest.raises(InputError, match=rf"from lin:1:.*: there are not {n} different points of 4 digits"):
            draw(ranges, n)
    for ranges, n, seed in (({}, 1, 0), (RANGES, 0, 0), (RANGES, 1, -1), (RANGES, 1 << 40, 0)):
        with pytest.raises(InputError, match=r"range|1 to \d+ points|negative"):
            draw(ranges, n, seed)


def test_ranges_are_read_as_they_are_typed():
    assert parse("log:1e-5:1e-1") == Range(1e-5, 1e-1, log=True) and parse("lin:-1:1") == Range(-1, 1)
    assert parse("lin:1:8", whole=True) == Range(1, 8, whole=True)
    assert [parse(text) for text in ("1e-3", "0:5", "", "logs:1:2", "up")] == [None] * 5
    for text in (
        "log:1",
        "log:1:2:3",
        "lin:a:b",
        "lin:1_0:20",
        "log:0:1",
        "log:-1:1",
        "lin:2:1",
        "lin:1:1",
        "lin:0:1e39",
    ):
        with pytest.raises(InputError) as caught:
            parse(text)
        assert str(caught.value).startswith(text.split(":")[0]) and "\n" not in str(caught.value)
    for text in ("lin:0:nan", "lin:0.5:3"):
        with pytest.raises(InputError):
            parse(text, whole=True)
    assert str(Range(1e-5, 0.1, log=True)) == "log:1e-05:0.1"


def test_a_search_is_one_program_and_a_larger_one_computes_what_it_lacks(tmp_path):
    def search(n, store=None):
        seen = []
        points = sobol({"rate": Range(1e-3, 1, log=True), "load": Range(0, 1)}, n)
        axes = {**points, "seed": range(3)}
        options = {"zipped": [["rate", "load"]], "store": store, "on_progress": lambda *n: seen.append(n)}
        return run(small, axes, DATA, **options), seen[0]

    path, before = tmp_path / "a.zarr", program.compilations
    few, _ = search(20, path)
    assert dict(few.sizes) == {"rate_load": 20, "seed": 3, "wave_dim_0": 3}
    many, begun = search(50, path)
    assert begun == (60, 150) and program.compilations == before + 1
    same(many, search(50)[0])
    whole = open_dataset(path)
    assert whole.finished.all() and whole.sizes["rate_load"] == 50


def test_a_search_beside_a_grid_is_shown_as_a_list_of_points(tmp_path):
    """Not as all combinations of values, of which hardly any was asked for."""
    points = random_points({"rate": Range(1e-3, 1, log=True), "load": Range(0, 1)}, 20)
    run(small, {"rate": [0.1, 0.2], "load": [0.0, 1.0], "seed": range(2)}, DATA, store=tmp_path / "a.zarr")
    assert dict(open_dataset(tmp_path / "a.zarr").finished.sizes) == {"rate": 2, "load": 2, "seed": 2}
    run(small, {**points, "seed": range(3)}, DATA, zipped=[["rate", "load"]], store=tmp_path / "a.zarr")
    dataset = open_dataset(tmp_path / "a.zarr")
    assert dict(dataset.finished.sizes) == {"rate_load": 24, "seed": 3} and int(dataset.finished.sum()) == 68
    # Another axis crosses with the first search and advances with the second.
    three = sobol({"rate": Range(0.1, 1), "load": Range(0, 1), "gain": Range(0, 1)}, 5)

    def gained(key, point, shared):
        return {"y": point["gain"] * point["rate"]}

    run(gained, {**points, "gain": [0.5, 1.0]}, zipped=[["rate", "load"]], store=tmp_path / "b.zarr")
    assert dict(open_dataset(tmp_path / "b.zarr").finished.sizes) == {"rate_load": 20, "gain": 2}
    run(gained, three, zipped=[list(three)], store=tmp_path / "b.zarr")
    dataset = open_dataset(tmp_path / "b.zarr")
    assert dict(dataset.finished.sizes) == {"rate_load_gain": 45} and dataset.finished.all()

"""A store gives back what was added, as the grid that was asked for or as the smallest that holds all of it."""

import tempfile

import numpy as np
import pytest
import xarray
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.sweep import dataset as datasets
from ovibjax.sweep.grid import Axis, make_grid
from ovibjax.sweep.layout import Variable
from ovibjax.sweep.store import attach, open_dataset
from tests.sweep.stores import (
    AXES,
    CONFIG,
    DIGEST,
    VARIABLES,
    begun,
    blocks,
    check,
    make_rows,
    opened,
    snapshot,
)


@pytest.mark.parametrize("zipped", [(), (("seed", "kind"),)])
def test_round_trip(tmp_path, zipped):
    path = tmp_path / "runs" / "a.zarr"
    size = make_grid(AXES, zipped).size
    begun(path, range(size), zipped=zipped)
    dataset = check(path, range(size), zipped=zipped)
    assert dataset.finished.all()
    assert dataset.attrs["config"] == CONFIG and len(dataset.attrs["hash"]) == 64
    np.testing.assert_array_equal(open_dataset(path).error, dataset.error)


def test_coordinates(tmp_path):
    axes = {"seed": range(3), "beta": Axis((0.1, 0.01, 1e-3), "nat"), "kind": ["mean", "max", "none of them"]}
    zipped = (("beta", "kind"),)
    path = begun(tmp_path / "a.zarr", range(9), axes=axes, zipped=zipped)
    dataset = open_dataset(path)
    assert dataset.error.dims == ("seed", "beta_kind", "prefix")
    assert dataset.seed.values.tolist() == [0, 1, 2]
    assert dataset.beta.dims == dataset.kind.dims == ("beta_kind",)
    assert dataset.beta.values.tolist() == [1e-3, 0.01, 0.1] and dataset.beta.units == "nat"
    assert dataset.kind.values.tolist() == ["none of them", "max", "mean"]
    assert dataset.prefix.values.tolist() == [1, 4] and dataset.prefix.units == "bytes"
    assert dataset.width.values.tolist() == ["x", "y", "z"]
    assert dataset.error.units == "m"
    assert dataset.error.isel(beta_kind=2, seed=0, prefix=0) == 1  # the first member


def test_nothing_finished(tmp_path):
    path = begun(tmp_path / "a.zarr", [])
    dataset = check(path, [])
    assert not dataset.finished.any() and dataset.error.isnull().all()
    assert open_dataset(path).error.shape == (0, 0, 0, 2)


def test_select_by_name_and_value(tmp_path):
    one = open_dataset(begun(tmp_path / "a.zarr", range(18))).sel(seed=2, beta=0.1, kind="max")
    assert one.error.values.tolist() == [17.0, 34.0]


def test_a_hole_is_a_hole(tmp_path):
    """Members of several commands: the smallest grid that holds them, names in their order."""
    path = begun(tmp_path / "a.zarr", [0, 16])  # (0, 0.01, mean) and (2, 0.1, max)
    dataset = open_dataset(path)
    assert dict(dataset.sizes) == {"seed": 2, "beta": 2, "kind": 2, "prefix": 2, "width": 3}
    assert dataset.seed.values.tolist() == [0, 2] and dataset.kind.values.tolist() == ["mean", "max"]
    assert int(dataset.finished.sum()) == 2 and dataset.error.isnull().sum() == 6 * 2
    assert dataset.error.sel(seed=2, beta=0.1, kind="max").values.tolist() == [17.0, 34.0]
    begun(path, [5])  # (0, 0.1, none of them): a name between whose number and the others' none is missing
    assert open_dataset(path).kind.values.tolist() == ["mean", "max", "none of them"]
    begun(other := tmp_path / "b.zarr", [0, 5])
    assert open_dataset(other).kind.values.tolist() == ["mean", "none of them"]
    assert open_dataset(other).steps.sel(seed=0, beta=0.1, kind="none of them") == 6


def test_members_at_scattered_points_are_a_list(tmp_path, monkeypatch):
    monkeypatch.setattr(datasets, "_MOST_HOLE_BYTES", 100)
    path = begun(tmp_path / "a.zarr", [0, 10, 17])
    dataset = open_dataset(path)
    assert dataset.finished.dims == ("seed_beta_kind",) and dataset.finished.all()
    assert dataset.seed.values.tolist() == [0, 1, 2] and dataset.kind.values.tolist() == ["mean", "max", "none of them"]
    assert dataset.steps.values.tolist() == [1, 11, 18]


def test_a_store_grows_by_files_and_changes_none(tmp_path):
    path, before = begun(tmp_path / "a.zarr", range(6)), {}
    for members in ([6, 7], [17], range(8, 12)):
        held = snapshot(path)
        assert before.items() <= held.items()
        before = held
        begun(path, members)
    assert len(blocks(path)) == 4
    check(path, [*range(12), 17])


def test_a_member_in_two_files_counts_once(tmp_path):
    path = begun(tmp_path / "a.zarr", range(6))
    with opened(path) as store:
        store.add(make_rows([4, 5, 6]))
        assert len(store.rows) == 7
    check(path, range(7))
    with opened(path) as store:
        assert store.missing(make_grid(AXES), [DIGEST] * 18).tolist() == list(range(7, 18))


def test_what_is_missing_of_any_grid(tmp_path):
    """The order of axes and which of them advance together do not matter, nor how a value is spelt."""
    path = begun(tmp_path / "a.zarr", range(6))  # seed 0
    with opened(path) as store:

        def missing(axes, zipped=()):
            grid = make_grid(axes, zipped)
            return store.missing(grid, [DIGEST] * grid.size).tolist()

        assert missing({**AXES, "seed": [0]}) == []
        assert missing({**AXES, "seed": [1, 0]}) == list(range(6))
        assert missing({"kind": AXES["kind"], "beta": np.float32([0.1, 0.5]), "seed": [0]}) == [1, 3, 5]
        zipped = {"beta": [0.1, 0.01, 0.1], "kind": AXES["kind"], "seed": [0, 0, 1]}
        assert missing(zipped, [("beta", "kind", "seed")]) == [2]


def test_attach_writes_beside_another(tmp_path):
    path = tmp_path / "a.zarr"
    with opened(path) as driver:
        driver.lock()
        worker = attach(str(path))
        assert worker.config == CONFIG and worker.layout == driver.layout
        with worker:
            worker.add(make_rows([3]))
        assert driver.rows is None
        driver.read()
        assert driver.rows["out.steps"].tolist() == [4]
    check(path, [3])


@pytest.mark.filterwarnings("ignore::zarr.core.dtype.common.UnstableSpecificationWarning")
def test_export_for_other_tools(tmp_path):
    dataset = open_dataset(begun(tmp_path / "a.zarr", range(18)))
    dataset.to_zarr(tmp_path / "b.zarr", consolidated=False, zarr_format=3)
    again = xarray.open_zarr(tmp_path / "b.zarr", consolidated=False).load()
    xarray.testing.assert_identical(again, dataset)


@settings(max_examples=15, deadline=None)
@given(
    lengths=st.lists(st.integers(1, 4), min_size=1, max_size=3),
    trailing=st.lists(st.integers(1, 3), max_size=2),
    data=st.data(),
)
def test_any_grid_round_trips(lengths, trailing, data):
    axes = {f"axis{i}": range(n) for i, n in enumerate(lengths)}
    variables = {
        "v.w": Variable(tuple(trailing), np.dtype("float32"), tuple(f"x{i}" for i in range(len(trailing)))),
        "n": VARIABLES["steps"],
    }
    size = int(np.prod(lengths))
    parts = data.draw(st.lists(st.sets(st.integers(0, size - 1), min_size=1), max_size=4))
    options = {"axes": axes, "variables": variables}
    with tempfile.TemporaryDirectory() as folder:
        path = f"{folder}/a.zarr"
        begun(path, [], coords={}, **options)
        for part in parts:
            begun(path, sorted(part), coords={}, **options)
        check(path, set().union(*parts), **options)

"""A store gives back what was finished, as a grid and as a flat table."""

import tempfile

import numpy as np
import pytest
import xarray
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.sweep.grid import Axis
from ovibjax.sweep.schema import Variable
from ovibjax.sweep.store import Store, attach, open_dataset
from tests.sweep.stores import CONFIG, VARIABLES, block, check, fill, make_schema, refusal, snapshot


@pytest.mark.parametrize("outer", [None, 0, 1])
@pytest.mark.parametrize("zipped", [(), (("seed", "kind"),)])
def test_round_trip(tmp_path, zipped, outer):
    schema = make_schema(zipped=zipped, outer=outer, rows=1 if outer is None else 2)
    n = len(schema.chunks.members)
    with Store.open(tmp_path / "runs" / "a.zarr", schema, CONFIG) as store:
        assert store.finished().tolist() == [False] * n
        fill(store, range(n))
        assert store.finished().all()
    dataset = check(tmp_path / "runs" / "a.zarr", schema, range(n))
    assert dataset.finished.all()
    assert dataset.attrs["config"] == CONFIG and len(dataset.attrs["hash"]) == 64


def test_blocks_of_rows_and_columns(tmp_path):
    schema = make_schema()
    with Store.open(tmp_path / "a.zarr", schema, CONFIG) as store:
        arrays, diverged = block(schema, 1)
        rows = {name: values.reshape(2, 4, *values.shape[1:]) for name, values in arrays.items()}
        store.write(1, rows, diverged.reshape(2, 4))
    check(tmp_path / "a.zarr", schema, [1])


def test_coordinates(tmp_path):
    axes = {"seed": range(3), "beta": Axis((0.1, 0.01, 1e-3), "nat"), "kind": ["mean", "max", "none of them"]}
    schema = make_schema(axes, zipped=(("beta", "kind"),))
    Store.open(tmp_path / "a.zarr", schema, CONFIG).close()
    dataset = open_dataset(tmp_path / "a.zarr")
    assert dataset.error.dims == ("seed", "beta_kind", "prefix")
    assert dataset.seed.values.tolist() == [0, 1, 2]
    assert dataset.beta.dims == dataset.kind.dims == ("beta_kind",)
    assert dataset.beta.values.tolist() == [0.1, 0.01, 1e-3] and dataset.beta.units == "nat"
    assert dataset.kind.values.tolist() == ["mean", "max", "none of them"]
    assert dataset.prefix.values.tolist() == [1, 4] and dataset.prefix.units == "bytes"
    assert dataset.width.values.tolist() == ["x", "y", "z"]
    assert dataset.error.units == "m"
    assert not dataset.finished.any() and dataset.error.isnull().all()


def test_select_by_name_and_value(tmp_path):
    schema = make_schema()
    with Store.open(tmp_path / "a.zarr", schema, CONFIG) as store:
        fill(store, range(len(schema.chunks.members)))
    one = open_dataset(tmp_path / "a.zarr").sel(seed=2, beta=0.01, kind="max")
    assert one.error.values.tolist() == [17.0, 34.0]


def test_plain_xarray_reads_a_tidy_table(tmp_path):
    schema = make_schema({"seed": range(3), "beta": Axis((0.1, 0.01), "nat"), "kind": ["mean", "max"]})
    with Store.open(tmp_path / "a.zarr", schema, CONFIG) as store:
        fill(store, range(len(schema.chunks.members)))
    table = xarray.open_zarr(tmp_path / "a.zarr", consolidated=False).load()
    assert {"seed", "beta", "kind", "grid_index", "prefix", "width"} == set(table.coords)
    assert table.error.dims == ("member", "prefix") and table.error.units == "m"
    assert table.kind.attrs["names"] == ["mean", "max"] and table.beta.units == "nat"
    assert table.attrs["config"] == CONFIG and table.attrs["format"] == 1
    assert (table.grid_index == -1).sum() == table.sizes["member"] - 12
    padding = table.isel(member=table.grid_index.values < 0)
    assert padding.sizes["member"] == 4 and padding.beta.isnull().all() and (padding.kind == 0).all()
    table = table.isel(member=table.grid_index.values >= 0)
    assert sorted(table.grid_index.values.tolist()) == list(range(12))
    for i in range(12):
        row = table.isel(member=i)
        at = np.unravel_index(int(row.grid_index), (3, 2, 2))
        assert (int(row.seed), float(row.beta), int(row.kind)) == (at[0], np.float32([0.1, 0.01][at[1]]), at[2])
        assert int(row.steps) == int(row.grid_index) + 1


def test_one_file_per_chunk_and_array(tmp_path):
    schema = make_schema()
    with Store.open(tmp_path / "a.zarr", schema, CONFIG) as store:
        before = set(snapshot(tmp_path / "a.zarr"))
        fill(store, [1])
        assert len(set(snapshot(tmp_path / "a.zarr")) - before) == len(VARIABLES) + 2


def test_resume_sees_finished_chunks(tmp_path):
    schema = make_schema()
    with Store.open(tmp_path / "a.zarr", schema, CONFIG) as store:
        fill(store, [0, 2])
    with Store.open(tmp_path / "a.zarr", schema, {**CONFIG, "axes": {"beta": {"values": (0.001,)}}}) as store:
        assert store.finished().tolist() == [True, False, True, False]
        check(tmp_path / "a.zarr", schema, [0, 2])
        fill(store, [1, 3])
    check(tmp_path / "a.zarr", schema, range(4))


def test_attach_writes_beside_the_driver(tmp_path):
    schema = make_schema()
    with Store.open(tmp_path / "a.zarr", schema, CONFIG) as driver:
        worker = attach(str(tmp_path / "a.zarr"))
        assert worker.config == CONFIG
        np.testing.assert_array_equal(worker.schema.chunks.members, schema.chunks.members)
        fill(worker, [3])
        assert driver.finished().tolist() == [False, False, False, True]
        check(tmp_path / "a.zarr", schema, [3])


def test_chunk_without_marker_is_not_finished_and_rewritten(tmp_path):
    schema, path = make_schema(), tmp_path / "a.zarr"
    with Store.open(path, schema, CONFIG) as store:
        fill(store, [0, 1])
    (path / "finished" / "c.1").unlink()
    (path / "error" / "c.1.0").write_bytes(b"half a ch")
    (path / "steps" / "c.0123abcd.partial").write_bytes(b"killed")
    check(path, schema, [0])
    with Store.open(path, schema, CONFIG) as store:
        assert store.finished().tolist() == [True, False, False, False]
        fill(store, [1])
    check(path, schema, [0, 1])
    assert not list(path.rglob("*.partial"))


def test_fill_values_are_written_and_their_loss_is_seen(tmp_path):
    schema, path = (
        make_schema(variables={"zero": Variable((), np.dtype("float32"), ())}, coords={}),
        tmp_path / "a.zarr",
    )
    with Store.open(path, schema, CONFIG) as store:
        store.write(0, {"zero": np.full((2, 4), np.nan, np.float32)}, np.zeros((2, 4), bool))
    assert int(open_dataset(path).finished.sum()) == 8
    (path / "zero" / "c.0").unlink()
    assert "chunk 0 of zero is damaged (its file is missing)" in refusal(open_dataset, path)


@settings(max_examples=15, deadline=None)
@given(
    lengths=st.lists(st.integers(1, 4), min_size=1, max_size=3),
    outer=st.integers(-1, 2),
    rows=st.integers(1, 5),
    columns=st.integers(1, 5),
    trailing=st.lists(st.integers(1, 3), max_size=2),
    data=st.data(),
)
def test_any_grid_round_trips(lengths, outer, rows, columns, trailing, data):
    axes = {f"axis{i}": range(n) for i, n in enumerate(lengths)}
    place = None if outer < 0 else outer % len(lengths)
    dims = tuple(f"x{i}" for i in range(len(trailing)))
    variables = {"v.w": Variable(tuple(trailing), np.dtype("float32"), dims), "n": VARIABLES["steps"]}
    schema = make_schema(axes, (), place, 1 if place is None else rows, columns, variables, {})
    chunks = data.draw(st.sets(st.integers(0, len(schema.chunks.members) - 1), max_size=8))
    with tempfile.TemporaryDirectory() as folder:
        with Store.open(f"{folder}/a.zarr", schema, CONFIG) as store:
            fill(store, chunks)
        check(f"{folder}/a.zarr", schema, chunks)

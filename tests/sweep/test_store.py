"""A store gives back what was finished, after any death of its writer, and refuses what is not its own."""

import errno
import json
import random
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import xarray
import zarr.storage._local
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.errors import InputError
from ovibjax.sweep.grid import Axis, make_chunks, make_grid
from ovibjax.sweep.layout import Layout, Variable
from ovibjax.sweep.store import Store, attach, open_dataset

CONFIG = {"model": "vib", "steps": 2000, "axes": {"beta": {"values": [0.001]}}}
AXES = {"seed": range(3), "beta": [0.1, 0.01], "kind": ["mean", "max", "none of them"]}
VARIABLES = {
    "error": Variable((2,), np.dtype("float32"), ("prefix",), "m"),
    "params.encoder_1.kernel": Variable((2, 3), np.dtype("float16"), ("prefix", "width")),
    "steps": Variable((), np.dtype("int32"), ()),
    "passed": Variable((), np.dtype("bool"), ()),
}
COORDS = {"prefix": Axis((1, 4), "bytes"), "width": Axis(("x", "y", "z"))}


def make_layout(axes=AXES, zipped=(), outer=0, rows=2, columns=4, variables=VARIABLES, coords=COORDS):
    grid = make_grid(axes, zipped)
    return Layout(grid, make_chunks(grid, outer, rows, columns), variables, coords)


def block(layout, chunk):
    """Values that tell the member, flat; padding holds something else."""
    members = layout.chunks.members[chunk].reshape(-1)
    arrays = {}
    for name, v in layout.variables.items():
        values = (members + 1).reshape(-1, *[1] * len(v.shape)) * (1 + np.arange(np.prod(v.shape)).reshape(v.shape))
        arrays[name] = (values % 2 == 1 if v.dtype == bool else values).astype(v.dtype)
    return arrays, members % 3 == 1


def fill(store, chunks):
    for chunk in chunks:
        store.write(chunk, *block(store.layout, chunk))


def check(path, layout, chunks):
    """Finished members hold their values and the rest is fill."""
    dataset = open_dataset(path)
    expected = {name: np.zeros((layout.grid.size, *v.shape), v.dtype) for name, v in layout.variables.items()}
    expected |= {"finished": np.zeros(layout.grid.size, bool), "diverged": np.zeros(layout.grid.size, bool)}
    for values in expected.values():
        values[...] = np.nan if values.dtype.kind == "f" else 0
    for chunk in chunks:
        members = layout.chunks.members[chunk].reshape(-1)
        arrays, diverged = block(layout, chunk)
        for name, values in {**arrays, "diverged": diverged, "finished": members >= 0}.items():
            expected[name][members[members >= 0]] = values[members >= 0]
    assert set(dataset.data_vars) == set(expected)
    for name, values in expected.items():
        assert dataset[name].dtype == values.dtype
        assert dataset[name].dims[: len(layout.grid.dims)] == layout.grid.dims
        np.testing.assert_array_equal(dataset[name].values.reshape(values.shape), values, err_msg=name)
    return dataset


def snapshot(path):
    return {p: p.read_bytes() for p in sorted(Path(path).rglob("*")) if p.is_file()}


def refusal(function, *args, **options):
    with pytest.raises(InputError) as caught:
        function(*args, **options)
    message = str(caught.value)
    assert "\n" not in message and len(message) < 500, message
    return message


@pytest.mark.parametrize("outer", [None, 0, 1])
@pytest.mark.parametrize("zipped", [(), (("seed", "kind"),)])
def test_round_trip(tmp_path, zipped, outer):
    layout = make_layout(zipped=zipped, outer=outer, rows=1 if outer is None else 2)
    n = len(layout.chunks.members)
    with Store.open(tmp_path / "runs" / "a.zarr", layout, CONFIG) as store:
        assert store.finished().tolist() == [False] * n
        fill(store, range(n))
        assert store.finished().all()
    dataset = check(tmp_path / "runs" / "a.zarr", layout, range(n))
    assert dataset.finished.all()
    assert dataset.attrs["config"] == CONFIG and len(dataset.attrs["hash"]) == 64


def test_blocks_of_rows_and_columns(tmp_path):
    layout = make_layout()
    with Store.open(tmp_path / "a.zarr", layout, CONFIG) as store:
        arrays, diverged = block(layout, 1)
        rows = {name: values.reshape(2, 4, *values.shape[1:]) for name, values in arrays.items()}
        store.write(1, rows, diverged.reshape(2, 4))
    check(tmp_path / "a.zarr", layout, [1])


def test_coordinates(tmp_path):
    axes = {"seed": range(3), "beta": Axis((0.1, 0.01, 1e-3), "nat"), "kind": ["mean", "max", "none of them"]}
    layout = make_layout(axes, zipped=(("beta", "kind"),))
    Store.open(tmp_path / "a.zarr", layout, CONFIG).close()
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
    layout = make_layout()
    with Store.open(tmp_path / "a.zarr", layout, CONFIG) as store:
        fill(store, range(len(layout.chunks.members)))
    one = open_dataset(tmp_path / "a.zarr").sel(seed=2, beta=0.01, kind="max")
    assert one.error.values.tolist() == [17.0, 34.0]


def test_plain_xarray_reads_a_tidy_table(tmp_path):
    layout = make_layout({"seed": range(3), "beta": Axis((0.1, 0.01), "nat"), "kind": ["mean", "max"]})
    with Store.open(tmp_path / "a.zarr", layout, CONFIG) as store:
        fill(store, range(len(layout.chunks.members)))
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
    layout = make_layout()
    with Store.open(tmp_path / "a.zarr", layout, CONFIG) as store:
        before = set(snapshot(tmp_path / "a.zarr"))
        fill(store, [1])
        assert len(set(snapshot(tmp_path / "a.zarr")) - before) == len(VARIABLES) + 2


def test_resume_sees_finished_chunks(tmp_path):
    layout = make_layout()
    with Store.open(tmp_path / "a.zarr", layout, CONFIG) as store:
        fill(store, [0, 2])
    with Store.open(tmp_path / "a.zarr", layout, {**CONFIG, "axes": {"beta": {"values": (0.001,)}}}) as store:
        assert store.finished().tolist() == [True, False, True, False]
        check(tmp_path / "a.zarr", layout, [0, 2])
        fill(store, [1, 3])
    check(tmp_path / "a.zarr", layout, range(4))


def test_attach_writes_beside_the_driver(tmp_path):
    layout = make_layout()
    with Store.open(tmp_path / "a.zarr", layout, CONFIG) as driver:
        worker = attach(str(tmp_path / "a.zarr"))
        assert worker.config == CONFIG
        np.testing.assert_array_equal(worker.layout.chunks.members, layout.chunks.members)
        fill(worker, [3])
        assert driver.finished().tolist() == [False, False, False, True]
        check(tmp_path / "a.zarr", layout, [3])


def test_chunk_without_marker_is_not_finished_and_rewritten(tmp_path):
    layout, path = make_layout(), tmp_path / "a.zarr"
    with Store.open(path, layout, CONFIG) as store:
        fill(store, [0, 1])
    (path / "finished" / "c.1").unlink()
    (path / "error" / "c.1.0").write_bytes(b"half a ch")
    (path / "steps" / "c.0123abcd.partial").write_bytes(b"killed")
    check(path, layout, [0])
    with Store.open(path, layout, CONFIG) as store:
        assert store.finished().tolist() == [True, False, False, False]
        fill(store, [1])
    check(path, layout, [0, 1])
    assert not list(path.rglob("*.partial"))


def test_fill_values_are_written_and_their_loss_is_seen(tmp_path):
    layout, path = (
        make_layout(variables={"zero": Variable((), np.dtype("float32"), ())}, coords={}),
        tmp_path / "a.zarr",
    )
    with Store.open(path, layout, CONFIG) as store:
        store.write(0, {"zero": np.full((2, 4), np.nan, np.float32)}, np.zeros((2, 4), bool))
    assert int(open_dataset(path).finished.sum()) == 8
    (path / "zero" / "c.0").unlink()
    assert "chunk 0 of zero is damaged (its file is missing)" in refusal(open_dataset, path)


WRITER = """
import sys
sys.path.insert(0, {root!r})
from tests.sweep.test_store import CONFIG, Store, fill, make_layout
print("ready", flush=True)
sys.stdin.readline()
with Store.open(sys.argv[1], make_layout(rows=1, columns=2), CONFIG) as store:
    print("open", flush=True)
    {work}
"""
WAIT = "sys.stdin.read()"
WRITE = """
    while True:
        fill(store, [int(k) for k in (~store.finished()).nonzero()[0]] or sys.exit())
"""


def start(path, work):
    """A process that has loaded everything and waits for a word to open the store."""
    code = WRITER.format(root=str(Path(__file__).parents[2]), work=work.strip())
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    return subprocess.Popen([sys.executable, "-c", code, str(path)], text=True, **pipes)


def go(process, wait=True):
    line = process.stdout.readline()
    assert line == "ready\n", process.communicate()[1]
    process.stdin.write("go\n")
    process.stdin.flush()
    if wait:
        line = process.stdout.readline()
        assert line == "open\n", process.communicate()[1]


def kill(process):
    process.send_signal(signal.SIGKILL)
    process.communicate()


def test_kill_at_any_moment_keeps_what_is_finished(tmp_path):
    layout, path = make_layout(rows=1, columns=2), tmp_path / "a.zarr"
    pick = random.Random(0)
    killed = [start(path, WRITE) for _ in range(5)]
    seen = set()
    for i, process in enumerate(killed):
        go(process, wait=i >= 2)  # the first ones may die before the store is there
        time.sleep(pick.uniform(0, 0.04) if i < 2 else pick.uniform(0.05, 0.3))
        kill(process)
        if i >= 2 or path.exists():
            with Store.open(path, layout, CONFIG) as store:
                finished = np.flatnonzero(store.finished()).tolist()
            assert seen <= set(finished)
            check(path, layout, finished)
            # Leave something for the next one to write.
            for chunk in finished[2:]:
                (path / "finished" / f"c.{chunk}").unlink()
            seen = set(finished[:2])
    assert seen
    Store.open(path, layout, CONFIG).close()
    assert sorted(p.name for p in tmp_path.iterdir()) == [".a.zarr.lock", "a.zarr"]


def test_remains_of_a_killed_creation_are_removed(tmp_path):
    path = tmp_path / "a.zarr"
    stale = tmp_path / "a.zarr.tmp-999999"
    stale.mkdir()
    (stale / "zarr.json").write_text("{")
    other = tmp_path / "b.zarr.tmp-1"
    other.mkdir()
    with Store.open(path, make_layout(), CONFIG) as store:
        fill(store, [0])
    assert sorted(p.name for p in tmp_path.iterdir()) == [".a.zarr.lock", "a.zarr", "b.zarr.tmp-1"]


def test_second_process_is_refused_until_the_first_is_dead(tmp_path):
    layout, path = make_layout(rows=1, columns=2), tmp_path / "a.zarr"
    process = start(path, WAIT)
    go(process)
    (tmp_path / "link.zarr").symlink_to(path)
    for name in (path, tmp_path / "link.zarr"):
        message = refusal(Store.open, name, layout, CONFIG)
        assert message.startswith(f"{name}: process {process.pid} on host ")
        assert message.endswith(" is already working on this sweep; wait for it, or choose another --out")
    open_dataset(path)
    kill(process)
    with Store.open(path, layout, CONFIG) as store:
        refusal(Store.open, path, layout, CONFIG)
        fill(store, [0])
    Store.open(path, layout, CONFIG).close()


@pytest.mark.slow
def test_two_processes_create_at_once(tmp_path):
    both = [[start(tmp_path / f"{i}.zarr", WAIT) for _ in range(2)] for i in range(2)]
    for i, pair in enumerate(both):
        for process in pair:
            assert process.stdout.readline() == "ready\n"
        for process in pair:
            process.stdin.write("go\n")
            process.stdin.flush()
        lines = [process.stdout.readline() for process in pair]
        assert sorted(lines) == ["", "open\n"]
        assert "is already working on this sweep" in pair[lines.index("")].communicate()[1]
        assert pair[lines.index("open\n")].communicate()[1] == ""
        with Store.open(tmp_path / f"{i}.zarr", make_layout(rows=1, columns=2), CONFIG) as store:
            assert not store.finished().any()


def test_another_sweep_is_refused_with_what_differs(tmp_path):
    layout, path = make_layout(), tmp_path / "mine.zarr"
    with Store.open(path, layout, CONFIG) as store:
        fill(store, [0])
    before = snapshot(path)
    other = {"model": "vib", "steps": 4000, "axes": {"beta": {"values": [0.01]}}}
    assert refusal(Store.open, path, layout, other) == (
        f"{path} holds another sweep: steps is 2000 there and 4000 here; axes.beta.values is [0.001] there "
        "and [0.01] here; choose another --out or repeat the first command"
    )
    many = refusal(Store.open, path, layout, dict.fromkeys("abcdef", 1))
    assert many.count(" there and ") == 3
    assert "seeds is absent there and 3 here" in refusal(Store.open, path, layout, {**CONFIG, "seeds": 3})
    changed = make_layout(rows=1)
    assert "chunks.rows is 2 there and 1 here" in refusal(Store.open, path, changed, CONFIG)
    changed = make_layout({**AXES, "beta": [0.1, 0.02]})
    assert "axes.beta.values is [0.1, 0.01] there and [0.1, 0.02] here" in refusal(Store.open, path, changed, CONFIG)
    changed = make_layout(variables={**VARIABLES, "steps": Variable((), np.dtype("int64"), ())})
    assert 'variables.steps.dtype is "int32" there and "int64" here' in refusal(Store.open, path, changed, CONFIG)
    assert snapshot(path) == before
    with Store.open(path, layout, CONFIG):
        pass


def test_long_lists_are_shortened(tmp_path):
    layout, path = make_layout(), tmp_path / "a.zarr"
    Store.open(path, layout, {"snr": list(range(1000)), "path": "x" * 1000}).close()
    message = refusal(Store.open, path, layout, {"snr": list(range(999)), "path": "x" * 1000})
    assert "snr is [0, 1, ... 999] (1000 values) there and [0, 1, ... 998] (999 values) here" in message
    message = refusal(Store.open, path, layout, {"snr": [*range(700), -1, *range(701, 1000)], "path": ""})
    assert "snr[700] is 700 there and -1 here" in message


def spoil(path, how):
    file = path / "zarr.json"
    if how == "truncated":
        file.write_bytes(file.read_bytes()[:-40])
    elif how == "empty":
        file.write_bytes(b"")
    elif how == "binary":
        file.write_bytes(b"\xff\xfe\x00")
    elif how == "list":
        file.write_text("[]")
    elif how == "missing":
        file.unlink()
    elif how == "array":
        file.write_bytes((path / "error" / "zarr.json").read_bytes())
    elif how == "array metadata":
        (path / "error" / "zarr.json").write_text("{}")
    elif how == "array missing":
        (path / "error" / "zarr.json").unlink()
    elif how == "grid index":
        (path / "grid_index" / "c.0").unlink()
    elif how == "axis values":
        (path / "beta" / "c.0").write_bytes((path / "seed" / "c.0").read_bytes())
    else:
        document = json.loads(file.read_text())
        attributes = document["attributes"]
        if how == "format":
            attributes["format"] = 2
        elif how == "config":
            attributes["config"]["steps"] = 2001
        elif how == "hash":
            attributes["hash"] = "0" * 64
        elif how == "layout":
            attributes["layout"]["axes"]["beta"]["values"][0] = 0.2
        elif how == "rows":
            attributes["layout"]["chunks"]["rows"] = 4
        elif how == "object":
            attributes["layout"]["variables"]["error"]["dtype"] = "object"
        else:
            del attributes[how.removeprefix("no ")]
        file.write_text(json.dumps(document))


METADATA = ["truncated", "empty", "binary", "list", "missing", "array", "format", "config", "hash", "layout", "rows"]
METADATA += ["object", "array metadata", "array missing", "grid index", "axis values"]
METADATA += ["no format", "no config", "no hash", "no layout"]


@pytest.mark.parametrize("how", METADATA)
def test_damaged_or_edited_metadata_is_refused(tmp_path, how):
    layout, path = make_layout(), tmp_path / "a.zarr"
    with Store.open(path, layout, CONFIG) as store:
        fill(store, [0])
    spoil(path, how)
    before = snapshot(tmp_path)
    for message in (refusal(Store.open, path, layout, CONFIG), refusal(open_dataset, path), refusal(attach, path)):
        assert str(path) in message and "choose another path" in message
    assert snapshot(tmp_path) == before
    if how == "format":
        assert "format 2" in message
    if how in ("config", "hash"):
        assert "hash does not fit its config" in message


def test_what_is_no_store_is_left_alone(tmp_path):
    (tmp_path / "file.zarr").write_text("text")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "thesis.tex").write_text("text")
    (tmp_path / "empty").mkdir()
    zarr.create_group(tmp_path / "other.zarr", zarr_format=3, attributes={"title": "not ours"})
    zarr.create_group(tmp_path / "old.zarr", zarr_format=2)
    before = snapshot(tmp_path)
    for name in ("file.zarr", "folder", "empty", "other.zarr", "old.zarr"):
        assert str(tmp_path / name) in refusal(Store.open, tmp_path / name, make_layout(), CONFIG)
        refusal(open_dataset, tmp_path / name)
    refusal(open_dataset, tmp_path / "missing.zarr")
    refusal(attach, tmp_path / "missing.zarr")
    assert snapshot(tmp_path) == before and not (tmp_path / "missing.zarr").exists()


@pytest.mark.parametrize("name", ["error", "params.encoder_1.kernel", "steps", "diverged", "finished"])
@pytest.mark.parametrize("how", ["flip", "cut", "empty", "folder"])
def test_damaged_chunk_is_named_and_can_be_computed_again(tmp_path, name, how):
    layout, path = make_layout(), tmp_path / "a.zarr"
    with Store.open(path, layout, CONFIG) as store:
        fill(store, [0, 2])
    (file,) = (path / name).glob("c.2*")
    data = file.read_bytes()
    if how == "flip":
        file.write_bytes(data[:-5] + bytes([data[-5] ^ 1]) + data[-4:])  # the last byte before the checksum
    elif how == "folder" and name != "finished":
        file.unlink()
        file.mkdir()
    else:
        file.write_bytes(b"" if how == "empty" else data[:-1])
    message = refusal(open_dataset, path)
    assert f"chunk 2 of {name} is damaged" in message
    remove = re.search(r"remove (\S+) and repeat", message).group(1)
    Path(remove).unlink()
    if file.is_dir():
        file.rmdir()
    with Store.open(path, layout, CONFIG) as store:
        assert store.finished().tolist() == [True, False, False, False]
        fill(store, [2])
    check(path, layout, [0, 2])


def test_full_disk_in_the_middle_of_a_chunk(tmp_path, monkeypatch):
    layout, path = make_layout(), tmp_path / "a.zarr"
    put = zarr.storage._local._put
    with Store.open(path, layout, CONFIG) as store:
        fill(store, [0])
        for allowed in range(len(VARIABLES) + 2):
            left = [allowed]

            def full(*args, left=left, **options):
                left[0] -= 1
                if left[0] < 0:
                    raise OSError(errno.ENOSPC, "No space left on device")
                return put(*args, **options)

            monkeypatch.setattr(zarr.storage._local, "_put", full)
            assert refusal(fill, store, [1]) == (
                f"{path}: cannot write (No space left on device); 1 of 4 chunks are kept; "
                "make room and repeat the command"
            )
            monkeypatch.setattr(zarr.storage._local, "_put", put)
            assert store.finished().tolist() == [True, False, False, False]
            check(path, layout, [0])
        fill(store, [1])
    check(path, layout, [0, 1])


def test_full_disk_at_creation(tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(zarr.storage._local, "_put", full)
        message = refusal(Store.open, tmp_path / "a.zarr", make_layout(), CONFIG)
    assert "cannot write (No space left on device); 0 of 4 chunks are kept; make room" in message
    assert [p.name for p in tmp_path.iterdir()] == [".a.zarr.lock"]
    with Store.open(tmp_path / "a.zarr", make_layout(), CONFIG):
        pass


def test_the_system_refuses_a_file(tmp_path):
    """A real error of the operating system, through zarr's threads."""
    big = {"noise": Variable((4096,), np.dtype("float32"), ("x",))}
    layout = make_layout(variables=big, coords={})
    noise = np.random.default_rng(0).normal(size=(8, 4096)).astype(np.float32)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    with Store.open(tmp_path / "a.zarr", layout, CONFIG) as store:
        store.write(0, {"noise": noise}, np.zeros(8, bool))
        resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, limits[1]))
        try:
            message = refusal(store.write, 1, {"noise": noise}, np.zeros(8, bool))
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert "cannot write (File too large); 1 of 4 chunks are kept; make room" in message
        assert store.finished().tolist() == [True, False, False, False]
        assert not list((tmp_path / "a.zarr").rglob("*.partial"))


def test_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("text")
    message = refusal(Store.open, tmp_path / "file" / "a.zarr", make_layout(), CONFIG)
    assert f"cannot write ({tmp_path / 'file'} is no folder); 0 of 4 chunks are kept" in message
    message = refusal(Store.open, tmp_path / "file" / "runs" / "a.zarr", make_layout(), CONFIG)
    assert "is no folder" in message
    assert (tmp_path / "file").read_text() == "text"


def test_threads_write_different_chunks(tmp_path):
    layout, path = make_layout(rows=1, columns=1), tmp_path / "a.zarr"
    n = len(layout.chunks.members)
    with Store.open(path, layout, CONFIG) as store, ThreadPoolExecutor(6) as pool:
        for done in [pool.submit(fill, store, [chunk]) for chunk in range(n)]:
            done.result()
        assert store.finished().all()
    check(path, layout, range(n))


def test_reading_while_another_process_writes(tmp_path):
    layout, path = make_layout(rows=1, columns=2), tmp_path / "a.zarr"
    process = start(path, WRITE)
    go(process)
    for _ in range(10):
        dataset = open_dataset(path)
        members = np.flatnonzero(dataset.finished.values)
        assert (dataset.steps.values.reshape(-1)[members] == members + 1).all()
    assert process.communicate()[1] == ""
    check(path, layout, range(len(layout.chunks.members)))


@pytest.mark.parametrize(
    "name", ["beta", "grid_index", "finished", "diverged", "member", "chunk", "prefix", "zarr.json", "a_b"]
)
def test_names_that_clash_are_refused(tmp_path, name):
    layout = make_layout(
        {"a": [1, 2], "b": [3, 4], "beta": [1]},
        (("a", "b"),),
        variables={**VARIABLES, name: Variable((), np.dtype("float32"), ())},
    )
    assert repr(name) in refusal(Store.open, tmp_path / "a.zarr", layout, CONFIG)
    assert not list(tmp_path.iterdir())


def test_axis_with_a_name_of_the_store_is_refused(tmp_path):
    assert "'finished'" in refusal(Store.open, tmp_path / "a.zarr", make_layout({"finished": [1, 2]}), CONFIG)


@pytest.mark.parametrize(
    ("name", "variable"),
    [
        ("a/b", Variable((), np.dtype("float32"), ())),
        ("..", Variable((), np.dtype("float32"), ())),
        ("", Variable((), np.dtype("float32"), ())),
        ("x", Variable((), np.dtype(object), ())),
        ("x", Variable((), np.dtype("U3"), ())),
        ("x", Variable((), np.dtype(complex), ())),
        ("x", Variable((3,), np.dtype("float32"), ())),
        ("x", Variable((3,), np.dtype("float32"), ("prefix",))),
        ("x", Variable((2, 2), np.dtype("float32"), ("prefix", "prefix"))),
        ("x", Variable((0,), np.dtype("float32"), ("none",))),
        ("x", Variable((3,), np.dtype("float32"), ("seed",))),
    ],
)
def test_variables_that_cannot_be_stored_are_refused(tmp_path, name, variable):
    refusal(Store.open, tmp_path / "a.zarr", make_layout(variables={name: variable}), CONFIG)
    assert not list(tmp_path.iterdir())


def test_wrong_arrays_are_refused(tmp_path):
    layout = make_layout()
    with Store.open(tmp_path / "a.zarr", layout, CONFIG) as store:
        arrays, diverged = block(layout, 0)
        wrong = [
            (0, {**arrays, "more": diverged}, diverged),
            (0, {name: v for name, v in arrays.items() if name != "steps"}, diverged),
            (0, {**arrays, "steps": arrays["steps"].astype(np.int64)}, diverged),
            (0, {**arrays, "error": arrays["error"].T}, diverged),
            (0, arrays, diverged[:-1]),
            (4, arrays, diverged),
            (-1, arrays, diverged),
        ]
        for call in wrong:
            with pytest.raises(ValueError):
                store.write(*call)
        assert not store.finished().any()
        check(tmp_path / "a.zarr", layout, [])


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
    layout = make_layout(axes, (), place, 1 if place is None else rows, columns, variables, {})
    chunks = data.draw(st.sets(st.integers(0, len(layout.chunks.members) - 1), max_size=8))
    with tempfile.TemporaryDirectory() as folder:
        with Store.open(f"{folder}/a.zarr", layout, CONFIG) as store:
            fill(store, chunks)
        check(f"{folder}/a.zarr", layout, chunks)

"""A store refuses what is not its own: another sweep, damaged files, names and arrays that do not fit."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import zarr.storage._local

from ovibjax.sweep.schema import Variable
from ovibjax.sweep.store import Store, attach, open_dataset
from tests.sweep.stores import AXES, CONFIG, VARIABLES, block, check, fill, make_schema, refusal, snapshot


def test_another_sweep_is_refused_with_what_differs(tmp_path):
    schema, path = make_schema(), tmp_path / "mine.zarr"
    with Store.open(path, schema, CONFIG) as store:
        fill(store, [0])
    before = snapshot(path)
    other = {"model": "vib", "steps": 4000, "axes": {"beta": {"values": [0.01]}}}
    assert refusal(Store.open, path, schema, other) == (
        f"{path} holds another sweep: steps is 2000 there and 4000 here; axes.beta.values is [0.001] there "
        "and [0.01] here; choose another --out or repeat the first command"
    )
    many = refusal(Store.open, path, schema, dict.fromkeys("abcdef", 1))
    assert many.count(" there and ") == 3
    assert "seeds is absent there and 3 here" in refusal(Store.open, path, schema, {**CONFIG, "seeds": 3})
    changed = make_schema(rows=1)
    assert "chunks.rows is 2 there and 1 here" in refusal(Store.open, path, changed, CONFIG)
    changed = make_schema({**AXES, "beta": [0.1, 0.02]})
    assert "axes.beta.values is [0.1, 0.01] there and [0.1, 0.02] here" in refusal(Store.open, path, changed, CONFIG)
    changed = make_schema(variables={**VARIABLES, "steps": Variable((), np.dtype("int64"), ())})
    assert 'variables.steps.dtype is "int32" there and "int64" here' in refusal(Store.open, path, changed, CONFIG)
    assert snapshot(path) == before
    with Store.open(path, schema, CONFIG):
        pass


def test_long_lists_are_shortened(tmp_path):
    schema, path = make_schema(), tmp_path / "a.zarr"
    Store.open(path, schema, {"snr": list(range(1000)), "path": "x" * 1000}).close()
    message = refusal(Store.open, path, schema, {"snr": list(range(999)), "path": "x" * 1000})
    assert "snr is [0, 1, ... 999] (1000 values) there and [0, 1, ... 998] (999 values) here" in message
    message = refusal(Store.open, path, schema, {"snr": [*range(700), -1, *range(701, 1000)], "path": ""})
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
    schema, path = make_schema(), tmp_path / "a.zarr"
    with Store.open(path, schema, CONFIG) as store:
        fill(store, [0])
    spoil(path, how)
    before = snapshot(tmp_path)
    for message in (refusal(Store.open, path, schema, CONFIG), refusal(open_dataset, path), refusal(attach, path)):
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
        assert str(tmp_path / name) in refusal(Store.open, tmp_path / name, make_schema(), CONFIG)
        refusal(open_dataset, tmp_path / name)
    refusal(open_dataset, tmp_path / "missing.zarr")
    refusal(attach, tmp_path / "missing.zarr")
    assert snapshot(tmp_path) == before and not (tmp_path / "missing.zarr").exists()


@pytest.mark.parametrize("name", ["error", "params.encoder_1.kernel", "steps", "diverged", "finished"])
@pytest.mark.parametrize("how", ["flip", "cut", "empty", "folder"])
def test_damaged_chunk_is_named_and_can_be_computed_again(tmp_path, name, how):
    schema, path = make_schema(), tmp_path / "a.zarr"
    with Store.open(path, schema, CONFIG) as store:
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
    with Store.open(path, schema, CONFIG) as store:
        assert store.finished().tolist() == [True, False, False, False]
        fill(store, [2])
    check(path, schema, [0, 2])


@pytest.mark.parametrize(
    "name", ["beta", "grid_index", "finished", "diverged", "member", "chunk", "prefix", "zarr.json", "a_b"]
)
def test_names_that_clash_are_refused(tmp_path, name):
    schema = make_schema(
        {"a": [1, 2], "b": [3, 4], "beta": [1]},
        (("a", "b"),),
        variables={**VARIABLES, name: Variable((), np.dtype("float32"), ())},
    )
    assert repr(name) in refusal(Store.open, tmp_path / "a.zarr", schema, CONFIG)
    assert not list(tmp_path.iterdir())


def test_axis_with_a_name_of_the_store_is_refused(tmp_path):
    assert "'finished'" in refusal(Store.open, tmp_path / "a.zarr", make_schema({"finished": [1, 2]}), CONFIG)


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
    refusal(Store.open, tmp_path / "a.zarr", make_schema(variables={name: variable}), CONFIG)
    assert not list(tmp_path.iterdir())


def test_wrong_arrays_are_refused(tmp_path):
    schema = make_schema()
    with Store.open(tmp_path / "a.zarr", schema, CONFIG) as store:
        arrays, diverged = block(schema, 0)
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
        check(tmp_path / "a.zarr", schema, [])

"""A store refuses what is not its own: another sweep, other data or names, damaged files, outputs that do not fit."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import zarr

from ovibjax.sweep.grid import Axis, make_grid
from ovibjax.sweep.layout import Variable
from ovibjax.sweep.store import Store, attach, open_dataset
from tests.sweep.stores import (
    AXES,
    CONFIG,
    DIGEST,
    VARIABLES,
    begun,
    blocks,
    check,
    make_layout,
    opened,
    refusal,
    snapshot,
)


def test_another_sweep_is_refused_with_what_differs(tmp_path):
    path = begun(tmp_path / "mine.zarr", [0])
    before = snapshot(path)
    other = {"model": "vib", "steps": 4000, "rates": {"beta": [0.01]}}
    assert refusal(opened, path, other) == (
        f"{path} holds another sweep: steps is 2000 there and 4000 here; rates.beta is [0.001] there and [0.01] here; "
        "choose another --out, keep both (--keep-both), or repeat the first command"
    )
    assert refusal(opened, path, dict.fromkeys("abcdef", 1)).count(" there and ") == 3
    assert "seeds is absent there and 3 here" in refusal(opened, path, {**CONFIG, "seeds": 3})
    for options, words in (
        ({"axes": {**AXES, "more": [1]}}, "axes.more is absent there"),
        ({"axes": {"seed": range(3), "kind": AXES["kind"]}}, "axes.beta is"),
        ({"axes": {**AXES, "beta": Axis((0.1,), "nat")}}, 'axes.beta.unit is "" there and "nat" here'),
        ({"axes": {**AXES, "kind": [0, 1]}}, 'axes.kind.values is "names" there and "numbers" here'),
        (
            {"variables": {**VARIABLES, "steps": Variable((), np.dtype("int64"), ())}},
            'variables.steps.dtype is "int32"',
        ),
        ({"coords": {"prefix": Axis((1, 8), "bytes")}}, "coords.prefix.values is [1, 4] there and [1, 8] here"),
    ):
        assert words in refusal(opened, path, **options)
    assert snapshot(path) == before
    with opened(path):
        pass


def test_long_lists_are_shortened(tmp_path):
    path = tmp_path / "a.zarr"
    opened(path, {"snr": list(range(1000)), "path": "x" * 1000}).close()
    message = refusal(opened, path, {"snr": list(range(999)), "path": "x" * 1000})
    assert "snr is [0, 1, ... 999] (1000 values) there and [0, 1, ... 998] (999 values) here" in message
    message = refusal(opened, path, {"snr": [*range(700), -1, *range(701, 1000)], "path": ""})
    assert "snr[700] is 700 there and -1 here" in message


def test_other_data_at_the_same_point_are_refused(tmp_path):
    path, grid = begun(tmp_path / "a.zarr", range(6)), make_grid(AXES)
    with opened(path) as store:
        data = [DIGEST] * 18
        data[4] = bytes(16)
        message = refusal(store.missing, grid, data)
        assert "seed 0, beta 0.1, kind max saw other data there than here" in message and str(path) in message
        data[4], data[9] = DIGEST, bytes(16)  # one that is not there yet
        assert store.missing(grid, data).tolist() == list(range(6, 18))


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (["max"], "number 0 is mean there and max here"),
        (["vit", "mean"], "number 0 is mean there and vit here"),
        (["mean", "vit", "max"], "number 1 is max there and vit here"),
        (["max", "mean", "none of them"], "number 0 is mean there and max here"),
        (["mean", "max", "vit", "none of them"], "number 2 is none of them there and vit here"),
    ],
)
def test_a_name_keeps_its_number(tmp_path, names, words):
    """It is all that the member function sees of it."""
    path = begun(tmp_path / "a.zarr", range(6))
    grid = make_grid({**AXES, "kind": names})
    with opened(path) as store:
        message = refusal(store.missing, grid, [DIGEST] * grid.size)
    assert f"of kind, {words}; give names in the order of the first command, new ones last" in message


def test_a_name_that_stands_at_another_place_alone(tmp_path):
    path = begun(tmp_path / "a.zarr", [1])  # only `max` is there
    with opened(path) as store:
        grid = make_grid({**AXES, "kind": ["max"]})
        assert "max is number 1 there and 0 here" in refusal(store.missing, grid, [DIGEST] * 6)
        for names in (["mean", "max"], ["mean", "max", "none of them", "vit"]):
            grid = make_grid({**AXES, "kind": names})
            assert len(store.missing(grid, [DIGEST] * grid.size)) == grid.size - 1


def test_a_name_at_two_places_of_zipped_axes(tmp_path):
    axes, zipped = {"kind": ["x", "y", "x"], "n": [1, 2, 3]}, (("kind", "n"),)
    path = begun(tmp_path / "a.zarr", [0], axes=axes, zipped=zipped)
    with opened(path, axes=axes, zipped=zipped) as store:
        assert store.missing(make_grid(axes, zipped), [DIGEST] * 3).tolist() == [1, 2]


def spoil(path, how):
    file = path / "sweep.json"
    text = file.read_text()
    contents = {"truncated": text[:-40], "empty": "", "list": "[]", "number": "3", "array": '["format"]'}
    if how in contents:
        file.write_text(contents[how])
    elif how == "binary":
        file.write_bytes(b"\xff\xfe\x00")
    elif how == "missing":
        file.unlink()
    elif how == "no members":
        (path / "members").rmdir()
    else:
        head = json.loads(text)
        if how == "format":
            head["format"] = 3
        elif how == "config":
            head["config"]["steps"] = 2001
        elif how == "hash":
            head["hash"] = "0" * 64
        elif how == "layout":
            head["layout"]["axes"]["beta"]["unit"] = "m"
        elif how == "object":
            head["layout"]["variables"]["error"]["dtype"] = "object"
        else:
            del head[how.removeprefix("no ")]
        file.write_text(json.dumps(head))


HEADS = ["truncated", "empty", "binary", "list", "number", "array", "missing", "no members", "format", "config", "hash"]
HEADS += ["layout", "object", "no format", "no config", "no hash", "no layout"]


@pytest.mark.parametrize("how", HEADS)
def test_a_damaged_or_edited_head_is_refused(tmp_path, how):
    path = begun(tmp_path / "a.zarr", [])
    spoil(path, how)
    before = snapshot(tmp_path)
    for message in (refusal(opened, path), refusal(open_dataset, path), refusal(attach, path)):
        assert str(path) in message and "choose another path" in message
    assert snapshot(tmp_path) == before
    if how == "format":
        assert "format 3" in message
    if how in ("config", "hash", "layout", "object"):
        assert "was edited: its hash does not fit" in message


def test_what_is_no_store_is_left_alone(tmp_path):
    (tmp_path / "file.zarr").write_text("text")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "thesis.tex").write_text("text")
    (tmp_path / "empty").mkdir()
    zarr.create_group(tmp_path / "other.zarr", zarr_format=2)
    before = snapshot(tmp_path)
    for name in ("file.zarr", "folder", "empty", "other.zarr"):
        assert str(tmp_path / name) in refusal(opened, tmp_path / name)
        refusal(open_dataset, tmp_path / name)
    refusal(open_dataset, tmp_path / "missing.zarr")
    refusal(attach, tmp_path / "missing.zarr")
    assert snapshot(tmp_path) == before and not (tmp_path / "missing.zarr").exists()


def test_a_damaged_block_is_named_and_its_members_are_missing_without_it(tmp_path):
    path = begun(tmp_path / "a.zarr", range(6))
    begun(path, [8, 9])
    (file,) = (file for file in blocks(path) if file.name.startswith("2-"))
    data = file.read_bytes()
    file.write_bytes(data[:-5] + bytes([data[-5] ^ 1]) + data[-4:])
    for message in (refusal(open_dataset, path), refusal(opened, path)):
        Path(re.match(r"(\S+) is damaged", message).group(1)).exists()
        assert "its checksum does not fit" in message
    file.unlink()
    check(path, range(6))
    with opened(path) as store:
        assert store.missing(make_grid(AXES), [DIGEST] * 18).tolist() == list(range(6, 18))


def test_a_block_of_another_store_is_refused(tmp_path):
    path, other = (
        begun(tmp_path / "a.zarr", [0]),
        begun(tmp_path / "b.zarr", [1], variables={"n": VARIABLES["steps"]}, coords={}),
    )
    (file,) = blocks(other)
    (path / "members" / file.name).write_bytes(file.read_bytes())
    assert f"{file.name} is damaged (it holds another table than the store says)" in refusal(open_dataset, path)


@pytest.mark.parametrize("name", ["beta", "finished", "diverged", "prefix", "a_b"])
def test_names_that_clash_are_refused(name):
    variables = {**VARIABLES, name: Variable((), np.dtype("float32"), ())}
    axes = {"a": [1, 2], "b": [3, 4], "beta": [1]}
    assert repr(name) in refusal(make_layout, axes, (("a", "b"),), variables)


def test_axis_with_a_name_of_the_store_is_refused():
    assert "'finished'" in refusal(make_layout, {"finished": [1, 2]})


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
def test_variables_that_cannot_be_stored_are_refused(name, variable):
    refusal(make_layout, variables={name: variable})


def test_an_open_store_is_not_made_over(tmp_path):
    """Two that create one at the same time: the second finds the first one's, and refuses it if it is another."""
    with opened(tmp_path / "a.zarr"):
        assert "steps is 2000 there and 1 here" in refusal(Store.open, tmp_path / "a.zarr", make_layout(), {"steps": 1})

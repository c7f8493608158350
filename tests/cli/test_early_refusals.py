"""What can be refused is refused before anything is read, rendered or trained, in one line, and leaves nothing."""

import os
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ovibjax.cards import control_study, loading, reproduce
from ovibjax.cli.options import integers, numbers
from ovibjax.errors import InputError
from ovibjax.runtime.outputs import require_place
from tests.cli.cases import said_of_bad_input

MINE = """
axes = {"rate": [0.1, 0.2], "seed": range(2)}
def shared():
    raise AssertionError("the data were prepared")
def member(key, point, shared):
    return {"y": point["rate"]}
"""
COMMANDS = {
    "train": ("sweep", "train"),
    "system": ("sweep", "system"),
    "run": ("sweep", "run", "mine.py"),
    "reproduce": ("reproduce", "--only", "setup"),
}
SWEEPS = [name for name in COMMANDS if name != "reproduce"]


@pytest.fixture
def refused(tmp_path, monkeypatch, capsys):
    """Run a command that must end with one line before any data are prepared, and change no file."""

    def prepared(*_, **__):
        raise AssertionError("the data were prepared")

    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    (tmp_path / "work/mine.py").write_text(MINE)
    for module, name in ((loading, "load_features"), (control_study, "drives_of"), (reproduce, "_load")):
        monkeypatch.setattr(module, name, prepared)

    def run(name, *arguments):
        before = sorted(map(str, tmp_path.rglob("*")))
        said = said_of_bad_input(monkeypatch, capsys, *COMMANDS[name], *arguments)
        assert sorted(map(str, tmp_path.rglob("*"))) == before
        lines = said.strip().splitlines()
        assert len(lines) == 1 and lines[0].startswith("ovibjax: "), said
        return lines[0]

    return run


TWICE = [
    ("train", ("--gamma", "0.1", "1e-1"), "--gamma: 0.1 is given twice"),
    ("train", ("--beta", "0.1", "0.100000000001"), "--beta: 0.100000000001 is given twice"),
    ("train", ("--seed", "0:5", "3:8"), "--seed: 3 is given twice"),
    ("train", ("--prefix", "8", "16", "8"), "--prefix: 8 is given twice"),
    ("system", ("--V", "0", "8", "8.0"), "--V: 8.0 is given twice"),
    ("system", ("--k", "16", "16"), "--k: 16 is given twice"),
    ("run", ("--axis", "rate=0.3,3e-1"), "rate: 0.3 is given twice"),
    ("run", ("--axis", "seed=0:3,2"), "seed: 2 is given twice"),
]


@pytest.mark.parametrize(("name", "arguments", "words"), TWICE)
def test_a_value_that_is_there_already(refused, name, arguments, words):
    assert words in refused(name, *arguments, "--out", "a.zarr")


def test_a_value_that_a_file_has_twice(refused, tmp_path):
    (tmp_path / "work/mine.py").write_text(MINE.replace("[0.1, 0.2]", "[0.1, 0.2, 0.1]"))
    assert "rate: 0.1 is given twice" in refused("run", "--out", "a.zarr")


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("out", ["mine.py/a.zarr", "mine.py/deep/down/a.zarr", "x" * 300])
def test_a_place_that_cannot_be_written(refused, name, out):
    assert "cannot write there" in refused(name, "--out", out)


@pytest.mark.parametrize("name", SWEEPS)
def test_a_store_that_is_none(refused, tmp_path, name):
    (tmp_path / "work/thesis").mkdir()
    (tmp_path / "work/thesis/thesis.tex").write_text("text")
    for out in ("thesis", "mine.py"):
        assert "no store of a sweep" in refused(name, "--out", out)


@pytest.mark.skipif(sys.platform == "win32" or os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_the_right_to_write(tmp_path):
    (tmp_path / "closed").mkdir(mode=0o500)
    with pytest.raises(InputError, match="cannot be written"):
        require_place(tmp_path / "closed/a.zarr")


def test_places_that_can_be_written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("x")
    for path in (tmp_path, "new", "new/deep/down.zarr", "file", tmp_path / "file", "."):
        require_place(path)
    with pytest.raises(InputError, match="--plot"):
        require_place("a\0b", "--plot")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file"]


@given(st.lists(st.floats(width=32, allow_nan=False, allow_infinity=False), min_size=1, max_size=20))
def test_values_once_are_kept_and_values_twice_are_not(values):
    typed = [repr(value) for value in values]
    if len({value + 0.0 for value in values}) == len(values):
        assert numbers("x", typed, lambda value: True, "any") == values
    with pytest.raises(InputError, match="is given twice"):
        numbers("x", [*typed, typed[0]], lambda value: True, "any")


@given(st.sets(st.integers(0, 100), min_size=1, max_size=20))
def test_whole_numbers_once(values):
    typed = list(map(str, values))
    assert integers("seed", typed, 0, 100) == list(values)
    with pytest.raises(InputError, match="is given twice"):
        integers("seed", [*typed, f"{min(values)}:101"], 0, 100)

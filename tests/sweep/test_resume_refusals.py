"""A sweep is not resumed in the store of another one, and nothing there is changed."""

import re
from functools import partial
from pathlib import Path

import jax
import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.sweep import work
from ovibjax.sweep.engine import run
from ovibjax.sweep.grid import Axis
from ovibjax.sweep.head import OtherSweep
from ovibjax.sweep.store import config_of
from ovibjax.sweep.work import Along
from tests.sweep.members import AXES, DATA, begun_store, small, train, tree_hash


@pytest.fixture
def begun(tmp_path):
    return begun_store(tmp_path / "runs" / "a.zarr")


def other_function(key, point, shared):
    return small(key, point, shared)


def refusal(path, **changes):
    options = {"fn": small, "axes": AXES, "shared": DATA, "settings": {"model": "wave"}, **changes}
    before = tree_hash(path.parent)
    with pytest.raises(InputError) as caught:
        run(store=path, **options)
    assert tree_hash(path.parent) == before
    message = str(caught.value)
    assert "\n" not in message and str(path) in message and len(message) < 600, message
    return message


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"axes": {**AXES, "rate": Axis((0.1, 0.2, 0.3), "m")}}, 'axes.rate.unit is "" there and "m" here'),
        ({"axes": {**AXES, "more": [1]}}, "a member's program is another one there"),
        ({"axes": {"rate": AXES["rate"]}}, "a member's program is another one there"),
        ({"settings": {"model": "ripple"}}, 'settings.model is "wave" there and "ripple" here'),
        ({"settings": {}}, "settings.model"),
        ({"settings": {"model": "wave", "steps": 3}}, "settings.steps is absent there and 3 here"),
        ({"shared": {"offset": np.float32(2)}}, "its data are others there"),
        ({"shared": Along("rate", [DATA] * 3)}, "its data are others there"),
        ({"fn": other_function}, "function is"),
        ({"fn": lambda key, point, shared: small(key, point, shared)}, "function is"),
        ({"fn": lambda key, point, shared: {"other": point["rate"]}}, "function is"),
        ({"lanes": 2}, "execution.lanes is 1 there and 2 here"),
        ({"units": {"wave": "m"}}, "variables.wave.unit"),
        ({"dims": {"wave": ["t"]}}, "variables.wave.dims"),
        ({"dims": {"wave": ["t"]}, "coords": {"t": [1, 2, 3]}}, "wave"),
    ],
)
def test_another_sweep_is_refused_and_nothing_changed(begun, changes, words):
    said = refusal(begun, **changes)
    assert words in said and not re.search("[0-9a-f]{16}", said), said  # nobody reads hashes


def test_notes_are_kept_and_not_compared(tmp_path):
    """A file by another name is the same file; its content is compared as data."""
    path = tmp_path / "runs" / "a.zarr"
    for number, name in enumerate(("mine.npz", "./mine.npz", "/home/me/mine.npz", None)):
        notes = None if name is None else {"data": name}
        found = run(small, {**AXES, "rate": AXES["rate"][: number + 1]}, DATA, store=path, notes=notes)
        assert found.finished.all() and config_of(path)["notes"] == {"data": "mine.npz"}
    assert "its data are others" in refusal(
        path, shared={"offset": np.float32(2)}, settings={}, notes={"data": "mine.npz"}
    )


def test_a_store_beside_does_not_depend_on_notes(begun):
    beside = []
    for notes in (None, {"data": "a"}, {"data": "b"}):
        with pytest.raises(OtherSweep) as caught:
            run(small, AXES, DATA, store=begun, settings={"model": "ripple"}, notes=notes)
        beside.append(caught.value.beside)
    assert len(set(beside)) == 1


def test_other_data_along_an_axis_are_refused(tmp_path):
    path = tmp_path / "runs" / "a.zarr"
    data = [{"offset": np.float32(i)} for i in range(3)]
    run(small, {"seed": range(2), "rate": [0.1]}, Along("seed", data[:2]), store=path)
    axes = {"seed": range(3), "rate": [0.1, 0.2]}
    message = refusal(path, axes=axes, shared=Along("seed", [data[0], data[2], data[2]]), settings={})
    assert "seed 1, rate 0.1 saw other data there than here" in message
    assert run(small, axes, Along("seed", data), store=path).finished.all()


def test_another_static_setting_is_refused(tmp_path):
    path = tmp_path / "runs" / "a.zarr"
    data = {"gain": np.float32(0.1)}
    fn = partial(train, steps=3)
    run(fn, AXES, data, store=path)
    assert "a member's program is another one there" in refusal(
        path, fn=partial(train, steps=4), shared=data, settings={}
    )
    run(fn, AXES, data, store=path)


def test_another_version_of_jax_is_refused(begun, monkeypatch):
    version = jax.__version__
    monkeypatch.setattr(work.jax, "__version__", "0.99.1")
    assert f'environment.jax is "{version}" there and "0.99.1" here' in refusal(begun)


def test_what_is_no_store_is_refused(tmp_path):
    path = tmp_path / "thesis"
    path.mkdir()
    (path / "thesis.tex").write_text("text")
    assert "no store of a sweep" in refusal(path)


def test_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("text")
    for path in (tmp_path / "file" / "a.zarr", Path("/proc/a.zarr")):
        with pytest.raises(InputError) as caught:
            run(small, AXES, DATA, store=path)
        assert f"{path}: cannot write (" in str(caught.value) and "\n" not in str(caught.value)

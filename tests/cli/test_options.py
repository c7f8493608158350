"""What several commands share: numbers as typed, misspelt options, the processor, and a store beside another."""

import json
import os
import sys

import numpy as np
import pytest

from ovibjax import sweep
from ovibjax.cli.commands import check_options
from ovibjax.cli.options import integers, kept_in, numbers, shard_of
from ovibjax.cli.processor import settle
from ovibjax.errors import InputError
from ovibjax.sweep.engine import run
from ovibjax.sweep.store import open_dataset


def test_values_are_parsed():
    assert integers("seed", ("0:3", "7"), 0, 9) == [0, 1, 2, 7]
    assert numbers("beta", ("1e-4", "0"), lambda value: value >= 0, "zero or more") == [1e-4, 0.0]
    with pytest.raises(InputError, match="--beta nan"):
        numbers("beta", ("nan",), lambda value: value >= 0, "zero or more")


def test_options_are_checked_per_command():
    check_options(["show", "runs/a.zarr", "--plot=gamma"])
    check_options(["sweep", "train", "--no-keep-params", "--weight_decay", "0"])
    with pytest.raises(InputError, match="did you mean --preset"):
        check_options(["reproduce", "--prset", "full"])


@pytest.fixture
def new_process(monkeypatch):
    """As if jax had not been imported; the environment is given back."""
    monkeypatch.delitem(sys.modules, "jax")
    for name in ("NPROC", "XLA_FLAGS"):
        monkeypatch.setenv(name, "")


@pytest.mark.parametrize(
    ("asked", "begun", "known", "used"),
    [(None, None, "", "8"), (None, 3, "", "3"), (None, 3, "5", "3"), (None, None, "5", "5"), (2, 3, "5", "2")],
)
def test_threads_are_those_that_a_store_was_begun_with(tmp_path, new_process, monkeypatch, asked, begun, known, used):
    monkeypatch.setenv("NPROC", known)
    if begun is not None:
        head = {"config": {"environment": {"threads": begun}}}
        (tmp_path / "sweep.json").write_text(json.dumps(head))
    settle(tmp_path, asked)
    assert os.environ["NPROC"] == used and not os.environ["XLA_FLAGS"]


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"config": 3}', '{"config": {"environment": {"threads": "many"}}}'])
def test_what_is_wrong_with_a_store_is_said_later(tmp_path, new_process, text):
    (tmp_path / "sweep.json").write_text(text)
    settle(tmp_path, None, devices=2)
    assert os.environ["NPROC"] == "8" and "device_count=2" in os.environ["XLA_FLAGS"]


def test_impossible_numbers_of_threads_and_devices(tmp_path):
    for options, words in (({"threads": 0}, "--threads 0"), ({"threads": None, "devices": -1}, "--devices -1")):
        with pytest.raises(InputError, match=f"{words} is not positive"):
            settle(tmp_path, **options)


def compute(path, factor):
    return run(lambda key, point, shared: {"y": point["a"] * shared}, {"a": [1.0, 2.0]}, factor, store=path)


def test_a_second_sweep_is_kept_beside_the_first(tmp_path, capsys):
    """Always at the same place, so that its command goes on there."""
    out = tmp_path / "mine.zarr"
    assert kept_in(out, True, lambda path: compute(path, 2.0))[1] == out
    with pytest.raises(InputError, match="--keep-both"):
        kept_in(out, False, lambda path: compute(path, 3.0))
    (first, beside), (again, same) = (kept_in(out, True, lambda path: compute(path, 3.0)) for _ in range(2))
    assert beside == same != out and beside.parent == tmp_path and beside.name.startswith("mine-")
    assert first.y.values.tolist() == again.y.values.tolist() == [3, 6]
    assert kept_in(out, True, lambda path: compute(path, 5.0))[1] not in (out, beside)
    assert open_dataset(out).y.values.tolist() == [2, 4] and len(list(tmp_path.iterdir())) == 3
    said = " ".join(capsys.readouterr().err.split())
    assert said.count("holds another sweep, which stays; this one is kept in") == 3
    along = [sweep.Along("a", [np.float32(1), np.float32(shift)]) for shift in (2, 3, 4)]
    stores = [kept_in(tmp_path / "b.zarr", True, lambda path, data=data: compute(path, data))[1] for data in along[:2]]
    assert stores[0] != stores[1], "other data along an axis"
    with pytest.raises(InputError, match="saw other data"):
        kept_in(tmp_path / "b.zarr", True, lambda path: compute(path, along[2]))


def test_shards_as_typed():
    assert shard_of(None) is None and shard_of("3/16") == (3, 16) and shard_of("1/1") == (1, 1)
    for given in ("0/2", "3/2", "1", "1/", "a/b", "1/2/3", "-1/2"):
        with pytest.raises(InputError, match=r"--shard .*e\.g\. 3/16"):
            shard_of(given)

"""Searches from the shell: ranges in place of values, drawn points in the store, and what shows them."""

import csv
from pathlib import Path

import numpy as np
import pytest

from ovibjax.cli.search import SearchOptions
from ovibjax.cli.sweep_train import SweepTrain
from ovibjax.sweep.sampling import Range, sobol
from ovibjax.sweep.store import open_dataset
from tests.cli.cases import done_here, said_of_bad_input

MINE = """
import jax

axes = {"rate": [0.1, 0.5], "depth": [1, 2], "kind": ["up", "down"], "low": [0.0], "high": [1.0], "seed": range(2)}
zipped = ["low", "high"]
units = {"cost": "m"}


def member(key, point, shared):
    cost = (jax.numpy.log(point["rate"]) + 3) ** 2 + point["depth"].astype(float)
    return {"cost": cost + 0.1 * jax.random.normal(key)}
"""
SEARCH = ("--axis", "rate=log:0.001:1", "depth=lin:1:64", "kind=down")


@pytest.fixture
def done(tmp_path, monkeypatch, capsys):
    (tmp_path / "mine.py").write_text(MINE)
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: done_here(monkeypatch, capsys, *arguments)


def test_ranges_advance_together_and_cross_with_the_rest(done):
    done("sweep", "run", "mine.py", *SEARCH, "--sobol", 8, "--out", "a.zarr")
    dataset = open_dataset("a.zarr")
    assert dict(dataset.finished.sizes) == {"rate_depth": 8, "kind": 1, "low_high": 1, "seed": 2}
    points = sobol({"rate": Range(1e-3, 1, log=True), "depth": Range(1, 64, whole=True)}, 8)
    assert set(zip(dataset.rate.values, dataset.depth.values, strict=True)) == set(zip(*points.values(), strict=True))
    done("sweep", "run", "mine.py", *SEARCH, "--sobol", 12, "--out", "a.zarr")
    grown = open_dataset("a.zarr")
    assert grown.finished.sum() == 24 and set(points["rate"]) < set(grown.rate.values.tolist())
    done("sweep", "run", "mine.py", *SEARCH, "--random", 12, "--search-seed", 3, "--out", "b.zarr")
    assert set(open_dataset("b.zarr").rate.values.tolist()).isdisjoint(grown.rate.values.tolist())


def test_a_search_is_shown_drawn_exported_and_its_best_point_reruns(done):
    done("sweep", "run", "mine.py", *SEARCH, "--sobol", 16, "--out", "a.zarr")
    shown = done("show", "a.zarr", "--top", 3, "--metric", "cost").splitlines()
    assert "kind = down" in shown[0] and shown[2].split() == ["rate", "depth", "cost", "(m)"] and "±" in shown[4]
    for axes in (("rate",), ("rate", "depth")):
        done("show", "a.zarr", "--metric", "cost", "--plot", *axes, "--out", "a.png")
        assert Path("a.png").read_bytes().startswith(b"\x89PNG")
    done("show", "a.zarr", "--csv", "a.csv")
    rows = list(csv.DictReader(Path("a.csv").read_text().splitlines()))
    assert len(rows) == 32 and {"rate", "depth", "kind", "seed", "cost"} <= set(rows[0])
    best = done("best", "a.zarr", "--minimise", "cost").splitlines()
    command = next(line for line in best if line.startswith("ovibjax sweep run"))
    done(*command.split()[1:])
    one, all_ = open_dataset("a-best.zarr"), open_dataset("a.zarr")
    at = int(np.flatnonzero(all_.rate.values == one.rate.values)[0])
    found = all_.cost.isel(rate_depth=at).transpose("kind", "low_high", "seed").values
    assert found.tobytes() == one.cost.values.tobytes()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--axis", "rate=log:0.1:1"), "--axis rate=log:0.1:1 is a range: add --sobol N, the number of points to draw"),
        (("--sobol", "4"), "--sobol 4: no axis is a range; give one as --axis rate=log:1e-5:1e-1"),
        (("--random", "4"), "--random 4: no axis is a range"),
        (("--search-seed", "4"), "--search-seed 4: it is for --sobol and --random"),
        ((*SEARCH, "--sobol", "0"), "--sobol 0 is not positive"),
        ((*SEARCH, "--sobol", "4", "--random", "4"), "--sobol 4 and --random 4: choose one of the two"),
        ((*SEARCH, "--sobol", "4", "--search-seed", "-1"), "--sobol 4: search seed -1 is negative"),
        (("--axis", "rate=log:0:1", "--sobol", "4"), "--axis rate=log:0:1: a logarithmic range begins above zero"),
        (("--axis", "rate=0.1,log:1:2", "--sobol", "4"), "--axis rate=0.1 log:1:2: give one range, or values"),
        (
            ("--axis", "kind=log:1:2", "--sobol", "4"),
            "--axis kind=log:1:2: its values are no numbers; list them: up, down",
        ),
        (("--axis", "depth=lin:1:2.5", "--sobol", "4"), "--axis depth=lin:1:2.5: a range of whole numbers"),
        (
            ("--axis", "depth=lin:1:2", "--sobol", "4"),
            "--sobol 4: depth from lin:1:2: there are not 4 different points",
        ),
        (("--axis", "low=lin:0:1", "--sobol", "4"), "--axis low: mine.py zips it with high; give a range for both"),
    ],
)
def test_a_search_that_makes_no_sense_is_one_line(done, monkeypatch, capsys, arguments, words):
    said = said_of_bad_input(monkeypatch, capsys, "sweep", "run", "mine.py", *arguments, "--out", "x.zarr")
    assert len(said.strip().splitlines()) == 1 and words in said
    assert not Path("x.zarr").exists()


def test_zipped_axes_may_be_ranges_together(done):
    axes = ("--axis", "low=lin:0:0.5", "high=lin:0.5:1", "kind=up", "depth=1")
    done("sweep", "run", "mine.py", *axes, "--sobol", 4, "--out", "a.zarr")
    assert dict(open_dataset("a.zarr").finished.sizes) == {"rate": 2, "depth": 1, "kind": 1, "low_high": 4, "seed": 2}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--lr", "lin:0:1", "--sobol", "4"), "--lr lin:0:1: values are positive"),
        (("--weight-decay", "lin:-1:1", "--sobol", "4"), "--weight-decay lin:-1:1: values are zero or more"),
        (("--nesting", "lin:0:2", "--sobol", "4"), "--nesting lin:0:2: values are between 0 and 1"),
        (("--beta", "1e-3", "log:1:2", "--sobol", "4"), "--beta 1e-3 log:1:2: give one range, or values"),
        (("--beta", "log:1e-3:1"), "--beta log:0.001:1 is a range: add --sobol N"),
        (("--sobol", "4"), "--sobol 4: no axis is a range; give one as --alpha log:1e-5:1e-1"),
    ],
)
def test_impossible_ranges_of_a_training_are_one_line(tmp_path, monkeypatch, capsys, arguments, words):
    said = said_of_bad_input(monkeypatch, capsys, "sweep", "train", *arguments, "--out", tmp_path / "x.zarr")
    assert len(said.strip().splitlines()) == 1 and words in said


def test_the_command_of_the_documentation_asks_for_what_it_says():
    command = SweepTrain(
        Path("x.zarr"),
        beta=("log:1e-5:1e-1",),
        gamma=("log:1e-3:10",),
        lr=("log:3e-4:1e-2",),
        search=SearchOptions(256),
    )
    axes = command._axes()
    assert axes["beta"] == Range(1e-5, 0.1, log=True) and axes["alpha"] == [1.0] and axes["seed"] == [0, 1, 2]

"""Halving of somebody's own function from the shell, and how its store is looked at."""

from pathlib import Path

import pytest

from ovibjax.sweep.store import open_dataset
from tests.cli.cases import done_here, said_of_bad_input

CUT = """
import jax
import jax.numpy as jnp

axes = {"rate": [0.1, 0.3, 0.5, 0.7, 0.9, 1.5], "decay": [0.5, 0.9], "kind": ["up"], "seed": range(2)}
units, score, steps = {"loss": "m"}, "loss", 27


def begin(key, point, shared):
    return {"w": jax.random.normal(key, (8,)), "m": jnp.zeros(8)}


def go_on(key, point, shared, state, first, last):
    def step(i, s):
        m = point["decay"] * s["m"] + s["w"] + 0.05 * jax.random.normal(jax.random.fold_in(key, i), (8,))
        return {"w": s["w"] - 0.1 * point["rate"] * m, "m": m}

    return jax.lax.fori_loop(first, last, step, state)


def judge(key, point, shared, state):
    return {"loss": (state["w"] ** 2).mean(), "norm": jnp.abs(state["w"]).sum(), "test": state["w"].sum()}
"""
PLAIN = "axes = {'x': [1.0, 2.0]}\ndef member(key, point, shared):\n    return {'loss': point['x']}\n"


@pytest.fixture
def done(tmp_path, monkeypatch, capsys):
    (tmp_path / "cut.py").write_text(CUT)
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        monkeypatch.setenv("COLUMNS", "200")
        monkeypatch.setattr("sys.argv", ["ovibjax", *map(str, arguments)])
        from ovibjax.cli.main import main

        main()
        said = capsys.readouterr()
        return said.out, " ".join(said.err.split())

    return run


def test_a_file_in_stages_is_halved_shown_and_its_best_point_trained_alone(done):
    _, said = done("sweep", "run", "cut.py", "--halving", 3, "--out", "a.zarr")
    line = "12, 4 and 1 points of 2 seeds trained for 3, 9 and 27 steps; 24% of the steps of all of them: a.zarr"
    assert line in said and "look at the last: ovibjax show a.zarr --where steps=27" in said
    shown, _ = done("show", "a.zarr", "--where", "steps=9", "--metric", "loss", "--top", 2)
    assert "kind = up" in shown and shown.splitlines()[2].split()[:2] == ["rate", "decay"] and "steps = 9" in shown
    best, _ = done("best", "a.zarr", "--minimise", "loss")
    assert "among points trained for 27 steps" in best and "steps = 27" in best.splitlines()[0]
    command = best.splitlines()[-1]
    assert command.startswith("ovibjax sweep run cut.py --axis rate=") and "steps=" not in command
    done(*command.split()[1:])
    alone, dataset = open_dataset("a-best.zarr"), open_dataset("a.zarr")
    end = dataset.loss.isel(rate_decay_steps=int(dataset.steps.argmax("rate_decay_steps")))
    assert end.values.tobytes() == alone.loss.transpose("kind", "seed", ...).values.tobytes()
    others, _ = done("best", "a.zarr", "--minimise", "loss", "--where", "steps=3")
    assert "of 12; means" in others
    for axes in (("steps",), ("rate", "decay")):
        done("show", "a.zarr", "--metric", "loss", "--plot", *axes, "--out", "a.png")
    done("show", "a.zarr", "--csv", "a.csv")
    assert len(Path("a.csv").read_text().splitlines()) == 35


def test_a_file_in_stages_is_an_ordinary_sweep_too(done):
    _, said = done("sweep", "run", "cut.py", "--axis", "seed=0", "--out", "a.zarr")
    assert "12 members" in said and "steps" not in open_dataset("a.zarr").coords
    search = ("--sobol", 8, "--axis", "rate=log:0.1:1", "decay=0.5")
    done("sweep", "run", "cut.py", "--halving", 2, "--rungs", 2, "--score", "norm", *search, "--out", "b.zarr")
    assert open_dataset("b.zarr").attrs["config"]["halving"] == {"factor": 2, "steps": [14, 27], "score": "norm"}


def changed(old, new):
    assert old in CUT
    return CUT.replace(old, new)


@pytest.mark.parametrize(
    ("text", "arguments", "words"),
    [
        (PLAIN, ("--halving", 3), "mine.py: member cannot be cut; for --halving define begin, go_on, judge and steps"),
        (CUT + PLAIN, (), "mine.py: there is member, and there are begin, go_on, judge; define the one or the others"),
        (
            changed("def judge", "def judged"),
            (),
            "mine.py: judge(key, point, shared, state) is missing; there is begin",
        ),
        (changed('"loss", 27', '"loss", "27"'), (), "mine.py: steps is a str; it is a whole"),
        (CUT + "del steps\n", (), "mine.py: steps is missing; it is a whole number, of the steps that go_on counts"),
        (CUT + "every = 2\n", (), "mine.py: a training of 27 steps cannot be cut at every 2"),
        (CUT + "score = 3\n", (), "mine.py: score is no name"),
        (changed('"loss", 27', "None, 27"), ("--halving", 3), "say by which output --halving chooses: score = NAME"),
        (CUT, ("--halving", 3, "--score", "test"), "score test: chosen by a test"),
        (CUT, ("--halving", 3, "--score", "los"), "score los: there is no such output; there are loss, norm, test"),
        (CUT, ("--halving", 3, "--rungs", 9), "9 rungs by 3: a training of 27 pieces cannot be cut so often"),
        (CUT, ("--halving", 3, "--shard", "1/2"), "--shard 1/2: --halving compares all points"),
        (CUT, ("--score", "loss"), "--score loss: it is for --halving"),
        (CUT, ("--halving", 3, "--axis", "rate=1", "decay=1"), "there is only one; give an axis several values"),
        (changed("fori_loop(first, last", "fori_loop(0, int(last)"), (), "mine.py: go_on cannot be traced"),
        (changed('{"w": s["w"] - 0.1', '{"v": s["w"] - 0.1'), (), "mine.py: go_on fails: mine.py, line"),
        (
            changed("step, state)", "step, state) | {'n': 1}"),
            (),
            "sweep_file.mine.member: go_on gives a state of another",
        ),
        (changed('return {"loss"', 'return 3\n    return {"loss"'), (), "mine.py: judge returns an int"),
    ],
)
def test_what_cannot_be_halved_is_one_line(done, monkeypatch, capsys, text, arguments, words):
    Path("mine.py").write_text(text)
    said = said_of_bad_input(monkeypatch, capsys, "sweep", "run", "mine.py", *arguments, "--out", "x.zarr")
    assert len(said.strip().splitlines()) == 1 and words in said, said
    assert not Path("x.zarr").exists()


def test_help_teaches(monkeypatch, capsys):
    said = " ".join(done_here(monkeypatch, capsys, "sweep", "run", "--help").split())
    for word in ("--sobol", "--halving", "go_on(key, point, shared, state, first, last)", "judge(", "--score"):
        assert word in said

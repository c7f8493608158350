"""`ovibjax sweep run`: somebody's own function from the shell, and the example that comes with the software."""

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from ovibjax.cli import sweep_run
from ovibjax.cli.file_axes import asked_axes
from ovibjax.cli.main import main
from ovibjax.cli.sweep_run import SweepRun
from ovibjax.errors import InputError
from ovibjax.report.best import choose, command
from ovibjax.sweep.from_file import read_sweep_file
from ovibjax.sweep.store import config_of, open_dataset
from tests.cli.cases import ROOT, done_here, ovibjax, said_of_bad_input
from tests.ctrl_c import ctrl_c_interrupts

MINE = """
import jax
import numpy as np

STEPS = 3
axes = {"rate": [0.1, 0.5], "kind": ["up", "down"], "flag": [True], "seed": range(2)}
units = {"drawn": "m"}
settings = {"model": "mine"}


def shared():
    return {"offset": np.float32(1)}


def member(key, point, shared):
    value = jax.lax.fori_loop(0, STEPS, lambda i, x: x * point["rate"], jax.random.normal(key))
    return {"drawn": jax.numpy.where(point["kind"] == 0, value, -value) + shared["offset"]}
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working folder with the file in it."""
    (tmp_path / "mine.py").write_text(MINE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def done(monkeypatch, capsys):
    """Run a command that must succeed, and give what it says."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["ovibjax", "sweep", "run", *map(str, arguments)])
        main()
        return " ".join(capsys.readouterr().err.split())

    return run


@pytest.fixture
def refused(monkeypatch, capsys):
    """Run a command that must end with exit code 2, and give its one line."""

    def run(*arguments):
        said = said_of_bad_input(monkeypatch, capsys, "sweep", "run", *arguments)
        assert len(said.strip().splitlines()) == 1, said
        return said

    return run


def test_a_file_becomes_a_store_and_the_same_command_computes_nothing(folder, done):
    before = list(sys.path)
    assert "8 members: a.zarr look at them: ovibjax show a.zarr" in done("mine.py", "--out", "a.zarr")
    dataset = open_dataset("a.zarr")
    assert dict(dataset.sizes) == {"rate": 2, "kind": 2, "flag": 1, "seed": 2} and dataset.drawn.attrs["units"] == "m"
    up, down = dataset.drawn.sel(kind="up").values, dataset.drawn.sel(kind="down").values
    np.testing.assert_allclose(up + down, 2, atol=1e-6)
    config = config_of("a.zarr")
    assert config["settings"] == {"model": "mine"} and config["function"] == "sweep_file.mine.member"
    written = {path: path.stat().st_mtime_ns for path in (folder / "a.zarr").rglob("*") if path.is_file()}
    done("mine.py", "--out", "a.zarr")
    assert written == {path: path.stat().st_mtime_ns for path in (folder / "a.zarr").rglob("*") if path.is_file()}
    assert sys.path == before and {path.name for path in folder.iterdir()} >= {"a.zarr", "mine.py"}
    assert "12 members (8 of them were there): a.zarr" in done("mine.py", "--axis", "seed=0:3", "--out", "a.zarr")
    assert "4 members (4 of them were there): a.zarr" in done("mine.py", "--axis", "seed=2", "--out", "a.zarr")
    assert dict(open_dataset("a.zarr").sizes) == {"rate": 2, "kind": 2, "flag": 1, "seed": 3}


def test_axes_take_other_values(folder, done):
    done("mine.py", "--out", "a.zarr")
    axes = ("--axis", "rate=0.5,2", "kind=down", "--axis", "seed=1:4")
    assert "6 members" in done("mine.py", "--out", "b.zarr", *axes)
    whole, part = open_dataset("a.zarr"), open_dataset("b.zarr")
    assert part.rate.values.tolist() == [0.5, 2.0] and part.seed.values.tolist() == [1, 2, 3]
    assert part.kind.values.tolist() == ["down"] and part.flag.values.tolist() == [True]
    point = {"rate": 0.5, "kind": "down", "seed": 1}
    np.testing.assert_allclose(part.drawn.sel(point), whole.drawn.sel(point), rtol=1e-6)


def test_values_are_read_as_the_files_are(folder):
    (folder / "mine.py").write_text(MINE + "axes = {'x': [0.1, 1 / 3], 'n': [1], 'flag': [True], 'name': ['a,b', 'c']}")
    file = read_sweep_file(Path("mine.py"))
    asked = asked_axes(("x=0.33333334,7", "n=-2:1,5", "flag=False,1", "name=a,b"), file)
    values = {name: list(axis.values) for name, axis in asked.items()}
    assert values == {"x": [1 / 3, 7.0], "n": [-2, -1, 0, 5], "flag": [False, True], "name": ["a,b"]}
    assert list(asked_axes(("name=c,a,b",), file)["name"].values) == ["c", "a,b"]
    with pytest.raises(InputError, match="name=a: no such name"):
        asked_axes(("name=a,c",), file)
    with pytest.raises(InputError, match="values of n are given twice"):
        asked_axes(("n=1", "n=2"), file)


def test_another_sweep_on_the_same_store_is_refused(folder, done, refused):
    done("mine.py", "--out", "a.zarr")
    for old, new, words in (
        ("STEPS = 3", "STEPS = 4", "program is"),
        ('"model": "mine"', '"model": "other"', 'settings.model is "mine" there and "other" here'),
        ("np.float32(1)", "np.float32(2)", "its data are others there"),
    ):
        assert old in MINE
        (folder / "mine.py").write_text(MINE.replace(old, new))
        assert words in refused("mine.py", "--out", "a.zarr")


def test_ctrl_c_keeps_what_is_finished_and_the_same_command_goes_on(folder, done, monkeypatch):
    @contextmanager
    def interrupted_at_three(*_):
        def update(finished, total):
            if finished == 3:
                raise KeyboardInterrupt

        yield update

    with monkeypatch.context() as patched:
        patched.setattr(sweep_run, "progress_bar", interrupted_at_three)
        with pytest.raises(KeyboardInterrupt, match=r"3 of 8 members are in a\.zarr: repeat the command to go on"):
            SweepRun(Path("mine.py"), Path("a.zarr"), lanes=1).run()
    assert int(open_dataset("a.zarr").finished.sum()) == 3
    done("mine.py", "--out", "a.zarr")
    done("mine.py", "--out", "whole.zarr", "--lanes", "1")
    one, other = open_dataset("a.zarr"), open_dataset("whole.zarr")
    assert one.finished.all() and one.drawn.values.tobytes() == other.drawn.values.tobytes()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("none.py",), "none.py: no such file"),
        (("broken.py",), "broken.py: does not import: broken.py, line 2: ZeroDivisionError"),
        (("bare.py",), "bare.py: member is missing"),
        (("wrong.py",), "wrong.py: member cannot be traced"),
        (("named.py",), "there is no output 'lost'; there are y"),
        (("mine.py", "--axis", "rate"), "--axis rate: write NAME=VALUE,VALUE (axes: rate, kind, flag, seed)"),
        (("mine.py", "--axis", "rtae=1"), "--axis rtae=1: mine.py has no axis rtae; did you mean rate? it has rate,"),
        (("mine.py", "--axis", "rate=x"), "--axis rate x: not a number"),
        (("mine.py", "--axis", "rate=0.1,0.1"), "rate: 0.1 is given twice"),
        (("mine.py", "--axis", "rate=1e39"), "--axis rate 1e39: values are numbers of 32 bits"),
        (("mine.py", "--axis", "seed=0.5"), "--axis seed 0.5: not a whole number or a range"),
        (("mine.py", "--axis", "kind=left"), "--axis kind=left: no such name; the file has up, down"),
        (("mine.py", "--axis", "flag=maybe"), "--axis flag=maybe: values are true and false"),
        (("mine.py", "--axis", "seed=1", "--axis", "seed=2"), "values of seed are given twice"),
        (("mine.py", "--address", "x"), "--address is for --on ray"),
        (("mine.py", "--devices", "0"), "--devices 0 is not positive"),
        (("mine.py", "--shard", "0/4"), "--shard 0/4: give i/n"),
        (("mine.py", "--lanes", "0"), "--lanes 0 is not positive"),
        (("mine.py", "--axes", "rate=1"), "--axes: sweep run has no such option; did you mean --axis?"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(folder, refused, arguments, words):
    (folder / "broken.py").write_text("\nx = 1 / 0\n")
    (folder / "bare.py").write_text("axes = {'x': [1]}\n")
    head = "axes = {'x': [1]}\ndef member(key, point, shared):\n    "
    (folder / "wrong.py").write_text(head + "return {'y': [][point['x']]}\n")
    (folder / "named.py").write_text(head + "return {'y': point['x']}\nunits = {'lost': 'm'}\n")
    assert words in refused(*arguments, "--out", "x.zarr")
    assert not (folder / "x.zarr").exists()


def test_a_host_function_that_raises_is_told(folder, monkeypatch, capsys):
    (folder / "host.py").write_text(
        "import jax, numpy as np\naxes = {'x': [1.0]}\ndef lost(x):\n    raise ValueError('on the host')\n"
        "def member(key, point, shared):\n    spec = jax.ShapeDtypeStruct((), np.float32)\n"
        "    return {'y': jax.pure_callback(lost, spec, point['x'])}\n"
    )
    said = said_of_bad_input(monkeypatch, capsys, "sweep", "run", "host.py", "--out", "x.zarr")  # jax tells it as well
    last = [line for line in said.splitlines() if line.startswith("ovibjax: ")]
    assert len(last) == 1 and "host.py: the program failed as it ran (ValueError: on the host)" in last[0]


def test_a_traceback_is_shown_where_it_is_asked_for(folder, monkeypatch, capsys):
    (folder / "broken.py").write_text("\nx = 1 / 0\n")
    said = said_of_bad_input(monkeypatch, capsys, "sweep", "run", "broken.py", "--out", "x.zarr", "--traceback")
    assert "Traceback" in said and said.strip().endswith("ZeroDivisionError: division by zero")


def test_help_teaches(monkeypatch, capsys):
    said = done_here(monkeypatch, capsys, "sweep", "run", "--help")
    words = ("def member(key, point, shared):", "shared(axes)", "examples/digits.py", "seed=0:5 is", "--traceback")
    assert all(word in " ".join(said.split()) for word in words), said


def test_the_best_point_comes_with_its_command(folder, done):
    done("mine.py", "--out", "a.zarr")
    found = choose(open_dataset("a.zarr"), "drawn", over="seed")
    line = command(config_of("a.zarr"), ["rate", "kind", "flag", "seed"], found.point, found.over, "best.zarr")
    kind = found.point["kind"]
    assert line.startswith("ovibjax sweep run mine.py --axis rate=") and f"kind={kind} flag=True seed=0,1" in line
    assert "2 members" in done(*line.split()[3:])


def test_the_guide_holds_the_example():
    text = (ROOT / "examples/digits.py").read_text()
    assert f"```python\n{text}```" in (ROOT / "docs/sweeps.md").read_text()
    assert len(text.splitlines()) <= 42 and "ovibjax" not in text


@pytest.mark.slow
def test_the_example_learns_digits(tmp_path):
    pytest.importorskip("sklearn")
    axes = ("--axis", "l2=1e-4,0.1", "rate=1", "seed=0:2")
    command = ("sweep", "run", ROOT / "examples/digits.py", "--out", "digits.zarr", *axes)
    ended = ovibjax(*command, cwd=tmp_path, cache=tmp_path / "cache")
    assert ended.returncode == 0, ended.stderr
    dataset = open_dataset(tmp_path / "digits.zarr")
    good, flat = (dataset.test_accuracy.sel(l2=l2, rate=1.0).values for l2 in (1e-4, 0.1))
    assert (good > 0.9).all() and (flat < good).all() and (dataset.loss.diff("step").mean("step") < 0).all()
    shown = ovibjax("show", "digits.zarr", "--metric", "test_accuracy", cwd=tmp_path)
    assert shown.returncode == 0 and "0.0001" in shown.stdout


@pytest.mark.slow
def test_ctrl_c_in_a_process_of_its_own(folder):
    (folder / "mine.py").write_text(MINE.replace("STEPS = 3", "STEPS = 3_000_000").replace("range(2)", "range(4000)"))
    arguments = [sys.executable, "-m", "ovibjax", "sweep", "run", "mine.py", "--out", "a.zarr", "--lanes", "1"]
    with ctrl_c_interrupts():
        running = subprocess.Popen(
            arguments, stderr=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": str(ROOT)}
        )
    until = time.monotonic() + 120
    while not ((folder / "a.zarr").exists() and int(open_dataset("a.zarr").finished.sum()) >= 2):
        assert running.poll() is None and time.monotonic() < until
        time.sleep(0.1)
    running.send_signal(signal.SIGINT)
    _, said = running.communicate(timeout=100)
    assert running.returncode == 130 and "repeat the command to go on" in " ".join(said.split()), said
    assert 2 <= int(open_dataset("a.zarr").finished.sum()) < 160

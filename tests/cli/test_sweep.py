"""`ovibjax sweep train` and `ovibjax show`, as a user runs them."""

import csv
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from ovibjax.cli.sweep_train import SweepTrain
from ovibjax.runtime import precision_choice
from ovibjax.sweep import program
from ovibjax.sweep.engine import run
from ovibjax.sweep.store import open_dataset
from tests.cli.cases import done_here, ovibjax, said_of_bad_input
from tests.ctrl_c import ctrl_c_interrupts

AXES = ("--gamma", "0", "0.1", "--beta", "1e-3", "--seed", "0:2", "--prefix", "4", "8", "--latent", "8")


@pytest.fixture(scope="module")
def features(tmp_path_factory):
    """A small feature set: smooth functions of the position, five views of 12 coordinates."""
    rng = np.random.default_rng(0)
    position = np.cumsum(rng.normal(size=(240, 3)), axis=0).astype(np.float32)
    waves = np.cos(position @ rng.normal(size=(3, 60)) * 0.2 + rng.uniform(0, 6, 60))
    path = tmp_path_factory.mktemp("data") / "features.npz"
    np.savez(path, features=waves.reshape(240, 5, 12).astype(np.float32), positions_m=position)
    return path


@pytest.fixture
def refused(monkeypatch, capsys):
    """Run a command that must end with one line and exit code 2."""

    def run(*arguments):
        said = said_of_bad_input(monkeypatch, capsys, *arguments)
        lines = [line for line in said.splitlines() if line.startswith("ovibjax:")]
        assert len(lines) == 1
        return lines[0]

    return run


@pytest.fixture(scope="module")
def store(features, tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "mine.zarr"
    done = ovibjax("sweep", "train", *AXES, "--steps", 20, "--batch", 32, "--data", features, "--out", out)
    assert done.returncode == 0, done.stderr
    assert "4 members" in done.stderr and f"ovibjax show {out}" in done.stderr.replace("\n", "")
    return out


def test_data_by_another_name_go_on_in_the_same_store(features, store, tmp_path, monkeypatch, capsys):
    """The content is what counts: a relative path, a link, a copy elsewhere."""
    monkeypatch.chdir(features.parent)
    (tmp_path / "link.npz").symlink_to(features)
    shutil.copy(features, tmp_path / "copy.npz")
    for data in (
        features.name,
        f"./{features.name}",
        f"../{features.parent.name}/{features.name}",
        tmp_path / "copy.npz",
    ):
        done_here(
            *(monkeypatch, capsys, "sweep", "train", *AXES, "--steps", "20", "--batch", "32"),
            *("--data", str(data), "--out", str(store)),
        )
    assert open_dataset(store).finished.all()


def test_every_point_is_trained_and_judged(store):
    dataset = open_dataset(store)
    assert dict(dataset.sizes) | {"gamma": 2, "beta": 1, "seed": 2, "prefix": 2, "mode": 1} == dict(dataset.sizes)
    assert bool(dataset.finished.all()) and not bool(dataset.diverged.any())
    assert np.isfinite(dataset.test_mean_m).all() and dataset.test_mean_m.attrs["units"] == "m"
    # Nothing but gamma differs between paired members.
    assert (dataset.orthogonality.isel(gamma=0) != dataset.orthogonality.isel(gamma=1)).all()


def test_show_prints_a_table_and_writes_csv_and_plot(store, tmp_path, monkeypatch, capsys):
    shown = ovibjax("show", store, "--metric", "test_mean_m", "--where", "prefix=8")
    assert shown.returncode == 0 and "test_mean_m" in shown.stdout and "0.1" in shown.stdout
    done_here(monkeypatch, capsys, "show", store, "--csv", tmp_path / "a" / "mine.csv")
    rows = list(csv.DictReader((tmp_path / "a" / "mine.csv").read_text().splitlines()))
    assert len(rows) == 2 * 2 * 2 and {float(row["gamma"]) for row in rows} == {0.0, 0.1}
    plot = ("--metric", "test_mean_m", "--plot", "gamma", "--hue", "prefix", "--out", tmp_path / "p.png")
    done_here(monkeypatch, capsys, "show", store, *plot)
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")


def files_of(store):
    return sorted((path, path.stat().st_mtime_ns) for path in store.rglob("*") if path.is_file())


def test_another_sweep_on_the_same_store_is_refused_and_named(store, features, refused):
    before = files_of(store)
    said = refused("sweep", "train", *AXES, "--steps", 40, "--batch", 32, "--data", features, "--out", store)
    assert "settings.steps is 20 there and 40 here" in said and "--keep-both" in said
    assert before == files_of(store)


def test_shards_grow_a_store_and_are_merged(store, features, tmp_path, monkeypatch, capsys):
    """Another gamma and a third seed, in two shards of which each has a store of its own."""
    precision = open_dataset(store).attrs["config"]["settings"]["precision"]
    command = ("sweep", "train", *AXES, "--gamma", 0, 0.1, 1, "--seed", "0:3", "--steps", 20, "--batch", 32)
    command += ("--precision", precision)
    for i in (2, 1):
        out = ("--data", features, "--out", tmp_path / f"{i}.zarr", "--shard", f"{i}/2")
        done_here(monkeypatch, capsys, *command, *out)
    assert [int(open_dataset(tmp_path / f"{i}.zarr").finished.sum()) for i in (1, 2)] == [5, 4]
    both = (tmp_path / "1.zarr", tmp_path / "2.zarr")
    done_here(monkeypatch, capsys, "sweep", "merge", *both, "--out", tmp_path / "all.zarr")
    done_here(monkeypatch, capsys, "sweep", "merge", tmp_path / "all.zarr", store, "--out", tmp_path / "all.zarr")
    whole, first = open_dataset(tmp_path / "all.zarr"), open_dataset(store)
    assert whole.finished.all() and whole.finished.size == 9
    part = whole.sel(gamma=first.gamma, seed=first.seed)
    for name in first.data_vars:
        assert part[name].values.tobytes() == first[name].values.tobytes(), name


@pytest.mark.parametrize("begun_with", ["float32", "bfloat16"])
def test_a_store_goes_on_with_the_operands_it_was_begun_with(tmp_path, monkeypatch, begun_with):
    out = tmp_path / "mine.zarr"
    other = {"float32": "bfloat16", "bfloat16": "float32"}[begun_with]
    monkeypatch.setattr(precision_choice, "faster_precision", lambda: begun_with)
    assert SweepTrain(out)._precision() == begun_with and SweepTrain(out, precision=other)._precision() == other
    run(lambda key, point, shared: {"y": point["a"]}, {"a": [1.0]}, store=out, settings={"precision": begun_with})
    monkeypatch.setattr(precision_choice, "faster_precision", lambda: other)
    assert SweepTrain(out)._precision() == begun_with and SweepTrain(out, precision=other)._precision() == other


def test_the_operands_are_in_the_store(store, features, refused):
    precision = open_dataset(store).attrs["config"]["settings"]["precision"]
    other = {"float32": "bfloat16", "bfloat16": "float32"}[precision]
    command = ("sweep", "train", *AXES, "--steps", 20, "--batch", 32, "--data", features, "--out", store)
    assert "settings.precision is" in refused(*command, "--precision", other)


@pytest.mark.slow
def test_halving_trains_the_best_third_to_the_end(features, tmp_path, monkeypatch, capsys):
    """And the winner has the bits of the same point trained alone."""
    out, axes = tmp_path / "h.zarr", ("--gamma", "0", "--seed", "0:2", "--prefix", "8", "--latent", "8")
    search = ("--sobol", 7, "--beta", "log:1e-4:10", "--lr", "log:1e-3:1e-2", "--halving", 3)
    common = ("--steps", 40, "--batch", 32, "--data", features)
    before = program.compilations
    done_here(monkeypatch, capsys, "sweep", "train", *axes, *search, *common, "--out", out)
    compiled = program.compilations
    assert compiled <= before + 3  # a program a stage
    dataset = open_dataset(out)
    assert dataset.finished.all() and dict(dataset.finished.sizes) == {
        "alpha": 1,
        "beta_lr_steps": 10,
        "gamma": 1,
        "weight_decay": 1,
        "nesting": 1,
        "seed": 2,
    }
    said = done_here(monkeypatch, capsys, "best", out, "--minimise", "val_mean_m").splitlines()
    assert any("among points trained for 40 steps" in line for line in said)
    command = next(line for line in said if line.startswith("ovibjax sweep train")).split()
    assert "--halving" not in command and command.count("--steps") == 1
    alone = tmp_path / "alone.zarr"
    command[command.index("--out") + 1] = str(alone)
    done_here(monkeypatch, capsys, *command[1:], "--data", features)
    one, end = open_dataset(alone), dataset.isel(beta_lr_steps=np.flatnonzero(dataset.steps == 40))
    at = int(np.flatnonzero(end.beta.values == one.beta.values)[0])
    assert program.compilations == compiled
    for name in one.data_vars:
        found = one[name].isel(beta=0, lr=0).transpose("seed", ...).values
        assert found.tobytes() == end[name].isel(beta_lr_steps=at).transpose("seed", ...).values.tobytes(), name


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--halving", "1"), "--halving 1: one point in so many goes on, so give 2 or more"),
        (("--rungs", "2"), "--rungs 2: it is for --halving"),
        (("--halving", "3", "--rungs", "0"), "--rungs 0 is not positive"),
        (("--halving", "3", "--shard", "1/2"), "--shard 1/2: --halving compares all points; leave one of the two out"),
        (("--halving", "3", "--on", "ray"), "--on ray: --halving runs on this machine; leave one of the two out"),
        (("--bta", "1"), "--bta: sweep train has no such option; did you mean --beta?"),
        (("--gamma", "-1"), "--gamma -1: values are zero or more"),
        (("--beta", "abc"), "--beta abc: not a number"),
        (("--seed", "3:3"), "--seed 3:3: the range is empty"),
        (("--prefix", "9", "--latent", "8"), "--prefix 9: values are 1 to 8"),
        (("--mode", "A6"), "--mode A6"),
        (("--address", "x"), "--address is for --on ray"),
        (("--shard", "3/2"), "--shard 3/2: give i/n with i from 1 to n, e.g. 3/16"),
        (("--shard", "one"), "--shard one: give i/n"),
    ],
)
def test_a_misspelt_axis_or_impossible_value_is_one_line(features, tmp_path, refused, arguments, named):
    out = tmp_path / "x.zarr"
    assert named in refused("sweep", "train", "--data", features, "--out", out, *arguments)
    assert not out.exists()


def test_show_of_nothing_is_one_line(tmp_path, refused):
    assert "no store" in refused("show", tmp_path / "none.zarr")


@pytest.mark.long
def test_ctrl_c_keeps_finished_members_and_the_same_command_goes_on(features, tmp_path):
    out = tmp_path / "long.zarr"
    arguments = ("sweep", "train", *AXES, "--seed", "0:8", "--steps", "1500", "--batch", "32")
    command = [sys.executable, "-m", "ovibjax", *arguments, "--data", features, "--out", out]
    with ctrl_c_interrupts():
        running = subprocess.Popen(list(map(str, command)), stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 200
    while len(list((out / "members").glob("*.npy"))) < 2:
        assert time.monotonic() < deadline and running.poll() is None
        time.sleep(0.05)
    running.send_signal(signal.SIGINT)
    _, said = running.communicate(timeout=100)
    assert running.returncode == 130 and "repeat the command to go on" in " ".join(said.split())
    kept = int(open_dataset(out).finished.sum())
    assert 2 <= kept < 16
    done = ovibjax(*arguments, "--data", features, "--out", out)
    assert done.returncode == 0 and bool(open_dataset(out).finished.all())


@pytest.mark.long
def test_devices_split_the_processor(features, tmp_path):
    out = tmp_path / "two.zarr"
    environment = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    arguments = ("sweep", "train", *AXES, "--steps", 20, "--batch", 32, "--data", features, "--out", out)
    done = ovibjax(*arguments, "--devices", 2, env=environment)
    assert done.returncode == 0, done.stderr
    done = ovibjax(*arguments, "--gamma", 0, 0.1, 1, env=environment)  # goes on with one
    assert done.returncode == 0 and open_dataset(out).finished.size == 6, done.stderr


@pytest.mark.slow
def test_training_for_bits_says_what_codes_take(features, tmp_path, monkeypatch, capsys):
    out, axes = tmp_path / "bits.zarr", ("--beta", "1e-4", "0.3", "--seed", "0", "--prefix", "4", "8", "--latent", "8")
    common = ("--steps", "60", "--batch", "32", "--data", features, "--prior", "bits", "--out", out)
    done_here(monkeypatch, capsys, "sweep", "train", *axes, *common)
    found = open_dataset(out)
    assert found.code_bits.attrs["units"] == found.rate.attrs["units"] == "bits"
    assert found.code_bits.dims == found.val_mean_m.dims
    cheap, dear = (found.code_bits.sel(beta=beta).squeeze().values for beta in (1e-4, 0.3))
    assert (cheap[1] > cheap[0] > 0) and (dear < cheap).all()

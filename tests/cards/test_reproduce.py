"""The command line end to end: the smallest preset, somebody else's data, bad input, interruption."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ovibjax.cards.catalog import card_names, cards_folder, load_card
from ovibjax.cli.main import main
from ovibjax.features.feature_files import save
from ovibjax.features.frames import make_feature_set

TABLE_COLUMNS = ["method", "k", "seed", "payload_bytes", "mean_m", "p90_m", "eta"]


@pytest.fixture(scope="session")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


def ovibjax(*arguments: str, cache: Path, cwd: Path, timeout: float = 600) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "OVIBJAX_CACHE": str(cache), "COLUMNS": "200"}
    command = [sys.executable, "-m", "ovibjax", *arguments]
    return subprocess.run(command, capture_output=True, text=True, env=environment, cwd=cwd, timeout=timeout)


def write_set(path: Path, n: int = 240, n_views: int = 5, dim: int = 24) -> None:
    rng = np.random.default_rng(0)
    position = rng.uniform(-50, 50, (n, 3)).astype(np.float32)
    mix = rng.normal(size=(3, n_views * dim))
    features = np.tanh(position @ mix / 30).reshape(n, n_views, dim) + 0.05 * rng.normal(size=(n, n_views, dim))
    save(path, make_feature_set(features, position))


def check_outputs(folder: Path) -> list[dict[str, str]]:
    with (folder / "table.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == TABLE_COLUMNS
    for row in rows:
        assert np.isfinite([float(row[name]) for name in ("payload_bytes", "mean_m", "p90_m", "eta")]).all()
    assert {row["method"] for row in rows} == {"ovib", "ovib_fixed", "vib", "pca", "raw"}
    assert len({(row["method"], row["k"], row["seed"]) for row in rows}) == len(rows)
    for seed in {row["seed"] for row in rows}:
        ks = [int(row["k"]) for row in rows if row["method"] == "ovib" and row["seed"] == seed]
        assert ks == list(range(1, 129))
    for name in ("overhead.csv", "claims.json", "provenance.json"):
        assert (folder / name).stat().st_size > 0
    with Image.open(folder / "figure.png") as picture:
        assert picture.width >= 1000
    assert (folder.parent / "README.md").read_text().count("scalable_compression") > 1
    return rows


GROUPS = (
    ("scalable_compression", "encoder_ablation", "single_scene_ib", "setup"),
    ("voi_predictor", "request_control", "view_rate_selection", "voi_timing", "multi_client", "weights"),
    ("system_grid", "walkthrough", "theorem", "retrieval", "real_scene"),
)
"""Cards of one process: those of a group share what they compute."""


def test_every_card_is_in_a_group() -> None:
    assert sorted(name for group in GROUPS for name in group) == card_names()


@pytest.mark.long
@pytest.mark.parametrize("names", GROUPS, ids=lambda names: names[0])
def test_smoke_preset_makes_every_figure(names: tuple[str, ...], tmp_path: Path, cache: Path) -> None:
    done = ovibjax("reproduce", "--preset", "smoke", "--only", *names, cache=cache, cwd=tmp_path, timeout=1800)
    assert done.returncode == 0, done.stderr
    for name in names:
        assert (tmp_path / "results" / name / "figure.png").exists()
    if "scalable_compression" not in names:
        return
    rows = check_outputs(tmp_path / "results" / "scalable_compression")
    raw = [row for row in rows if row["method"] == "raw"]
    assert {int(row["payload_bytes"]) for row in raw} == {4 * 5 * 512}
    with (tmp_path / "results" / "scalable_compression" / "codec.csv").open() as file:
        coded = list(csv.DictReader(file))
    assert list(coded[0]) == ["codec", "quality", "seed", "payload_bytes", "mean_m", "p90_m"]
    assert {row["codec"] for row in coded} >= {"jpeg"} and min(float(row["payload_bytes"]) for row in coded) > 500
    ovib = {int(row["k"]): int(row["payload_bytes"]) for row in rows if row["method"] == "ovib"}
    assert ovib[16] == 84 and ovib[35] == 160
    facts = json.loads((tmp_path / "results" / "scalable_compression" / "provenance.json").read_text())
    assert facts["preset"] == "smoke" and facts["seeds"] == "100 101"


@pytest.mark.slow
def test_somebody_elses_feature_set(tmp_path: Path, cache: Path) -> None:
    n_views, dim = 4, 100
    write_set(tmp_path / "mine.npz", n_views=n_views, dim=dim)
    out = tmp_path / "out"
    done = ovibjax(
        *("reproduce", "--preset", "smoke", "--only", "scalable_compression", "--data", "mine.npz", "--out", str(out)),
        *("--seed", "3"),
        cache=cache,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    rows = check_outputs(out / "scalable_compression")
    assert {row["seed"] for row in rows} == {"3", "4"}
    assert {int(row["k"]) for row in rows if row["method"] == "raw"} == {n_views * dim}
    assert not (out / "scalable_compression" / "codec.csv").exists()
    facts = json.loads((out / "scalable_compression" / "provenance.json").read_text())
    assert "Image codecs are left out" in facts["caption"]


def test_bad_input_is_one_line_and_exit_code_2(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_set(tmp_path / "few.npz", n=150)
    (tmp_path / "broken.npz").write_bytes(b"PK\x03\x04 this is no archive")
    (tmp_path / "file").write_text("")
    (tmp_path / "card.py").write_text("TITLE = 'no run'\n")
    cases = {
        ("--data", "absent.npz"): "absent.npz",
        ("--data", "few.npz"): "200",
        ("--data", "broken.npz"): "broken.npz",
        ("--only", "scalable_compresion"): "scalable_compresion",
        ("--backbone", "clap"): "clap",
        ("--seed", "-1"): "-1",
        ("--rank", "-3"): "-3",
        ("--out", "file/inside"): "file",
        ("--sweep", "card.py"): "run",
        ("--sweep", "absent.py"): "absent.py",
        ("--preset", "huge"): "huge",
        ("--sed", "1"): "--sed",
    }
    before = sorted(path.name for path in tmp_path.iterdir())
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("OVIBJAX_CACHE", str(cache))
    for arguments, word in cases.items():
        monkeypatch.setattr(sys, "argv", ["ovibjax", "reproduce", *arguments])
        with pytest.raises(SystemExit) as left:
            main()
        assert left.value.code == 2
        said = capsys.readouterr().err
        assert word in said, (arguments, said)
        if arguments[0] not in ("--preset", "--sed"):  # the option parser draws a box around its own message
            assert len(said.strip().splitlines()) == 1, (arguments, said)
    # As a process of its own: no traceback either.
    done = ovibjax("reproduce", "--data", "broken.npz", cache=cache, cwd=tmp_path, timeout=180)
    assert done.returncode == 2 and len(done.stderr.strip().splitlines()) == 1, done.stderr
    after = sorted(path.name for path in tmp_path.iterdir() if path.name != "results" or any(path.iterdir()))
    assert after == before


def test_interrupt_ends_in_one_line(tmp_path: Path, cache: Path) -> None:
    environment = {**os.environ, "OVIBJAX_CACHE": str(cache)}
    command = [sys.executable, "-m", "ovibjax", "reproduce", "--preset", "quick"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment, cwd=tmp_path) as process:
        time.sleep(12)
        process.send_signal(signal.SIGINT)
        _, stderr = process.communicate(timeout=180)
    assert process.returncode == 130, stderr
    assert "Traceback" not in stderr and "interrupted" in stderr


def test_every_card_loads_and_says_what_it_is() -> None:
    assert "scalable_compression" in card_names()
    for name in card_names():
        card = load_card(cards_folder() / f"{name}.py")
        assert card.TITLE and callable(card.run)


def test_help_teaches(tmp_path: Path, cache: Path) -> None:
    for command in ((), ("reproduce",), ("town",)):
        done = ovibjax(*command, "--help", cache=cache, cwd=tmp_path, timeout=180)
        assert done.returncode == 0 and len(done.stdout) > 200
    assert "quick" in ovibjax("reproduce", "--help", cache=cache, cwd=tmp_path).stdout

"""The replay command end to end: somebody's own frames and link, and bad input in one line."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ovibjax.features.feature_files import save
from ovibjax.features.frames import make_feature_set
from tests.cli.cases import ovibjax, said_of_bad_input


def write_drive(path: Path, n: int = 220, n_views: int = 4, dim: int = 24) -> None:
    rng = np.random.default_rng(0)
    position = np.stack([1.6 * np.arange(n), np.zeros(n), np.full(n, 20.0)], axis=1).astype(np.float32)
    mix = rng.normal(size=(3, n_views * dim)) / 30
    features = np.tanh(position @ mix).reshape(n, n_views, dim) + 0.05 * rng.normal(size=(n, n_views, dim))
    save(path, make_feature_set(features, position))


@pytest.mark.slow
def test_own_frames_on_a_measured_link(tmp_path: Path) -> None:
    write_drive(tmp_path / "mine.npz")
    (tmp_path / "link.txt").write_text("".join(f"{t} {0.05 + 0.01 * (t % 3)}\n" for t in range(60)))
    done = ovibjax(
        *("replay", "--policy", "voi", "uncertainty", "--data", "mine.npz", "--seed", "3", "--plot"),
        *("--trace", "link.txt", "--trace-unit", "Mbit"),
        cwd=tmp_path,
        cache=tmp_path / "cache",
    )
    assert done.returncode == 0, done.stderr
    assert "trace: link.txt: two columns (s, Mbit): 60 samples; 59 s, mean 60.2 kbit/s, peak 70 kbit/s" in done.stderr
    rows = [line.split("│")[1:-1] for line in done.stdout.splitlines() if "voi" in line or "uncertainty" in line]
    assert [row[0].strip() for row in rows] == ["voi", "uncertainty"]
    for row in rows:
        mean, p95, risk, requests, kb = (float(cell) for cell in row[1:])
        assert 0 < mean < p95 and risk > 0 and requests >= 0 and kb <= 2.1
    with Image.open(tmp_path / "replay.png") as picture:
        assert picture.width >= 1000


def test_bad_input_is_one_line_and_exit_code_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "back.txt").write_text("0 1\n1 1\n0.5 1\n")
    (tmp_path / "gap.txt").write_text("0 1\n1 1\n61 1\n62 1\n")
    cases = {
        ("--policy", "vio"): "did you mean voi",
        ("--profile", "0"): "--profile",
        ("--seed", "-1"): "--seed",
        ("--budget", "nan"): "--budget",
        ("--trace", "back.txt"): "back.txt",
        ("--trace", "absent.txt"): "absent.txt",
        ("--trace", "gap.txt"): "--max-gap 60 ",
        ("--trace", "gap.txt", "--max-gap", "0"): "--max-gap 0",
        ("--trace", "gap.txt", "--max-gap", "99", "--trace-unit", "knots"): "--trace-unit knots",
        ("--max-gap", "60"): "--max-gap belongs to --trace",
        ("--trace-column", "mbps"): "--trace-column belongs to --trace",
        ("--data", "absent.npz"): "absent.npz",
        ("--plot", "--out", "absent/x.png"): "absent",
        ("--plot", "--out", "."): "name of a file",
        ("--policy",): "name at least one",
        ("--drift-model", "random-walk"): "did you mean random_walk",
        ("--correction", "fuse"): "there are replace, always, kalman",
        ("--gate", "-1"): "--gate",
        ("--polcy", "voi"): "did you mean --policy",
    }
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("OVIBJAX_CACHE", str(tmp_path / "cache"))
    for arguments, words in cases.items():
        said = said_of_bad_input(monkeypatch, capsys, "replay", *arguments)
        assert words in said and len(said.strip().splitlines()) == 1, (arguments, said)

"""The reproduce command: help, bad input in one line, interruption."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from ovibjax.features.feature_files import save
from ovibjax.features.frames import make_feature_set
from tests.cli.cases import done_here, ovibjax, said_of_bad_input
from tests.ctrl_c import ctrl_c_interrupts


def test_bad_input_is_one_line_and_exit_code_2(
    tmp_path: Path,
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    cache = tmp_path_factory.mktemp("cache")
    save(tmp_path / "few.npz", make_feature_set(np.ones((150, 5, 24)), np.zeros((150, 3))))
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
        said = said_of_bad_input(monkeypatch, capsys, "reproduce", *arguments)
        assert word in said, (arguments, said)
        if arguments[0] not in ("--preset", "--sed"):  # the option parser draws a box around its own message
            assert len(said.strip().splitlines()) == 1, (arguments, said)
    # As a process of its own: no traceback either.
    done = ovibjax("reproduce", "--data", "broken.npz", cache=cache, cwd=tmp_path, timeout=180)
    assert done.returncode == 2 and len(done.stderr.strip().splitlines()) == 1, done.stderr
    after = sorted(path.name for path in tmp_path.iterdir() if path.name != "results" or any(path.iterdir()))
    assert after == before


def test_interrupt_ends_in_one_line(tmp_path: Path) -> None:
    compiled = tmp_path / "compiled"
    environment = {**os.environ, "OVIBJAX_CACHE": str(tmp_path / "cache"), "JAX_COMPILATION_CACHE_DIR": str(compiled)}
    environment["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    command = [sys.executable, "-m", "ovibjax", "reproduce", "--preset", "quick"]
    with ctrl_c_interrupts():
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment, cwd=tmp_path)
    with process:
        until = time.monotonic() + 180
        while not (compiled.exists() and any(compiled.iterdir())):  # at work: it has compiled its first program
            assert process.poll() is None and time.monotonic() < until
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        _, stderr = process.communicate(timeout=180)
    assert process.returncode == 130, stderr
    assert "Traceback" not in stderr and "interrupted" in stderr


def test_help_teaches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    done = ovibjax("--help", cwd=tmp_path, timeout=180)
    assert done.returncode == 0 and len(done.stdout) > 200
    for command in ("reproduce", "town"):
        said = done_here(monkeypatch, capsys, command, "--help")
        assert len(said) > 200 and ("quick" in said or command == "town")

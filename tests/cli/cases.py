"""Commands as a user runs them: in a process of their own, or here, where bad input must end in one line."""

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from ovibjax.cli.main import main

ROOT = Path(__file__).parents[2]


def ovibjax(
    *arguments: object,
    cwd: Path | None = None,
    cache: Path | None = None,
    timeout: float = 600,
    env: Mapping[str, str] = os.environ,
) -> subprocess.CompletedProcess[str]:
    """Run a command to its end, in a folder and with a cache of its own if these are given."""
    known = {"COLUMNS": "200", "PYTHONPATH": str(ROOT)} | ({"OVIBJAX_CACHE": str(cache)} if cache else {})
    command = [sys.executable, "-m", "ovibjax", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, env={**env, **known}, cwd=cwd, timeout=timeout)


def done_here(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """What a command prints as it succeeds; run here, without the seconds that a new process takes."""
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr(sys, "argv", ["ovibjax", *map(str, arguments)])
    try:
        main()
    except SystemExit as left:  # as `--help` ends
        assert left.code == 0
    return capsys.readouterr().out


def said_of_bad_input(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """What a command says as it ends with exit code 2; run here, without the seconds that a new process takes."""
    monkeypatch.setattr(sys, "argv", ["ovibjax", *map(str, arguments)])
    with pytest.raises(SystemExit) as left:
        main()
    assert left.value.code == 2
    return capsys.readouterr().err

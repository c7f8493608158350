"""Commands on terminals that are none: other encodings, closed pipes, files; and without the device asked for."""

import codecs
import io
import os
import subprocess
import sys
import warnings
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ovibjax import __version__
from ovibjax.cli import main as cli
from ovibjax.cli.terminal import civil
from ovibjax.errors import InputError, doubt
from ovibjax.runtime.progress import width_of
from tests.cli.cases import ROOT, done_here, ovibjax

HELP = [
    (),
    ("sweep", "train"),
    ("sweep", "system"),
    ("sweep", "run"),
    ("replay",),
    ("reproduce",),
    ("features",),
    ("show",),
]


@given(st.text(), st.sampled_from(["ascii", "latin-1", "cp1252", "cp437", "shift_jis", "utf-8"]))
def test_any_text_can_be_written_in_any_encoding(text, encoding):
    written = text.encode(encoding, "ovibjax.plain")
    assert written.decode(encoding).isprintable() or not text.isprintable()
    if text.isascii():
        assert written.decode(encoding) == text


@pytest.mark.parametrize(
    ("text", "plain"),
    [
        ("4.9 ± 1.2 m", "4.9 +- 1.2 m"),
        ("• β → γ", "* beta -> gamma"),
        ("╭─│╮", "+-|+"),
        ("Zürich", "Z\\xfcrich"),
        ("\udcff.jpg", "\\udcff.jpg"),
    ],
)
def test_our_own_signs_have_a_plain_form(text, plain):
    assert text.encode("ascii", "ovibjax.plain").decode() == plain


def test_a_name_that_is_no_unicode_can_be_printed_in_utf_8():
    assert "\udcff €".encode("utf-8", "ovibjax.plain") == "\\udcff €".encode()
    with pytest.raises(UnicodeDecodeError):
        b"\xff".decode("ascii", "ovibjax.plain")
    assert codecs.lookup_error("ovibjax.plain")


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
@pytest.mark.parametrize("words", HELP, ids=" ".join)
def test_help_in_other_encodings(monkeypatch, words, encoding):
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding=encoding))
    monkeypatch.setattr(sys, "argv", ["ovibjax", *words, "--help"])
    with pytest.raises(SystemExit) as left:
        cli.main()
    assert left.value.code in (0, None) and len(raw.getvalue()) > 100


@pytest.mark.parametrize("words", [("--help",), ("sweep", "train", "--help"), ("replay", "--policy", "no_such")])
@pytest.mark.parametrize("closed", ["stdout", "stderr"])
def test_a_reader_that_goes_away_is_no_error(tmp_path, words, closed):
    reading, writing = os.pipe()
    os.close(reading)
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, closed: writing}
    done = subprocess.run([sys.executable, "-m", "ovibjax", *words], env=env, cwd=tmp_path, timeout=120, **streams)
    os.close(writing)
    said = (done.stdout or b"") + (done.stderr or b"")
    assert b"Traceback" not in said and b"Broken" not in said, said
    assert done.returncode in (0, 2, 141), done.returncode


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a disk that is always full")
@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize(("stream", "words"), [("stdout", "--version"), ("stderr", "--no-such")])
def test_output_on_a_full_disk_is_one_line(tmp_path, stream, words, unbuffered):
    with Path("/dev/full").open("wb") as full:
        streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, stream: full}
        done = subprocess.run(
            [sys.executable, "-m", "ovibjax", words],
            env={**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": unbuffered},
            cwd=tmp_path,
            timeout=120,
            **streams,
        )
    said = (done.stdout or b"") + (done.stderr or b"")
    assert b"Traceback" not in said and done.returncode == 2
    assert stream == "stderr" or said.strip() == b"ovibjax: cannot write the output (No space left on device)"


@pytest.mark.skipif(os.name == "nt", reason="a shell's way to close streams")
@pytest.mark.parametrize("closed", [">&-", ">&- 2>&-"])
def test_streams_that_were_closed_before_the_start_are_no_error(tmp_path, closed):
    (tmp_path / "mine.py").write_text("axes = {'x': [1.0]}\n\ndef member(key, point, shared):\n    return {'y': 1.0}\n")
    command = f"{sys.executable} -m ovibjax sweep run mine.py --out mine.zarr {closed}"
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, shell=True, env=env, cwd=tmp_path, timeout=120, capture_output=True)
    assert b"Traceback" not in done.stdout + done.stderr and done.returncode == 0
    assert (tmp_path / "mine.zarr" / "sweep.json").is_file()


def test_a_file_is_as_wide_as_its_lines(tmp_path, monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    assert width_of(io.StringIO()) == 10_000
    monkeypatch.setenv("COLUMNS", "70")
    assert width_of(io.StringIO()) is None


def test_the_version_is_one_line(monkeypatch, capsys):
    said = done_here(monkeypatch, capsys, "--version").strip()
    assert said.startswith(f"ovibjax {__version__}, jax ") and len(said.splitlines()) == 1


@pytest.mark.parametrize("platform", ["cuda", "no_such"])
def test_a_device_that_is_not_here_is_one_line(tmp_path, platform):
    (tmp_path / "mine.py").write_text(
        "import jax.numpy as jnp\naxes = {'x': [1.0], 'seed': range(2)}\n"
        "def shared():\n    return jnp.ones(3)\n"
        "def member(key, point, shared):\n    return {'y': point['x'] * shared.sum()}\n"
    )
    env = {**os.environ, "JAX_PLATFORMS": platform}
    done = ovibjax("sweep", "run", "mine.py", "--out", "a.zarr", cwd=tmp_path, env=env)
    said = done.stderr.strip()
    assert done.returncode == 2 and len(said.splitlines()) == 1, said
    assert f"JAX_PLATFORMS={platform}: jax finds no such device here" in said and "unset it" in said
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.py"]


def test_doubts_are_lines_and_other_warnings_python_s(capsys):
    with civil():
        doubt("poses.csv", "yaw_deg may be radians")
        doubt("poses.csv", "yaw_deg may be radians")
        for entry in ("a", "b"):
            warnings.warn(
                f"Error writing persistent compilation cache entry for '{entry}': no space left", stacklevel=1
            )
    said = capsys.readouterr().err.splitlines()
    assert said[:2] == ["ovibjax: note: poses.csv: yaw_deg may be radians"] * 2
    assert len(said) == 3 and "compiled programs are not kept (no space left); set OVIBJAX_CACHE" in said[2]
    with civil(), pytest.raises(UserWarning, match="another"):
        warnings.warn("another", stacklevel=1)


def test_errors_of_a_command_pass_through():
    with pytest.raises(InputError), civil():
        raise InputError("x")


def test_a_home_that_cannot_be_written_is_no_news_of_matplotlib(tmp_path):
    (tmp_path / "file").touch()  # what no folder can be made in, whoever asks
    draw = "from ovibjax.cli.terminal import civil\nwith civil():\n    import matplotlib; matplotlib.get_cachedir()"
    env = {name: value for name, value in os.environ.items() if name not in ("MPLCONFIGDIR", "XDG_CACHE_HOME")}
    env |= {"HOME": str(tmp_path / "file"), "XDG_CONFIG_HOME": str(tmp_path / "file"), "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", draw], env=env, timeout=120, capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr == ""

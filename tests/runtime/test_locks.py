"""One process at a time, on any system; where there are no locks, that is said."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import portalocker
import pytest

from ovibjax.errors import Doubt
from ovibjax.features.images import journal
from ovibjax.runtime.locks import Held, take_lock
from tests.features.images.made_images import run, write_layout

ROOT = Path(__file__).parents[2]


def test_a_lock_keeps_others_out_until_it_is_closed(tmp_path):
    first = take_lock(tmp_path / "lock")
    with pytest.raises(Held, match=rf"process {os.getpid()} on host"):
        take_lock(tmp_path / "lock")
    first.close()
    take_lock(tmp_path / "lock").close()


def test_a_lock_ends_with_its_process(tmp_path):
    code = "import sys, pathlib; from ovibjax.runtime.locks import take_lock; held = take_lock(pathlib.Path('lock'))\n"
    code += "print('held', flush=True); sys.stdin.read()"
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path, env=env, **pipes) as other:
        assert other.stdout.readline() == b"held\n"
        with pytest.raises(Held, match=f"process {other.pid}"):
            take_lock(tmp_path / "lock")
        other.kill()
        other.wait()
        take_lock(tmp_path / "lock").close()


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL])
def test_a_file_system_without_locks_gives_none(tmp_path, monkeypatch, number):
    def refuse(*_):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(portalocker.portalocker, "LOCKER", refuse)
    assert take_lock(tmp_path / "lock") is None
    town = write_layout(tmp_path / "town", 2)
    with pytest.warns(Doubt, match=r"x\.npz\.partial/lock: its file system knows no locks; .*--out on another disk"):
        run(town, tmp_path / "x.npz")
    assert (tmp_path / "x.npz").exists() and not (tmp_path / "x.npz.partial").exists()


def test_other_errors_are_not_taken_for_no_locks(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(portalocker.portalocker, "LOCKER", refuse)
    with pytest.raises(OSError, match="cannot be locked") as caught:
        take_lock(tmp_path / "lock")
    assert caught.value.errno == errno.EIO


def test_a_system_without_any_way_to_lock(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "portalocker", None)
    assert take_lock(tmp_path / "lock") is None


def test_a_holder_that_cannot_be_read(tmp_path, monkeypatch):
    """As on Windows, where a locked file cannot be read."""
    with take_lock(tmp_path / "lock"):
        real = Path.open

        def opened(path, *args, **kwargs):
            handle = real(path, *args, **kwargs)
            handle.close()
            return real(path, "w")  # cannot be read

        monkeypatch.setattr(Path, "open", opened)
        with pytest.raises(Held, match="another process"):
            take_lock(tmp_path / "lock")


def test_the_journal_names_the_holder(tmp_path):
    (tmp_path / "a").mkdir()
    with (
        take_lock(tmp_path / "a" / "lock"),
        pytest.raises(ValueError, match=r"process \d+ on host .* is working on it"),
    ):
        journal.Journal(tmp_path / "a", {"x": 1})

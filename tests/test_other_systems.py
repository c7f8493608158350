"""What is not there on Windows is not needed: no `fcntl`, no SIGKILL, no fork, no /proc.

There is no Windows here to try; a process without all that stands in for one. It shows that nothing of it is imported
or called on the way, not that paths, terminals and locks of Windows behave.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.features.images.made_images import write_table

ROOT = Path(__file__).parents[1]

WITHOUT = """
import os, pathlib, signal, sys

for name in ("fcntl", "resource", "pwd", "grp", "_posixshmem"):
    sys.modules[name] = None
for name in ("SIGKILL", "SIGALRM", "SIGHUP", "SIGUSR1", "SIGQUIT", "pthread_kill", "pthread_sigmask", "setitimer"):
    delattr(signal, name)
# Libraries that take this for Linux need the rest.
for name in ("fork", "forkpty", "sched_getaffinity", "sched_setaffinity", "statvfs", "getgid", "killpg"):
    delattr(os, name)
for name in ("getpgid", "setsid", "nice", "O_DIRECTORY", "mkfifo", "posix_spawn", "chown"):
    delattr(os, name)


def hidden(method):
    def call(self, *args, **kwargs):
        if str(self).startswith("/proc"):
            raise FileNotFoundError(2, "No such file or directory", str(self))
        return method(self, *args, **kwargs)

    return call


for name in ("open", "stat", "read_text", "read_bytes"):
    setattr(pathlib.Path, name, hidden(getattr(pathlib.Path, name)))


def no_kill(process, number):
    raise AssertionError(f"os.kill({process}, {number}) is Ctrl-C there")


os.kill = no_kill
"""
RUN = "\nfrom ovibjax.cli.main import main\nsys.argv = ['ovibjax', *sys.argv[1:]]\nmain()\n"
IMPORT = """
import importlib, pkgutil, ovibjax
names = [found.name for found in pkgutil.walk_packages(ovibjax.__path__, "ovibjax.")]
assert len(names) > 100
for name in names:
    if not name.endswith("__main__"):
        importlib.import_module(name)
print(len(names))
"""
MINE = """
import jax
axes = {"x": [1.0, 2.0], "seed": range(3)}
def member(key, point, shared):
    return {"y": point["x"] + jax.random.normal(key)}
"""


def elsewhere(code, *arguments, cwd):
    env = {**os.environ, "PYTHONPATH": str(ROOT), "OVIBJAX_CACHE": str(cwd / "cache"), "COLUMNS": "200"}
    command = [sys.executable, "-c", WITHOUT + code, *arguments]
    return subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True, timeout=300)


def test_every_module_is_imported_without_them(tmp_path):
    done = elsewhere(IMPORT, cwd=tmp_path)
    assert done.returncode == 0 and int(done.stdout) > 100, done.stderr


def test_a_sweep_and_an_extraction_run_without_them(tmp_path):
    (tmp_path / "mine.py").write_text(MINE)
    write_table(tmp_path, 4)
    for said in ("its file system knows no locks", "6 of them were there"):
        done = elsewhere(RUN, "sweep", "run", "mine.py", "--out", "a.zarr", cwd=tmp_path)
        assert done.returncode == 0 and "6 members" in done.stderr and said in done.stderr, done.stderr
    shown = elsewhere(RUN, "show", "a.zarr", cwd=tmp_path)
    assert shown.returncode == 0 and "y" in shown.stdout, shown.stderr
    arguments = ("features", "my.csv", "--images", "images/{view}/{frame}.png", "--out", "mine.npz")
    done = elsewhere(RUN, *arguments, cwd=tmp_path)
    assert done.returncode == 0 and "kept 4 of 4 frames" in done.stderr, done.stderr


@pytest.mark.parametrize("option", ["--help", "--version"])
def test_the_command_line_starts_without_them(tmp_path, option):
    done = elsewhere(RUN, option, cwd=tmp_path)
    assert done.returncode == 0 and "ovibjax" in done.stdout, done.stderr

"""Whatever becomes of the processes, threads and disk that write a store, what was finished stays."""

import errno
import os
import random
import resource
import socket
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import portalocker
import pytest

from ovibjax.sweep import writer
from ovibjax.sweep.store import attach, open_dataset
from tests.sweep.stores import (
    WAIT,
    WRITE,
    begun,
    blocks,
    check,
    go,
    kill,
    make_rows,
    members_of,
    opened,
    refusal,
    snapshot,
    start,
)


def test_kill_at_any_moment_keeps_what_is_finished(tmp_path):
    path, pick, seen = tmp_path / "a.zarr", random.Random(0), set()
    for i, process in enumerate([start(path, WRITE) for _ in range(5)]):
        go(process, wait=i >= 2)  # the first ones may die before the store is there
        time.sleep(pick.uniform(0, 0.04) if i < 2 else pick.uniform(0.03, 0.15))
        kill(process)
        if path.exists():
            finished = members_of(path)
            assert seen <= set(finished)
            check(path, finished)
            seen = set(finished)
            for file in blocks(path)[8:]:  # leave something for the next one to write
                seen -= {int(np.load(file)["out.steps"][0]) - 1}
                file.unlink()
    assert seen
    with opened(path) as store:
        store.lock()
    assert [p.name for p in tmp_path.iterdir()] == ["a.zarr"]
    assert sorted(p.name for p in path.iterdir()) == ["lock", "members", "sweep.json"]
    assert not list(path.rglob("*.partial"))


def test_remains_of_a_killed_creation_are_removed_and_no_others(tmp_path):
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    host = socket.gethostname()
    names = [f"a.zarr.tmp-{host}-{dead.pid}", f"b.zarr.tmp-{host}-{dead.pid}", f"a.zarr.tmp-{host}-{os.getppid()}"]
    names.append(f"a.zarr.tmp-elsewhere-{dead.pid}")
    for name in names:
        (tmp_path / name).mkdir()
        (tmp_path / name / "sweep.json").write_text("{")
    begun(tmp_path / "a.zarr", [0])
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(["a.zarr", *names[1:]])


def test_second_whole_sweep_is_refused_until_the_first_is_dead(tmp_path):
    path = tmp_path / "a.zarr"
    process = start(path, WAIT)
    go(process)
    (tmp_path / "link.zarr").symlink_to(path)
    for name in (path, tmp_path / "link.zarr"):
        message = refusal(opened(name).lock)
        assert message.startswith(f"{name}: process {process.pid} on host ")
        assert "is already working on this sweep; wait for it" in message
    begun(path, [3])  # a shard needs no lock
    open_dataset(path)
    kill(process)
    with opened(path) as store:
        store.lock()
        refusal(opened(path).lock)
        store.add(make_rows([0]))
    with opened(path) as store:
        store.lock()
    check(path, [0, 3])


@pytest.mark.slow
def test_many_processes_create_at_once(tmp_path):
    for i in range(3):
        path = tmp_path / f"{i}.zarr"
        some = [start(path, WRITE) for _ in range(4)]
        for process in some:
            assert process.stdout.readline() == "ready\n"
        for process in some:
            process.stdin.write("go\n")
            process.stdin.flush()
        said = [process.communicate() for process in some]
        assert sorted(out for out, _ in said)[-1] == "open\n"
        assert all("already working on this sweep" in err for out, err in said if not out)
        check(path, range(18))
        assert [p.name for p in tmp_path.iterdir() if p.name.startswith(f"{i}.")] == [path.name]


def test_reading_while_another_process_writes(tmp_path):
    path = tmp_path / "a.zarr"
    process = start(path, WRITE)
    go(process)
    for _ in range(10):
        dataset = open_dataset(path).stack(member=["seed", "beta", "kind"])
        assert set(dataset.steps.values[dataset.finished.values]) <= set(range(1, 19))
    assert process.communicate()[1] == ""
    check(path, range(18))


@pytest.mark.parametrize("wait_s", [0.0, 0.05])
def test_threads_add_members(tmp_path, monkeypatch, wait_s):
    monkeypatch.setattr(writer, "_WAIT_S", wait_s)
    with opened(tmp_path / "a.zarr") as store, ThreadPoolExecutor(6) as pool:
        for done in [pool.submit(store.add, make_rows([k])) for k in range(18)]:
            done.result()
    check(tmp_path / "a.zarr", range(18))


def test_members_are_on_disk_in_time_and_in_few_files(tmp_path, monkeypatch):
    monkeypatch.setattr(writer, "_WAIT_S", 0.5)
    path = tmp_path / "a.zarr"
    with opened(path) as store:
        for k in range(10):
            store.add(make_rows([k]))
        assert members_of(path) == [0]  # the others wait for more
        time.sleep(1.2)
        assert members_of(path) == list(range(10)) and len(blocks(path)) == 2
        store.add(make_rows([10]))
        assert members_of(path) == list(range(11)), "nothing was written for long: no need to wait"
        store.add(make_rows([11]))
    assert members_of(path) == list(range(12))


def failing(monkeypatch, name, error, after=0):
    """A function of `os` fails from its n-th call on."""
    real, left = getattr(os, name), [after]

    def fails(*args, **options):
        left[0] -= 1
        if left[0] < 0:
            raise error
        return real(*args, **options)

    monkeypatch.setattr(os, name, fails)


FULL = OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("error", [FULL, OSError(errno.EDQUOT, "Disk quota exceeded"), OSError(errno.EIO, "I/O error")])
def test_what_the_disk_refuses_is_kept_until_it_takes_it(tmp_path, monkeypatch, error):
    monkeypatch.setattr(writer, "_WAIT_S", 0.0)
    path = begun(tmp_path / "a.zarr", [0, 1])
    advice = "mend that" if error.errno == errno.EIO else "make room"
    with opened(path) as store:
        with monkeypatch.context() as patch:
            failing(patch, "fsync", error)
            for k in (2, 3):
                message = refusal(store.add, make_rows([k]))
                assert f"{path}: cannot write ({error.strerror}); 2 members are kept; {advice} and repeat" in message
            assert members_of(path) == [0, 1] and not list(path.rglob("*.partial"))
        store.add(make_rows([4]))
        assert members_of(path) == [0, 1, 2, 3, 4]
    check(path, range(5))


def test_full_disk_at_creation(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        failing(patch, "fsync", FULL)
        message = refusal(opened, tmp_path / "a.zarr")
    assert "cannot write (No space left on device); 0 members are kept; make room" in message
    assert not list(tmp_path.iterdir())
    begun(tmp_path / "a.zarr", [0])


def test_the_system_refuses_a_file(tmp_path):
    """A real error of the operating system."""
    path, limits = begun(tmp_path / "a.zarr", [0]), resource.getrlimit(resource.RLIMIT_FSIZE)
    with opened(path) as store:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100, limits[1]))
        try:
            message = refusal(store.add, make_rows(range(1, 9)))
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert "cannot write (File too large); 1 members are kept; make room" in message
        assert members_of(path) == [0] and not list(path.rglob("*.partial"))
    check(path, range(9))


def test_a_file_system_without_locks(tmp_path, monkeypatch, capsys):
    def no_locks(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(portalocker.portalocker, "LOCKER", no_locks)
    with opened(tmp_path / "a.zarr") as store:
        store.lock()
        store.add(make_rows([0]))
    said = " ".join(capsys.readouterr().err.split())
    assert said.count("its file system knows no locks") == 1 and "nothing would be lost" in said
    check(tmp_path / "a.zarr", [0])


def test_a_clock_that_is_wrong_changes_nothing(tmp_path, monkeypatch):
    path = begun(tmp_path / "a.zarr", range(4))
    for when in (0, 4e9):
        for file in path.rglob("*"):
            os.utime(file, (when, when))
        check(path, range(4))
    monkeypatch.setattr(time, "time", lambda: -1e9)
    begun(path, [7])
    check(path, [0, 1, 2, 3, 7])


def test_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("text")
    message = refusal(opened, tmp_path / "file" / "a.zarr")
    assert f"cannot write ({tmp_path / 'file'} is no folder); 0 members are kept" in message
    assert "is no folder" in refusal(opened, tmp_path / "file" / "runs" / "a.zarr")
    assert (tmp_path / "file").read_text() == "text"


def test_a_folder_that_only_reads(tmp_path):
    """Who finds all members needs to write nothing; who does not is told."""
    path = begun(tmp_path / "a.zarr", range(4))
    before = snapshot(path)
    mounted = subprocess.run(["mount", "--bind", "-o", "ro", path, path], capture_output=True)
    if mounted.returncode:
        pytest.skip("needs the right to mount")
    try:
        with opened(path) as store:
            assert "cannot write (Read-only file system); 4 members are kept; mend that" in refusal(store.lock)
        store = attach(path)
        store.read()
        assert "cannot write (Read-only file system)" in refusal(store.add, make_rows([5]))
        check(path, range(4))
    finally:
        subprocess.run(["umount", path], check=True)
    assert snapshot(path) == before

"""Whatever becomes of the processes, threads and disk that write a store, what was finished stays."""

import errno
import random
import resource
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import zarr.storage._local

from ovibjax.sweep.schema import Variable
from ovibjax.sweep.store import Store, open_dataset
from tests.sweep.stores import (
    CONFIG,
    VARIABLES,
    WAIT,
    WRITE,
    check,
    fill,
    go,
    kill,
    make_schema,
    refusal,
    start,
)


def test_kill_at_any_moment_keeps_what_is_finished(tmp_path):
    schema, path = make_schema(rows=1, columns=2), tmp_path / "a.zarr"
    pick = random.Random(0)
    killed = [start(path, WRITE) for _ in range(5)]
    seen = set()
    for i, process in enumerate(killed):
        go(process, wait=i >= 2)  # the first ones may die before the store is there
        time.sleep(pick.uniform(0, 0.04) if i < 2 else pick.uniform(0.05, 0.3))
        kill(process)
        if i >= 2 or path.exists():
            with Store.open(path, schema, CONFIG) as store:
                finished = np.flatnonzero(store.finished()).tolist()
            assert seen <= set(finished)
            check(path, schema, finished)
            # Leave something for the next one to write.
            for chunk in finished[2:]:
                (path / "finished" / f"c.{chunk}").unlink()
            seen = set(finished[:2])
    assert seen
    Store.open(path, schema, CONFIG).close()
    assert sorted(p.name for p in tmp_path.iterdir()) == [".a.zarr.lock", "a.zarr"]


def test_remains_of_a_killed_creation_are_removed(tmp_path):
    path = tmp_path / "a.zarr"
    stale = tmp_path / "a.zarr.tmp-999999"
    stale.mkdir()
    (stale / "zarr.json").write_text("{")
    other = tmp_path / "b.zarr.tmp-1"
    other.mkdir()
    with Store.open(path, make_schema(), CONFIG) as store:
        fill(store, [0])
    assert sorted(p.name for p in tmp_path.iterdir()) == [".a.zarr.lock", "a.zarr", "b.zarr.tmp-1"]


def test_second_process_is_refused_until_the_first_is_dead(tmp_path):
    schema, path = make_schema(rows=1, columns=2), tmp_path / "a.zarr"
    process = start(path, WAIT)
    go(process)
    (tmp_path / "link.zarr").symlink_to(path)
    for name in (path, tmp_path / "link.zarr"):
        message = refusal(Store.open, name, schema, CONFIG)
        assert message.startswith(f"{name}: process {process.pid} on host ")
        assert message.endswith(" is already working on this sweep; wait for it, or choose another --out")
    open_dataset(path)
    kill(process)
    with Store.open(path, schema, CONFIG) as store:
        refusal(Store.open, path, schema, CONFIG)
        fill(store, [0])
    Store.open(path, schema, CONFIG).close()


@pytest.mark.slow
def test_two_processes_create_at_once(tmp_path):
    both = [[start(tmp_path / f"{i}.zarr", WAIT) for _ in range(2)] for i in range(2)]
    for i, pair in enumerate(both):
        for process in pair:
            assert process.stdout.readline() == "ready\n"
        for process in pair:
            process.stdin.write("go\n")
            process.stdin.flush()
        lines = [process.stdout.readline() for process in pair]
        assert sorted(lines) == ["", "open\n"]
        assert "is already working on this sweep" in pair[lines.index("")].communicate()[1]
        assert pair[lines.index("open\n")].communicate()[1] == ""
        with Store.open(tmp_path / f"{i}.zarr", make_schema(rows=1, columns=2), CONFIG) as store:
            assert not store.finished().any()


def test_reading_while_another_process_writes(tmp_path):
    schema, path = make_schema(rows=1, columns=2), tmp_path / "a.zarr"
    process = start(path, WRITE)
    go(process)
    for _ in range(10):
        dataset = open_dataset(path)
        members = np.flatnonzero(dataset.finished.values)
        assert (dataset.steps.values.reshape(-1)[members] == members + 1).all()
    assert process.communicate()[1] == ""
    check(path, schema, range(len(schema.chunks.members)))


def test_threads_write_different_chunks(tmp_path):
    schema, path = make_schema(rows=1, columns=1), tmp_path / "a.zarr"
    n = len(schema.chunks.members)
    with Store.open(path, schema, CONFIG) as store, ThreadPoolExecutor(6) as pool:
        for done in [pool.submit(fill, store, [chunk]) for chunk in range(n)]:
            done.result()
        assert store.finished().all()
    check(path, schema, range(n))


def test_full_disk_in_the_middle_of_a_chunk(tmp_path, monkeypatch):
    schema, path = make_schema(), tmp_path / "a.zarr"
    put = zarr.storage._local._put
    with Store.open(path, schema, CONFIG) as store:
        fill(store, [0])
        for allowed in range(len(VARIABLES) + 2):
            left = [allowed]

            def full(*args, left=left, **options):
                left[0] -= 1
                if left[0] < 0:
                    raise OSError(errno.ENOSPC, "No space left on device")
                return put(*args, **options)

            monkeypatch.setattr(zarr.storage._local, "_put", full)
            assert refusal(fill, store, [1]) == (
                f"{path}: cannot write (No space left on device); 1 of 4 chunks are kept; "
                "make room and repeat the command"
            )
            monkeypatch.setattr(zarr.storage._local, "_put", put)
            assert store.finished().tolist() == [True, False, False, False]
            check(path, schema, [0])
        fill(store, [1])
    check(path, schema, [0, 1])


def test_full_disk_at_creation(tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(zarr.storage._local, "_put", full)
        message = refusal(Store.open, tmp_path / "a.zarr", make_schema(), CONFIG)
    assert "cannot write (No space left on device); 0 of 4 chunks are kept; make room" in message
    assert [p.name for p in tmp_path.iterdir()] == [".a.zarr.lock"]
    with Store.open(tmp_path / "a.zarr", make_schema(), CONFIG):
        pass


def test_the_system_refuses_a_file(tmp_path):
    """A real error of the operating system, through zarr's threads."""
    big = {"noise": Variable((4096,), np.dtype("float32"), ("x",))}
    schema = make_schema(variables=big, coords={})
    noise = np.random.default_rng(0).normal(size=(8, 4096)).astype(np.float32)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    with Store.open(tmp_path / "a.zarr", schema, CONFIG) as store:
        store.write(0, {"noise": noise}, np.zeros(8, bool))
        resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, limits[1]))
        try:
            message = refusal(store.write, 1, {"noise": noise}, np.zeros(8, bool))
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert "cannot write (File too large); 1 of 4 chunks are kept; make room" in message
        assert store.finished().tolist() == [True, False, False, False]
        assert not list((tmp_path / "a.zarr").rglob("*.partial"))


def test_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("text")
    message = refusal(Store.open, tmp_path / "file" / "a.zarr", make_schema(), CONFIG)
    assert f"cannot write ({tmp_path / 'file'} is no folder); 0 of 4 chunks are kept" in message
    message = refusal(Store.open, tmp_path / "file" / "runs" / "a.zarr", make_schema(), CONFIG)
    assert "is no folder" in message
    assert (tmp_path / "file").read_text() == "text"

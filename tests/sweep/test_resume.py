"""A sweep that is killed or out of room loses nothing that was finished."""

import json
import re
import resource
import subprocess
from pathlib import Path

import jax
import pytest

from ovibjax.errors import InputError
from ovibjax.sweep import program, writer
from ovibjax.sweep.engine import run
from ovibjax.sweep.store import open_dataset
from tests.sweep.members import AXES, DATA, begun_store, finish, same, small, start, sweep, tree_hash


@pytest.fixture
def begun(tmp_path):
    return begun_store(tmp_path / "runs" / "a.zarr")


KILLS = """
import json, os, random, signal, sys, time
from tests.sweep.members import sweep  # imports only: jax starts in the children

folder, kills, steps = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
pick = random.Random(int(sys.argv[4]))

def begin(store):
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(read)
        try:
            sweep(store, steps, on_progress=lambda done, total: os.write(write, b"%d\\n" % done))
        except BaseException:
            import traceback
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    os.close(write)
    return child, os.fdopen(read)

def wait(child, progress):
    done = [int(line) for line in progress]
    assert os.waitpid(child, 0)[1] == 0
    assert done == sorted(done) and done[-1] == 64, done
    return done[0]

clock = time.perf_counter()
wait(*begin(f"{folder}/whole.zarr"))
whole = time.perf_counter() - clock
resumed, interrupted = [], 0
for i in range(kills):
    child, progress = begin(f"{folder}/killed.zarr")
    if i % 4 == 0:  # wherever it is, even before its store is there
        time.sleep(pick.uniform(0, 1.2))
        seen = []
    else:  # soon after it has begun to compute; later ones have less to do
        seen = [int(progress.readline())]
        while pick.random() < 0.6:
            seen.append(int(progress.readline()))
        time.sleep(pick.uniform(0, 0.1))
    os.kill(child, signal.SIGKILL)
    seen += [int(line) for line in progress]
    interrupted += os.waitpid(child, 0)[1] == signal.SIGKILL
    resumed += seen[:1]
    assert seen == sorted(seen), seen
assert resumed == sorted(resumed), "what was finished stays finished"
last = wait(*begin(f"{folder}/killed.zarr"))
print(json.dumps({"killed": interrupted, "resumed": [*resumed, last], "whole": whole}))
"""


def killed_and_resumed(folder, kills, steps, seed):
    out = json.loads(finish(start(KILLS, folder, kills, steps, seed)))
    assert out["killed"] == kills, out
    assert 0 < out["resumed"][-1] < 64, out  # there was something to keep, and something to do
    whole, killed = open_dataset(folder / "whole.zarr"), open_dataset(folder / "killed.zarr")
    assert whole.finished.all()
    same(whole, killed)
    assert whole.attrs == killed.attrs
    assert sorted(p.name for p in folder.iterdir() if not p.name.startswith(".")) == ["killed.zarr", "whole.zarr"]
    assert not list(folder.rglob("*.partial"))


def test_killed_3_times_gives_the_same_bits(tmp_path):
    killed_and_resumed(tmp_path, 3, 4000, 1)


@pytest.mark.long
def test_killed_20_times_gives_the_same_bits(tmp_path):
    killed_and_resumed(tmp_path, 20, 30_000, 2)


def test_another_process_resumes_what_this_one_has_begun(tmp_path):
    """The text of the program, its hash and the data's hash are the same there."""

    def stop(done, total):
        if done == 10:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sweep(tmp_path / "a.zarr", 3, on_progress=stop)
    code = "import sys\nfrom tests.sweep.members import sweep\nsweep(sys.argv[1], 3, on_progress=lambda *n: print(*n))"
    lines = finish(start(code, tmp_path / "a.zarr", hash_seed="7")).split("\n")
    assert lines[0] == "10 64" and lines[-2] == "64 64"
    same(open_dataset(tmp_path / "a.zarr"), sweep(None, 3))


def test_a_store_keeps_the_batches_it_was_begun_with(tmp_path):
    """Whatever a later version, or machine, would choose."""
    path = tmp_path / "a.zarr"
    run(small, {"rate": [0.1], "seed": range(2)}, DATA, store=path, lanes=1)
    assert run(small, AXES, DATA).attrs["config"]["execution"]["lanes"] > 1
    seen = []
    dataset = run(small, AXES, DATA, store=path, on_progress=lambda *n: seen.append(n))
    assert dataset.finished.all() and seen[0] == (2, 6)
    assert dataset.attrs["config"]["execution"] == {"lanes": 1, "grouped": False}
    same(dataset, run(small, AXES, DATA, lanes=1))


def test_finished_sweep_computes_nothing(tmp_path):
    options = {"store": tmp_path / "a.zarr"}
    one = run(small, AXES, DATA, **options)
    before, count, seen = tree_hash(tmp_path / "a.zarr"), program.compilations, []
    same(one, run(small, AXES, DATA, **options, on_progress=lambda *n: seen.append(n)))
    assert seen == [(6, 6)] and program.compilations == count and tree_hash(tmp_path / "a.zarr") == before


def test_two_processes_on_one_store(tmp_path):
    path = tmp_path / "a.zarr"
    code = "import sys\nfrom tests.sweep.members import sweep\n"
    code += "sweep(sys.argv[1], 2500, on_progress=lambda *n: print(*n, flush=True))"
    process = start(code, path)
    for line in process.stdout:
        if int(line.split()[0]) >= 3:
            break
    with pytest.raises(InputError) as caught:
        sweep(path, 2500)
    assert f"process {process.pid} on host " in str(caught.value)
    assert "already working on this sweep" in str(caught.value)
    assert process.poll() is None, "the first was still at it"
    assert finish(process).split("\n")[-2] == "64 64"
    same(sweep(path, 2500), sweep(None, 2500))  # the lock is free again


def noisy(key, point, shared):
    """Does not compress."""
    return {"noise": jax.random.normal(jax.random.fold_in(key, point["i"]), (20_000,))}


def test_full_disk(tmp_path):
    """The system refuses a file that is too large: one line, what is finished stays, and it goes on with room."""
    path, limits = tmp_path / "a.zarr", resource.getrlimit(resource.RLIMIT_FSIZE)
    options = {"axes": {"i": range(6)}, "lanes": 1}
    run(noisy, {"i": range(2)}, store=path, lanes=1)

    def tight(done, total):
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))

    try:
        with pytest.raises(InputError) as caught:
            run(noisy, store=path, on_progress=tight, **options)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    message = str(caught.value)
    assert "cannot write (File too large); 2 members are kept; make room and repeat the command" in message
    assert str(path) in message and "\n" not in message
    kept = open_dataset(path)
    assert kept.finished.sum() == 2
    seen = []
    dataset = run(noisy, store=path, on_progress=lambda *n: seen.append(n[0]), **options)
    assert seen[0] == 2
    same(dataset, run(noisy, **options))
    assert kept.noise.values[:2].tobytes() == dataset.noise.values[:2].tobytes()


@pytest.fixture
def small_disk(tmp_path):
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1200k", "tmpfs", folder], capture_output=True)
    if mounted.returncode:
        pytest.skip("needs the right to mount")
    yield folder
    subprocess.run(["umount", "-l", folder], check=True)


def test_full_disk_of_its_own(small_disk, monkeypatch):
    monkeypatch.setattr(writer, "_WAIT_S", 0.0)
    with pytest.raises(InputError, match=r"No space left on device.*make room") as caught:
        run(noisy, {"i": range(24)}, store=small_disk / "a.zarr", lanes=1)
    kept = int(re.search(r"(\d+) members are kept", str(caught.value)).group(1))
    dataset = open_dataset(small_disk / "a.zarr")
    assert 3 <= kept < 24 and kept == dataset.finished.sum()
    subprocess.run(["mount", "-o", "remount,size=8m", small_disk], check=True)
    seen = []
    whole = run(noisy, {"i": range(24)}, store=small_disk / "a.zarr", on_progress=lambda *n: seen.append(n[0]))
    assert seen[0] == kept
    same(whole, run(noisy, {"i": range(24)}, lanes=1))


def test_a_damaged_block_is_named_and_computed_again(begun):
    (file,) = (begun / "members").glob("2-*.npy")
    data = file.read_bytes()
    file.write_bytes(data[:-6] + bytes([data[-6] ^ 1]) + data[-5:])
    with pytest.raises(InputError) as caught:
        run(small, AXES, DATA, store=begun, settings={"model": "wave"})
    message = str(caught.value)
    assert "is damaged (its checksum does not fit); remove it and repeat the command" in message
    Path(message.split(" is damaged")[0]).unlink()
    seen = []
    dataset = run(small, AXES, DATA, store=begun, settings={"model": "wave"}, on_progress=lambda *n: seen.append(n[0]))
    assert dataset.finished.all() and seen[0] == 1
    same(dataset, run(small, AXES, DATA, lanes=1))

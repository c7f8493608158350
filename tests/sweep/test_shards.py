"""Shards are processes that know nothing of each other: killed, repeated or merged, they give the same bits."""

import json
import random
from functools import partial

import numpy as np
import pytest

from ovibjax.errors import Doubt, InputError
from ovibjax.sweep.blocks import write_block
from ovibjax.sweep.engine import run
from ovibjax.sweep.merging import merge
from ovibjax.sweep.store import open_dataset
from ovibjax.sweep.work import Along
from tests.sweep.members import AXES, DATA, finish, same, small, snapshot_of, start, sweep, train

SHARDS = """
import json, os, random, signal, sys, time, traceback
from tests.sweep.members import sweep  # imports only: jax starts in the children

folder, steps, pick = sys.argv[1], int(sys.argv[2]), random.Random(int(sys.argv[3]))
rounds = json.loads(sys.argv[4])

def begin(store, i, n):
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(read)
        try:
            sweep(f"{folder}/{store}", steps, shard=(i, n), on_progress=lambda *n: os.write(write, b"%d %d\\n" % n))
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    os.close(write)
    return child, os.fdopen(read)

killed = 0
for shards, deadly in rounds:
    pick.shuffle(shards)
    running = [begin(*shard) for shard in shards]
    pick.shuffle(running)
    for child, progress in running:
        if deadly:
            for _ in range(pick.choice([0, 1, 1, 2])):  # even before its store is there
                progress.readline()
            time.sleep(pick.uniform(0, 0.03))
            os.kill(child, signal.SIGKILL)
    for child, progress in running:
        list(progress)
        status = os.waitpid(child, 0)[1]
        killed += status == signal.SIGKILL
        assert deadly or status == 0, status
print(killed)
"""


def sharded(folder, steps, seed, *rounds):
    """Rounds of shards (store, number, count) that run at a time; in deadly rounds all are killed. How many were."""
    plan = json.dumps([[list(shards), deadly] for shards, deadly in rounds])
    return int(finish(start(SHARDS, folder, steps, seed, plan)))


def all_of(n, store="a.zarr"):
    return [(store, i, n) for i in range(1, n + 1)]


def test_8_shards_each_killed_and_repeated_give_the_bits_of_the_whole(tmp_path):
    killed = sharded(tmp_path, 6000, 1, (all_of(8), True), (all_of(8), False))
    assert killed == 8
    same(open_dataset(tmp_path / "a.zarr"), sweep(None, 6000))
    assert [path.name for path in tmp_path.iterdir()] == ["a.zarr"]


def test_two_of_one_number_and_another_count_midway(tmp_path):
    sharded(tmp_path, 1000, 2, (all_of(8), True), ([*all_of(3), ("a.zarr", 2, 3)], False))
    whole = open_dataset(tmp_path / "a.zarr")
    same(whole, sweep(None, 1000))
    seen = []
    same(sweep(tmp_path / "a.zarr", 1000, on_progress=lambda *n: seen.append(n)), whole)
    assert seen == [(64, 64)]


@pytest.mark.long
def test_shards_killed_over_and_over(tmp_path):
    kills = [(all_of(n), True) for n in (8, 8, 5, 8, 3, 16, 8)]
    assert sharded(tmp_path, 20_000, 3, *kills, (all_of(8), False)) >= 40
    same(open_dataset(tmp_path / "a.zarr"), sweep(None, 20_000))


MERGES = """
import os, random, signal, sys, time, traceback
from ovibjax.sweep.merging import merge

out, paths, pick, fsync = sys.argv[1], sys.argv[3:], random.Random(int(sys.argv[2])), os.fsync

def slow(descriptor):
    time.sleep(0.08)
    fsync(descriptor)

os.fsync = slow
killed = 0
for _ in range(5):
    child = os.fork()
    if child == 0:
        try:
            merge(paths, out)
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    time.sleep(pick.uniform(0.02, 0.12))
    os.kill(child, signal.SIGKILL)
    killed += os.waitpid(child, 0)[1] == signal.SIGKILL
print(killed, *merge(paths, out))
"""


def test_shards_that_share_nothing_are_merged_even_if_merging_is_killed(tmp_path):
    stores = [(f"{i}.zarr", i, 5) for i in range(1, 6)]
    sharded(tmp_path, 1000, 4, (stores, True), (stores, False))
    paths = [tmp_path / name for name, _, _ in stores]
    random.Random(4).shuffle(paths)
    before = {path: snapshot_of(path) for path in paths}
    killed, total, added = map(int, finish(start(MERGES, tmp_path / "all.zarr", 5, *paths)).split())
    assert killed >= 3 and total == 64 and added <= 64
    same(open_dataset(tmp_path / "all.zarr"), sweep(None, 1000))
    assert {path: snapshot_of(path) for path in paths} == before
    assert merge(paths, tmp_path / "all.zarr") == (64, 0)
    assert not list((tmp_path / "all.zarr").rglob("*.partial"))


def test_stores_that_overlap_and_grids_that_differ(tmp_path):
    fn, data = partial(train, steps=3), {"gain": np.float32(0.1)}
    whole = run(fn, {"rate": [0.5, 0.6, 0.7], "seed": range(4)}, data)
    run(fn, {"rate": [0.5, 0.6], "seed": range(3)}, data, store=tmp_path / "a.zarr")
    run(fn, {"seed": range(4), "rate": [0.6, 0.7]}, data, store=tmp_path / "b.zarr")
    total, added = merge([tmp_path / "a.zarr", tmp_path / "b.zarr"], tmp_path / "c.zarr")
    assert total == added == 11
    grown = run(fn, {"rate": [0.5, 0.6, 0.7], "seed": range(4)}, data, store=tmp_path / "c.zarr")
    same(grown, whole)
    # Into one of them.
    assert merge([tmp_path / "b.zarr"], tmp_path / "a.zarr") == (11, 5)


def test_members_that_two_stores_know_with_other_bits_are_told(tmp_path):
    for name in ("a.zarr", "b.zarr"):
        run(small, AXES, DATA, store=tmp_path / name)
    block = next((tmp_path / "b.zarr" / "members").glob("*.npy"))
    rows = np.load(block)
    output = next(name for name in rows.dtype.names if name.startswith("out."))
    rows[output][0] += 1
    block.unlink()
    write_block(block.parent, rows)
    with pytest.warns(Doubt, match=r"b\.zarr: 1 members are in .*c\.zarr with other bits"):
        merge([tmp_path / "a.zarr", tmp_path / "b.zarr"], tmp_path / "c.zarr")
    same(open_dataset(tmp_path / "c.zarr"), open_dataset(tmp_path / "a.zarr"))


def test_what_cannot_be_merged_is_refused_and_nothing_changed(tmp_path):
    def refused(*paths, out=None):
        before = snapshot_of(tmp_path)
        with pytest.raises(InputError) as caught:
            merge([tmp_path / path for path in paths], tmp_path / (out or f"of-{'-'.join(paths)}"))
        assert "\n" not in str(caught.value)
        assert {path: content for path, content in snapshot_of(tmp_path).items() if path in before} == before
        return str(caught.value)

    run(small, AXES, DATA, store=tmp_path / "a.zarr", settings={"steps": 3})
    run(small, AXES, DATA, store=tmp_path / "b.zarr", settings={"steps": 4})
    run(small, AXES, Along("seed", [DATA, DATA]), store=tmp_path / "c.zarr")
    other = Along("seed", [DATA, {"offset": np.float32(3)}])
    run(small, AXES, other, store=tmp_path / "d.zarr")
    for kinds in (["x", "y"], ["z"]):
        run(lambda key, point, shared: {"k": point["kind"]}, {"kind": kinds}, store=tmp_path / f"{kinds[0]}.zarr")
    assert "settings.steps is 4 there and 3 here; it cannot be merged with" in refused("a.zarr", "b.zarr")
    assert "settings.steps is 4 there and 3 here" in refused("a.zarr", out="b.zarr")
    assert "rate 0.1, seed 1 saw other data there than in" in refused("c.zarr", "d.zarr")
    assert "of kind, number 0 is x there and z here; they cannot be merged" in refused("x.zarr", "z.zarr")
    assert "no store of a sweep" in refused("a.zarr", "none.zarr") and not (tmp_path / "none.zarr").exists()
    assert "nothing to merge" in refused()

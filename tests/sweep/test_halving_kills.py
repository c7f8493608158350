"""A halving that is killed, whatever rung it is on, ends with the bits of one that was not."""

import json

import pytest

from ovibjax.sweep.store import open_dataset
from tests.sweep.members import finish, same, start
from tests.sweep.staged_members import slow_sweep

KILLS = """
import json, os, random, signal, sys, time, traceback
from tests.sweep.staged_members import slow_sweep  # imports only: jax starts in the children

path, inner, pick, places = sys.argv[1], int(sys.argv[2]), random.Random(int(sys.argv[3])), json.loads(sys.argv[4])

def begin():
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(read)
        try:
            slow_sweep(path, inner, on_progress=lambda *n: os.write(write, b"%d %d\\n" % n))
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    os.close(write)
    return child, os.fdopen(read)

rungs, seen = [], []
for place in places:
    child, progress = begin()
    done = 0
    for line in progress:
        done = int(line.split()[0])
        seen.append(done)
        if done >= place:
            break
    time.sleep(pick.uniform(0, 0.03))
    os.kill(child, signal.SIGKILL)
    for line in progress:
        done = int(line.split()[0])
    if os.waitpid(child, 0)[1] == signal.SIGKILL:
        rungs.append(0 if done < 36 else 1 if done < 48 else 2)
child, progress = begin()
first = next(iter(progress)).split()[0]
last = [line.split() for line in progress][-1]
assert os.waitpid(child, 0)[1] == 0
print(json.dumps({"rungs": rungs, "first": int(first), "last": last}))
"""


def killed(path, inner, seed, places):
    """Kill a halving soon after it has so many members, each time; what is known of it then."""
    out = json.loads(finish(start(KILLS, path, inner, seed, json.dumps(places))))
    assert out["last"] == ["52", "52"]
    assert sorted(entry.name for entry in path.iterdir()) == ["asked", "lock", "members", "sweep.json"]
    assert not list(path.rglob("*.partial")) and not (path / "asked" / "expected").exists()
    assert open_dataset(path).finished.sum() == 52
    same(slow_sweep(path, inner), slow_sweep(None, inner))
    return out


def test_killed_in_every_rung(tmp_path):
    out = killed(tmp_path / "a.zarr", 6000, 1, [12, 36, 41, 49])
    assert set(out["rungs"]) == {0, 1, 2} and out["first"] >= 36


@pytest.mark.long
def test_killed_over_and_over(tmp_path):
    places = [0, 1, 3, 6, 9, 12, 16, 20, 25, 30, 35, 36, 37, 40, 44, 47, 48, 49, 51]
    out = killed(tmp_path / "a.zarr", 6000, 2, places)
    assert len(out["rungs"]) >= 15 and set(out["rungs"]) == {0, 1, 2}

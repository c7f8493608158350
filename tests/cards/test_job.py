"""What a card's job keeps between runs."""

import json
import os
import time
from dataclasses import dataclass
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax import sweep
from ovibjax.cards import job as jobs
from ovibjax.cards.job import CardInterrupted, Job, _remove_old
from ovibjax.features.frames import make_feature_set


def fn(key, point, shared):
    return {"y": point["a"] * shared["offset"]}


def stored(path):
    return sweep.run(fn, {"a": [1.0, 2.0, 3.0]}, {"offset": jnp.float32(2)}, store=path)


def test_stores_that_nobody_added_to_for_long_are_removed(tmp_path):
    paths = {name: tmp_path / f"{name}.zarr" for name in ("old", "grown", "new", "older_version", "thesis")}
    for name in ("old", "grown", "new"):
        stored(paths[name])
    (paths["older_version"] / "finished").mkdir(parents=True)
    (paths["older_version"] / "finished" / "zarr.json").write_text("{}")
    paths["thesis"].mkdir()
    long_ago = time.time() - 30 * 24 * 3600
    for name, path in paths.items():
        if name != "new":
            os.utime(path, (long_ago, long_ago))
        if name == "old":
            os.utime(path / "members", (long_ago, long_ago))
    _remove_old(tmp_path)
    assert {name for name, path in paths.items() if path.exists()} == {"grown", "new", "thesis"}


@pytest.fixture
def job(tmp_path, monkeypatch):
    monkeypatch.setattr(jobs, "cache_folder", lambda: tmp_path)
    features = make_feature_set(np.ones((2, 5, 3), np.float32), np.zeros((2, 3), np.float32))
    return Job("card", "smoke", Path(tmp_path), 100, features, "embedded", None)


@dataclass(frozen=True)
class Scaled:
    """A member function with a static setting."""

    factor: float

    def __call__(self, key, point, shared):
        return {"y": point["a"] * shared["offset"] * self.factor}


def along(seeds, shift=0.0):
    return sweep.Along("seed", [{"offset": np.float32(seed + shift)} for seed in seeds])


def test_a_larger_preset_computes_what_a_smaller_one_has_not(job):
    """And another code or other data go on from nothing."""

    def resumed(seeds, a, fn=Scaled(2.0), shift=0.0):
        found = job.sweep("x", fn, {"a": a, "seed": seeds}, along(seeds, shift))
        assert found.finished.all()
        np.testing.assert_allclose(found.y, np.outer(a, np.float32(seeds) + shift) * fn.factor)
        return found.attrs["resumed"]

    assert resumed([100, 101], [1.0, 2.0]) == 0
    assert resumed([100, 101, 102], [1.0, 2.0, 3.0]) == 4
    assert resumed([100], [3.0]) == 1
    assert resumed([100, 101], [1.0], fn=Scaled(3.0)) == 0
    assert resumed([100, 101], [1.0], shift=0.5) == 0
    assert resumed([100, 101], [1.0]) == 2


def test_two_sweeps_of_one_card_that_name_other_variants(job):
    """They share their program, and the number that stands for a name."""
    for names in (["full", "no_rate"], ["no_rate", "full"], ["full", "no_rate"]):
        axes = {"variant": names, "a": [float(len(name)) for name in names], "seed": [100]}
        found = job.sweep("x", Scaled(2.0), axes, along([100]), zipped=[("variant", "a")])
        np.testing.assert_allclose(found.y.squeeze(), [200 * len(name) for name in names])


def test_an_interrupted_card_goes_on(job, monkeypatch):
    def stop(done, total):
        if done:
            raise KeyboardInterrupt

    def compute(store, on_progress):
        return sweep.run(fn, {"a": [1.0, 2.0]}, {"offset": jnp.float32(2)}, store=store, lanes=1, on_progress=stop)

    with pytest.raises(CardInterrupted, match=r"1 of 2 members are kept|2 of 2 members are kept"):
        job.kept("x", compute)
    assert job.sweep("x", fn, {"a": [1.0, 2.0]}, {"offset": jnp.float32(2)}, lanes=1).attrs["resumed"] >= 1


@pytest.mark.parametrize(
    ("count", "over", "said"),
    [
        (1, None, ""),
        (3, None, " 3 seeds: intervals are wide."),
        (5, None, ""),
        (3, (8, "rooms"), ""),
        (3, (4, "rooms"), " 4 rooms: intervals are wide."),
    ],
)
def test_a_caption_says_where_intervals_are_wide(job, count, over, said):
    job.record("T", "What is seen.", range(count), time.perf_counter(), over=over)
    facts = json.loads((job.out / "provenance.json").read_text())
    assert facts["caption"] == "What is seen." + said and "over" not in facts

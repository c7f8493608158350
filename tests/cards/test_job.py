"""What a card's job keeps between runs."""

import os
import time

import jax.numpy as jnp
import pytest

from ovibjax import sweep
from ovibjax.cards.job import _remove_old


def fn(key, point, shared):
    return {"y": point["a"] * jnp.float32(2)}


def stored(path, stop_after=None):
    def on_progress(done, total):
        if stop_after is not None and done >= stop_after:
            raise KeyboardInterrupt

    return sweep.run(fn, {"a": [1.0, 2.0, 3.0]}, store=path, chunk=1, on_progress=on_progress)


def test_only_finished_sweeps_that_nobody_used_for_long_are_removed(tmp_path):
    names = ("old_finished", "old_unfinished", "new_finished")
    paths = {name: tmp_path / f"{name}.zarr" for name in names}
    stored(paths["old_finished"])
    with pytest.raises(sweep.Interrupted):
        stored(paths["old_unfinished"], stop_after=1)
    stored(paths["new_finished"])
    (tmp_path / "thesis.zarr").mkdir()
    long_ago = time.time() - 30 * 24 * 3600
    for name in ("old_finished", "old_unfinished"):
        os.utime(paths[name], (long_ago, long_ago))
    os.utime(tmp_path / "thesis.zarr", (long_ago, long_ago))
    _remove_old(tmp_path)
    assert not paths["old_finished"].exists()
    assert paths["old_unfinished"].exists() and paths["new_finished"].exists() and (tmp_path / "thesis.zarr").exists()

"""What a card's job keeps between runs, and what becomes of cards that the data do not allow."""

import os
import time

import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax import sweep
from ovibjax.cards import catalog
from ovibjax.cards.job import _remove_old
from ovibjax.cards.reproduce import reproduce
from ovibjax.errors import InputError
from ovibjax.features.feature_files import save
from ovibjax.features.frames import make_feature_set


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


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """Somebody's data, and two cards: one that the data do not allow, one that writes a file."""
    cards = tmp_path / "cards"
    cards.mkdir()
    start = "from ovibjax.errors import InputError\nTITLE = 'T'\ndef run(job):\n    "
    (cards / "a_picky.py").write_text(start + "raise InputError(f'{job.source}: no contexts')\n")
    (cards / "b_easy.py").write_text(start + "(job.out / 'made').write_text('')\n")
    monkeypatch.setattr(catalog, "cards_folder", lambda: cards)
    rng = np.random.default_rng(0)
    save(tmp_path / "mine.npz", make_feature_set(rng.normal(size=(220, 5, 8)), rng.uniform(size=(220, 3))))
    return tmp_path


def test_a_figure_that_the_data_do_not_allow_is_named_and_the_others_are_made(mine, capsys):
    reproduce("smoke", data=[mine / "mine.npz"], out=mine / "out")
    said = "".join(capsys.readouterr().err.split())  # lines may be wrapped anywhere
    assert "a_picky:leftout" in said and "mine.npz:nocontexts" in said
    assert (mine / "out" / "b_easy" / "made").exists() and not (mine / "out" / "a_picky").exists()


def test_a_figure_asked_for_by_name_is_refused(mine):
    with pytest.raises(InputError, match="no contexts"):
        reproduce("smoke", ["a_picky"], data=[mine / "mine.npz"], out=mine / "out")
    (mine / "cards" / "b_easy.py").unlink()
    with pytest.raises(InputError, match="allows no figure"):
        reproduce("smoke", data=[mine / "mine.npz"], out=mine / "out")

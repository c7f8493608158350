"""Stores of the format of before (Zarr arrays of fixed size) are brought over, to be read."""

import numpy as np
import pytest
import zarr

from ovibjax.errors import InputError
from ovibjax.sweep.engine import run
from ovibjax.sweep.old_format import upgrade
from ovibjax.sweep.store import config_of, open_dataset
from tests.sweep.members import DATA, small, snapshot_of

RATES, KINDS, SEEDS = [0.1, 0.2, 0.3], ["mean", "max", "vit"], [4, 5]


def old_store(path):
    """Rates zipped with names, and seeds: two chunks of four places, of which one is not finished."""
    layout = {
        "axes": {
            "rate": {"values": RATES, "unit": "m"},
            "kind": {"values": KINDS, "unit": ""},
            "seed": {"values": SEEDS, "unit": ""},
        },
        "groups": [["rate", "kind"], ["seed"]],
        "chunks": {"outer": 1, "rows": 1, "columns": 4, "order": "0" * 16},
        "variables": {
            "wave": {"shape": [2], "dtype": "float32", "dims": ["t"], "unit": "V"},
            "n": {"shape": [], "dtype": "int32", "dims": [], "unit": ""},
        },
        "coords": {"t": {"values": [0.5, 1.5], "unit": "s"}},
    }
    config = {"function": "mine.fn", "settings": {"steps": 3}, "program": "0" * 64, "data": "ab" * 32}
    config |= {"execution": {"rows": 1, "columns": 4, "lanes": 4, "devices": 1}}
    members = np.array([0, 2, 4, -1, 1, 3, 5, -1])
    group = zarr.create_group(
        path, zarr_format=3, attributes={"format": 1, "hash": "", "config": config, "layout": layout}
    )
    arrays = {"grid_index": members, "finished": np.array([True, False]), "diverged": members == 2}
    arrays |= {"wave": np.stack([members, members * 10], 1).astype(np.float32), "n": members.astype(np.int32) + 7}
    for name, values in arrays.items():
        made = group.create_array(name, shape=values.shape, chunks=values.shape, dtype=values.dtype)
        made[...] = values
    return path


def test_finished_members_are_brought_over(tmp_path):
    path = old_store(tmp_path / "old.zarr")
    before = snapshot_of(path)
    assert upgrade(path, tmp_path / "new.zarr") == 3
    dataset = open_dataset(tmp_path / "new.zarr")
    assert dataset.finished.dims == ("rate_kind", "seed") and dataset.finished.all()
    assert dataset.rate.values.tolist() == RATES and dataset.rate.units == "m" and dataset.kind.values.tolist() == KINDS
    assert dataset.seed.values.tolist() == [4]
    assert dataset.wave.values.tolist() == [[[0, 0]], [[2, 20]], [[4, 40]]] and dataset.wave.units == "V"
    assert dataset.t.values.tolist() == [0.5, 1.5] and dataset.n.values.tolist() == [[7], [9], [11]]
    assert dataset.diverged.values.tolist() == [[False], [True], [False]]
    assert config_of(tmp_path / "new.zarr")["settings"] == {"steps": 3}
    assert snapshot_of(path) == before
    assert upgrade(path, tmp_path / "new.zarr") == 3  # as after a kill
    assert len(list((tmp_path / "new.zarr" / "members").iterdir())) == 1


def refused(function, *args, **options):
    with pytest.raises(InputError) as caught:
        function(*args, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_an_old_store_says_how_it_is_brought_over(tmp_path):
    path = old_store(tmp_path / "old.zarr")
    for message in (refused(open_dataset, path), refused(run, small, {"rate": [0.1]}, DATA, store=path)):
        assert f"ovibjax sweep upgrade {path} --out" in message


def test_what_was_brought_over_does_not_grow(tmp_path):
    upgrade(old_store(tmp_path / "old.zarr"), tmp_path / "new.zarr")
    before = snapshot_of(tmp_path)
    message = refused(run, small, {"rate": [0.1]}, DATA, store=tmp_path / "new.zarr")
    assert "an older version" in message and "can only be read" in message
    assert snapshot_of(tmp_path) == before


def test_what_is_no_old_store_is_refused(tmp_path):
    run(small, {"rate": [0.1]}, DATA, store=tmp_path / "new.zarr")
    zarr.create_group(tmp_path / "other.zarr", zarr_format=3, attributes={"title": "not ours"})
    damaged = old_store(tmp_path / "damaged.zarr")
    (damaged / "wave" / "zarr.json").unlink()
    assert "has today's format already" in refused(upgrade, tmp_path / "new.zarr", tmp_path / "x.zarr")
    for name in ("none.zarr", "other.zarr", "damaged.zarr"):
        assert "no store of the format of before, or damaged" in refused(upgrade, tmp_path / name, tmp_path / "x.zarr")
    assert not (tmp_path / "x.zarr").exists()

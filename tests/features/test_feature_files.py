"""Feature sets on disk: exact round trips, writes that leave the old file, and the layout of one file per view."""

import itertools
import os
from pathlib import Path

import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.features import npz
from ovibjax.features.feature_files import load, save
from ovibjax.features.frames import FeatureSet, make_feature_set
from ovibjax.views import VIEWS
from tests.features.cases import assert_refused, assert_same, example, listing, write_view_folder


@pytest.mark.parametrize(("views", "dim"), [(5, 8), (4, 512), (5, 7), (4, 2)])
def test_round_trip_is_exact(tmp_path, views, dim):
    fs = example(9, views, dim)
    save(tmp_path / "a.npz", fs)
    assert_same(load(tmp_path / "a.npz"), fs)
    assert listing(tmp_path) == ["a.npz"]


def test_large_members_are_read_in_chunks(tmp_path, monkeypatch):
    monkeypatch.setattr(npz, "_CHUNK_BYTES", 1000)
    fs = example(40, 5, 64)
    np.savez_compressed(tmp_path / "a.npz", **fs._asdict())
    assert_same(load(str(tmp_path / "a.npz")), fs)


def test_other_array_orders_and_byte_orders_load(tmp_path):
    fs = example()
    np.savez(
        tmp_path / "a.npz",
        features=np.asfortranarray(fs.features.astype(">f4")),
        positions_m=fs.positions_m.astype(">f8"),
        yaw_rad=fs.yaw_rad,
        context=fs.context.astype(np.int8),
        scene_id=fs.scene_id.astype(np.uint64),
        frame_id=fs.frame_id.astype(">U30"),
    )
    assert_same(load(tmp_path / "a.npz"), fs)


def test_saved_file_is_plain_npz_and_reproducible(tmp_path):
    save(tmp_path / "a.npz", example())
    save(tmp_path / "b.npz", example())
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    with np.load(tmp_path / "a.npz", allow_pickle=False) as arrays:
        assert tuple(arrays) == FeatureSet._fields


@pytest.mark.parametrize("point", ["write_array", "fsync", "replace"])
@pytest.mark.parametrize("cause", [KeyboardInterrupt, OSError])
def test_interrupted_save_leaves_the_old_file(tmp_path, monkeypatch, point, cause):
    path = tmp_path / "a.npz"
    save(path, example(6))
    calls = itertools.count()
    real = npz.npy.write_array

    def fail(*args, **kwargs):
        if point == "write_array" and next(calls) < 2:
            return real(*args, **kwargs)
        raise cause("stopped")

    target = {"write_array": npz.npy, "fsync": os, "replace": Path}[point]
    with monkeypatch.context() as patch:
        patch.setattr(target, point, fail)
        with pytest.raises(InputError if cause is OSError else KeyboardInterrupt) as error:
            save(path, example(7))
    if cause is OSError:
        assert_refused(error, "a.npz", "cannot be written")
    assert listing(tmp_path) == ["a.npz"]
    assert_same(load(path), example(6))


@pytest.mark.parametrize("where", ["absent/a.npz", "folder", "", "a\0b.npz", "a\0b/c.npz", "x" * 300])
def test_save_refuses_bad_places(tmp_path, where):
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError) as error:
        save(tmp_path / where if where else "", example())
    assert_refused(error, "cannot be written")
    assert listing(tmp_path) == ["folder"]


@pytest.mark.parametrize("dim", [512, 7, 1280])
@pytest.mark.parametrize("cameras", [VIEWS, VIEWS[:4]])
@pytest.mark.parametrize("one_row", [False, True])
def test_view_folders_load(tmp_path, dim, cameras, one_row):
    raw = write_view_folder(tmp_path / "view_features", 3, dim, cameras, one_row)
    calls = []
    fs = load(tmp_path, on_frame=lambda done, total: calls.append((done, total)))
    assert_same(fs, make_feature_set(raw, [[0, 2, 3], [1, 2, 3], [2, 2, 3]]))
    assert_same(load(tmp_path / "view_features"), fs)
    assert calls == [(1, 3), (2, 3), (3, 3)]


def test_flat_positions_and_stray_files(tmp_path):
    write_view_folder(tmp_path, 2, flat=True)
    (tmp_path / "Back" / ".DS_Store").write_bytes(b"x")
    (tmp_path / "Back" / "._000000.npz").write_bytes(b"x")
    (tmp_path / "Left" / "notes.txt").write_bytes(b"x")
    np.savez(tmp_path / "Down" / "000001.npz", **np.load(tmp_path / "Down" / "000001.npz"), note=np.array([None]))
    assert load(tmp_path).positions_m.tolist() == [[0, 2, 0], [1, 2, 0]]


def test_numbered_frames_keep_their_order(tmp_path):
    raw = write_view_folder(tmp_path, 3)
    for camera in VIEWS:
        for old, new in (("000000", "2"), ("000001", "10"), ("000002", "9")):
            (tmp_path / camera / f"{old}.npz").rename(tmp_path / camera / f"{new}.npz")
    fs = load(tmp_path)
    assert fs.frame_id.tolist() == ["2", "9", "10"]
    np.testing.assert_array_equal(fs.features, make_feature_set(raw[[0, 2, 1]], np.zeros((3, 3))).features)


def replace_frame(root, camera, frame="000002", **arrays):
    path = root / camera / f"{frame}.npz"
    old = dict(np.load(path))
    np.savez(path, **{key: value for key, value in (old | arrays).items() if value is not None})


def damage_missing_view(root):
    for file in (root / "Left").iterdir():
        file.unlink()
    (root / "Left").rmdir()


def damage_view_is_file(root):
    damage_missing_view(root)
    (root / "Left").write_bytes(b"")


def damage_all_empty(root):
    for camera in VIEWS:
        for file in (root / camera).iterdir():
            file.unlink()


def damage_odd_name(root):
    file = root / "Right" / "000001.npz"
    Path(os.fsdecode(os.fsencode(root / "Right") + b"/\xff\xfe.npz")).write_bytes(file.read_bytes())


def damage_frame_is_folder(root):
    (root / "Back" / "000002.npz").unlink()
    (root / "Back" / "000002.npz").mkdir()


def damage_zero(root):
    replace_frame(root, "Right", feature=np.zeros(8))


DAMAGE = {
    "missing view": (damage_missing_view, ["missing view folder", "Left"]),
    "view is a file": (damage_view_is_file, ["missing view folder", "Left"]),
    "all empty": (damage_all_empty, ["Front", "no frames"]),
    "frame missing": (lambda r: (r / "Back" / "000001.npz").unlink(), ["000001", "in Front", "not in Back"]),
    "frame added": (lambda r: (r / "Down" / "x.npz").write_bytes(b""), ["'x'", "in Down", "not in Front"]),
    "odd name": (damage_odd_name, ["Right", r"\udcff", "file name"]),
    "frame is a folder": (damage_frame_is_folder, ["Back/000002.npz", "not a regular file"]),
    "not a zip": (
        lambda r: (r / "Down" / "000003.npz").write_bytes(b"x"),
        ["Down/000003.npz", "not an .npz"],
    ),
    "no feature": (
        lambda r: replace_frame(r, "Back", feature=None),
        ["Back/000002.npz", "missing", "'feature'"],
    ),
    "no position": (lambda r: replace_frame(r, "Back", position=None), ["Back/000002.npz", "'position'"]),
    "pickled": (
        lambda r: replace_frame(r, "Back", position=np.array({"x": 1.0}, dtype=object)),
        ["Back/000002.npz", "'position'", "pickled"],
    ),
    "dimension": (lambda r: replace_frame(r, "Left", feature=np.ones(9)), ["Left/000002.npz", "dimension 9"]),
    "matrix": (
        lambda r: replace_frame(r, "Left", feature=np.ones((2, 4))),
        ["Left/000002.npz", "shape (2, 4)"],
    ),
    "scalar": (lambda r: replace_frame(r, "Left", feature=np.float32(1)), ["Left/000002.npz", "shape ()"]),
    "complex": (lambda r: replace_frame(r, "Left", feature=np.ones(8) * 1j), ["Left/000002.npz", "complex"]),
    "text": (lambda r: replace_frame(r, "Left", feature=np.full(8, "a")), ["Left/000002.npz", "<U1"]),
    "nan": (
        lambda r: replace_frame(r, "Left", feature=np.full(8, np.nan)),
        ["Left/000002.npz", "not finite"],
    ),
    "huge": (
        lambda r: replace_frame(r, "Left", feature=np.full(8, 1e300)),
        ["000002, view Left", "not finite"],
    ),
    "zero": (damage_zero, ["000002, view Right", "zero norm"]),
    "nan position": (
        lambda r: replace_frame(r, "Down", position=np.array([np.nan, 2, 3])),
        ["Down/000002.npz", "'position'", "not finite"],
    ),
    "far position": (lambda r: replace_frame(r, "Down", position=[2.002, 2, 3]), ["Down/000002.npz", "1 mm"]),
    "long position": (
        lambda r: replace_frame(r, "Down", position=np.ones(4)),
        ["Down/000002.npz", "4 coord"],
    ),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_damaged_view_folders_are_refused(tmp_path, name):
    damage, words = DAMAGE[name]
    write_view_folder(tmp_path)
    damage(tmp_path)
    with pytest.raises(InputError) as error:
        load(tmp_path)
    assert_refused(error, tmp_path.name, *words)


def test_frames_of_another_dimension_are_refused(tmp_path):
    write_view_folder(tmp_path)
    for camera in VIEWS:
        replace_frame(tmp_path, camera, feature=np.ones(9))
    with pytest.raises(InputError) as error:
        load(tmp_path)
    assert_refused(error, "Front/000002.npz", "dimension 9", "000000", "8")


def test_positions_may_differ_by_less_than_a_millimetre(tmp_path):
    write_view_folder(tmp_path)
    replace_frame(tmp_path, "Down", position=[2.0005, 2, 3])
    assert load(tmp_path).positions_m[2].tolist() == [2, 2, 3]


def test_empty_folder_is_refused(tmp_path):
    with pytest.raises(InputError) as error:
        load(tmp_path)
    assert_refused(error, tmp_path.name, "missing view folder", "Front")

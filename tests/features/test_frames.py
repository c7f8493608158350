import itertools
import os
import pickle
import re
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.errors import InputError
from ovibjax.features import npz
from ovibjax.features.feature_files import load, save
from ovibjax.features.frames import CONTEXTS, FeatureSet, content_hash, make_feature_set, validate
from ovibjax.features.splits import require_frames, split_indices
from ovibjax.views import VIEWS


def raw_features(n=6, views=5, dim=8, seed=0):
    return np.random.default_rng(seed).normal(size=(n, views, dim)).astype(np.float32)


def example(n=6, views=5, dim=8):
    return make_feature_set(
        raw_features(n, views, dim),
        np.arange(3 * n, dtype=np.float32).reshape(n, 3),
        yaw_rad=np.linspace(-3, 3, n),
        context=np.arange(n) % 4 - 1,
        scene_id=np.arange(n) // 2,
        frame_id=[f"frame {i}" for i in range(n)],
    )


def assert_same(left: FeatureSet, right: FeatureSet) -> None:
    for name, a, b in zip(FeatureSet._fields, left, right, strict=True):
        assert a.dtype == b.dtype, name
        np.testing.assert_array_equal(a, b, strict=True, err_msg=name)


def assert_refused(error: pytest.ExceptionInfo, *words: str) -> None:
    message = str(error.value)
    assert len(message.splitlines()) == 1 and message.isprintable(), message
    for word in words:
        assert word in message, (word, message)


def listing(folder: Path) -> list[str]:
    return sorted(file.name for file in folder.iterdir())


def write_view_folder(root, n=4, dim=8, cameras=VIEWS, one_row=False, flat=False):
    features = raw_features(n, len(cameras), dim)
    for view, camera in enumerate(cameras):
        (root / camera).mkdir(parents=True)
        for frame in range(n):
            feature = features[frame, view][None] if one_row else features[frame, view]
            position = np.array([frame, 2.0, 3.0])[: 2 if flat else 3]
            np.savez_compressed(root / camera / f"{frame:06d}.npz", feature=feature, position=position)
    return features


# --- making and validating ---------------------------------------------------------------------------------


def test_defaults_and_dtypes():
    fs = make_feature_set(raw_features(3).astype(np.float64), np.zeros((3, 3)))
    assert [a.dtype.name for a in fs] == ["float32", "float32", "float32", "int32", "int32", "str192"]
    assert fs.frame_id.tolist() == ["000000", "000001", "000002"]
    assert not fs.yaw_rad.any() and not fs.scene_id.any() and (fs.context == -1).all()
    assert CONTEXTS == ("corridor", "intersection", "repetitive")


def test_integer_frame_ids_become_padded_text():
    assert make_feature_set(raw_features(2), np.zeros((2, 3)), frame_id=[7, 1234567]).frame_id.tolist() == [
        "000007",
        "1234567",
    ]


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, np.int32, ">f4"])
def test_features_become_unit_norm(dtype):
    raw = (50 * raw_features()).astype(dtype)
    fs = make_feature_set(raw, np.zeros((6, 3)))
    exact = raw.astype(np.float64) / np.linalg.norm(raw.astype(np.float64), axis=-1, keepdims=True)
    np.testing.assert_allclose(fs.features, exact, rtol=1e-6, atol=1e-7)


@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-300, 1e-160, 1e-30, 1.0, 1e30, 1e160, 1e300]))
@settings(max_examples=50, deadline=None)
def test_validate_is_idempotent_at_any_scale(seed, scale):
    fs = make_feature_set(scale * raw_features(2, seed=seed).astype(np.float64), np.zeros((2, 3)))
    np.testing.assert_allclose(np.linalg.norm(fs.features, axis=-1), 1, rtol=1e-6)
    assert_same(validate(fs), fs)


def test_normalising_in_blocks_equals_normalising_at_once(monkeypatch):
    whole = make_feature_set(raw_features(7), np.zeros((7, 3)))
    monkeypatch.setattr("ovibjax.features.frames._BLOCK_FRAMES", 3)
    assert_same(make_feature_set(raw_features(7), np.zeros((7, 3))), whole)


def changed(index, value):
    array = raw_features()
    array[index] = value
    return array


BAD_FIELDS = {
    "nan feature": ({"features": changed((4, 2, 1), np.nan)}, ["000004", "Left", "not finite"]),
    "inf feature": ({"features": changed((0, 4, 0), np.inf)}, ["000000", "Down", "not finite"]),
    "zero feature": ({"features": changed((5, 0), 0)}, ["000005", "Front", "zero norm"]),
    "complex": ({"features": raw_features() + 0j}, ["features", "complex64"]),
    "text": ({"features": np.full((6, 5, 8), "x")}, ["features", "dtype"]),
    "objects": ({"features": np.full((6, 5, 8), None)}, ["features", "object"]),
    "booleans": ({"features": np.ones((6, 5, 8), bool)}, ["features", "bool"]),
    "ragged": ({"features": [[1.0], [1.0, 2.0]]}, ["features", "rectangular"]),
    "two axes": ({"features": np.ones((6, 40))}, ["features", "shape [6, 40]", "[N, M, d]"]),
    "three views": ({"features": np.ones((6, 3, 8))}, ["3 views"]),
    "six views": ({"features": np.ones((6, 6, 8))}, ["6 views"]),
    "one dimension": ({"features": np.ones((6, 5, 1))}, ["dimension 1"]),
    "no frames": ({"features": np.ones((0, 5, 8)), "positions_m": np.ones((0, 3))}, ["no frames"]),
    "positions short": ({"positions_m": np.ones((5, 3))}, ["positions_m", "[5, 3]", "[6, 3]"]),
    "positions flat": ({"positions_m": np.ones((6, 2))}, ["positions_m", "[6, 2]"]),
    "nan position": ({"positions_m": np.full((6, 3), np.nan)}, ["000000", "positions_m", "not finite"]),
    "huge position": ({"positions_m": np.full((6, 3), 1e300)}, ["positions_m", "not finite"]),
    "yaw column": ({"yaw_rad": np.ones((6, 1))}, ["yaw_rad", "shape"]),
    "inf yaw": ({"yaw_rad": np.array([0, 0, 0, -np.inf, 0, 0])}, ["000003", "yaw_rad", "not finite"]),
    "context high": ({"context": [0, 1, 2, 3, 0, 0]}, ["000003", "context", "range"]),
    "context low": ({"context": [0, -2, 2, 0, 0, 0]}, ["000001", "context", "range"]),
    "context real": ({"context": np.zeros(6)}, ["context", "integers"]),
    "scene negative": ({"scene_id": [0, 0, 0, 0, 0, -1]}, ["000005", "scene_id", "range"]),
    "scene huge": ({"scene_id": np.full(6, 2**40)}, ["scene_id", "range"]),
    "scene short": ({"scene_id": np.zeros(5, int)}, ["scene_id", "shape"]),
    "id empty": ({"frame_id": ["a", "", "b", "c", "d", "e"]}, ["frame_id", "frame 1"]),
    "id newline": ({"frame_id": ["a", "b", "c\nd", "e", "f", "g"]}, ["frame_id", "frame 2"]),
    "id long": ({"frame_id": ["x" * 256, "b", "c", "d", "e", "f"]}, ["frame_id", "frame 0"]),
    "id real": ({"frame_id": np.zeros(6)}, ["frame_id", "text"]),
    "id bytes": ({"frame_id": np.full(6, b"x")}, ["frame_id", "text"]),
    "id short": ({"frame_id": ["a"]}, ["frame_id", "shape"]),
}


@pytest.mark.parametrize("name", BAD_FIELDS)
def test_bad_fields_are_refused_in_memory(name):
    fields, words = BAD_FIELDS[name]
    with pytest.raises(InputError) as error:
        make_feature_set(**{"features": raw_features(), "positions_m": np.zeros((6, 3)), **fields}, source="town")
    assert_refused(error, "town:", *words)


@pytest.mark.parametrize("name", [name for name in BAD_FIELDS if name != "ragged"])
def test_bad_fields_are_refused_in_a_file(name, tmp_path):
    fields, words = BAD_FIELDS[name]
    in_reader = {
        "complex",
        "objects",
        "booleans",
        "id bytes",
    }  # refused by dtype before the fields are looked at
    path = tmp_path / "town.npz"
    np.savez(path, **{"features": raw_features(), "positions_m": np.zeros((6, 3)), **fields})
    with pytest.raises(InputError) as error:
        load(path)
    assert_refused(error, "town.npz", *(words[:1] if name in in_reader else words))
    with pytest.raises(InputError):
        save(tmp_path / "again.npz", example()._replace(**{k: np.asarray(v) for k, v in fields.items()}))
    assert not (tmp_path / "again.npz").exists()


# --- one file ----------------------------------------------------------------------------------------------


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


# --- hostile files -----------------------------------------------------------------------------------------


def npy_bytes(header: str, payload: bytes = b"", version=(1, 0)) -> bytes:
    size = struct.pack("<H" if version == (1, 0) else "<I", len(header))
    return b"\x93NUMPY" + bytes(version) + size + header.encode("latin1") + payload


def head(descr="'<f4'", shape="(6, 5, 8)"):
    return f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}"


class Sentinel:
    fired = False

    def __reduce__(self):
        return setattr, (Sentinel, "fired", True)


GOOD = raw_features().tobytes()
BAD_MEMBERS = {
    "no magic": (b"hello", ["magic"]),
    "empty": (b"", ["features"]),
    "raw pickle": (pickle.dumps([1, 2]), ["magic"]),
    "pickled header": (npy_bytes(head("'|O'"), pickle.dumps([1])), ["pickled"]),
    "structured pickle": (npy_bytes(head("[('a', '|O')]"), pickle.dumps([1])), ["pickled"]),
    "structured": (npy_bytes(head("[('a', '<f4')]"), GOOD), ["dtype"]),
    "nested shape": (npy_bytes(head("('<f4', (2,))"), GOOD), ["dtype"]),
    "bytes dtype": (npy_bytes(head("'|S4'"), GOOD), ["dtype"]),
    "dates": (npy_bytes(head("'<M8[s]'"), GOOD + GOOD), ["dtype"]),
    "empty text": (npy_bytes(head("'<U0'")), ["dtype"]),
    "huge shape": (npy_bytes(head(shape="(4000000000, 5, 512)"), GOOD), ["shape", "4000000000"]),
    "overflowing shape": (npy_bytes(head(shape=f"({2**62}, {2**62}, 4)"), GOOD), ["shape"]),
    "huge and zero": (npy_bytes(head(shape=f"(0, {2**80}, 4)")), ["features"]),
    "negative shape": (npy_bytes(head(shape="(-6, -5, 8)"), GOOD), ["shape"]),
    "short": (npy_bytes(head(), GOOD[:-4]), ["shape"]),
    "trailing bytes": (npy_bytes(head(), GOOD + b"x"), ["shape"]),
    "no shape": (npy_bytes("{'descr': '<f4', 'fortran_order': False}", GOOD), ["keys"]),
    "bad literal": (npy_bytes("{'descr': ", GOOD), ["features"]),
    "call in header": (npy_bytes(head("__import__('os')"), GOOD), ["features"]),
    "deep header": (npy_bytes("(" * 9000, GOOD), ["features"]),
    "escape in header": (npy_bytes(head(r"'\d'"), GOOD), ["features"]),
    "long header": (npy_bytes(" " * 2**20 + head(), GOOD, (2, 0)), ["features"]),
    "version 3": (npy_bytes(head(), GOOD, (3, 0)), ["version"]),
    "version 9": (npy_bytes(head(), GOOD, (9, 9)), ["features"]),
}


def write_members(path, members, **options):
    with zipfile.ZipFile(path, "w", **options) as archive:
        for key, data in members.items():
            archive.writestr(key, data)


def positions_bytes():
    return npy_bytes(head(shape="(6, 3)"), bytes(72))


@pytest.mark.parametrize("name", BAD_MEMBERS)
@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_hostile_arrays_are_refused(tmp_path, name, method):
    data, words = BAD_MEMBERS[name]
    path = tmp_path / "bad.npz"
    write_members(path, {"features.npy": data, "positions_m.npy": positions_bytes()}, compression=method)
    with pytest.raises(InputError) as error:
        load(path)
    assert_refused(error, "bad.npz", "features", *words)


def test_text_beyond_unicode_is_refused(tmp_path):
    members = {"features.npy": npy_bytes(head(), GOOD), "positions_m.npy": positions_bytes()}
    for descr, code in (("'<U1'", "<I"), ("'>U1'", ">I")):
        ids = struct.pack(code, 0x110000) * 6
        write_members(tmp_path / "bad.npz", members | {"frame_id.npy": npy_bytes(head(descr, "(6,)"), ids)})
        with pytest.raises(InputError) as error:
            load(tmp_path / "bad.npz")
        assert_refused(error, "bad.npz", "frame_id", "text")
    surrogate = npy_bytes(head("'<U1'", "(6,)"), struct.pack("<I", 0xD800) * 6)
    write_members(tmp_path / "bad.npz", members | {"frame_id.npy": surrogate})
    with pytest.raises(InputError) as error:
        load(tmp_path / "bad.npz")
    assert_refused(error, "bad.npz", "frame_id", "printable")


def test_python_2_headers_load_without_warning(tmp_path):
    members = {
        "features.npy": npy_bytes(head(shape="(6L, 5L, 8L)"), GOOD),
        "positions_m.npy": positions_bytes(),
    }
    write_members(tmp_path / "old.npz", members)
    assert load(tmp_path / "old.npz").features.shape == (6, 5, 8)


@pytest.mark.parametrize("key", ["features", "positions_m", "frame_id", "note"])
def test_pickles_are_refused_and_never_run(tmp_path, key):
    Sentinel.fired = False
    payload = np.empty(6, object)
    payload[:] = [Sentinel() for _ in range(6)]
    path = tmp_path / "evil.npz"
    np.savez(path, **(example()._asdict() | {key: payload}))
    with pytest.raises(InputError) as error:
        load(path)
    assert_refused(error, "evil.npz", key, "unknown" if key == "note" else "pickled")
    assert not Sentinel.fired
    with np.load(path, allow_pickle=True) as arrays:
        _ = arrays[key]
    assert Sentinel.fired, "the payload is live: only the reader kept it from running"


def patched_directory(data: bytes, member: bytes, offset: int, value: bytes) -> bytes:
    """An archive with bytes of one central directory entry replaced; offsets as in the zip specification."""
    entry = data.rindex(b"PK\x01\x02", 0, data.rindex(member))
    return data[: entry + offset] + value + data[entry + offset + len(value) :]


@pytest.mark.parametrize(
    ("offset", "value", "word"),
    [
        (24, struct.pack("<I", 2**31), "claims"),  # uncompressed size
        (20, struct.pack("<II", 2**31, 2**31), "claims"),  # both sizes
        (8, struct.pack("<H", 1), "encrypted"),  # flags
        (10, struct.pack("<H", 14), "method"),  # LZMA, whose decoder takes what memory the data names
        (10, struct.pack("<H", 99), "method"),
        (16, b"\0\0\0\0", "CRC"),
        (42, struct.pack("<I", 10**6), "features"),  # where the member begins
        (
            32,
            struct.pack("<H", 46 + len("positions_m.npy")),
            "only 1",
        ),  # a comment that swallows the next entry
    ],
)
def test_lying_directories_are_refused(tmp_path, offset, value, word):
    path = tmp_path / "lie.npz"
    write_members(path, {"features.npy": npy_bytes(head(), GOOD), "positions_m.npy": positions_bytes()})
    assert load(path).features.shape == (6, 5, 8)
    path.write_bytes(patched_directory(path.read_bytes(), b"features.npy", offset, value))
    with pytest.raises(InputError) as error:
        load(path)
    assert_refused(error, "lie.npz", word)


def test_archives_beyond_the_cap_are_refused(tmp_path, monkeypatch):
    save(tmp_path / "big.npz", example())
    assert npz.MAX_TOTAL_BYTES == 16 * 2**30
    monkeypatch.setattr(npz, "MAX_TOTAL_BYTES", 1000)
    with pytest.raises(InputError) as error:
        load(tmp_path / "big.npz")
    assert_refused(error, "big.npz", "too large", "1000")


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("second", ["features.npy", "features"])
def test_two_arrays_of_one_name_are_refused(tmp_path, second):
    with zipfile.ZipFile(tmp_path / "two.npz", "w") as archive:
        for name in ("features.npy", second, "positions_m.npy"):
            archive.writestr(name, b"")
    with pytest.raises(InputError) as error:
        load(tmp_path / "two.npz")
    assert_refused(error, "two.npz", "share a name")


@pytest.mark.parametrize("key", ["features", "positions_m"])
def test_missing_arrays_are_named(tmp_path, key):
    fields = example()._asdict()
    del fields[key]
    np.savez(tmp_path / "part.npz", **fields)
    with pytest.raises(InputError) as error:
        load(tmp_path / "part.npz")
    assert_refused(error, "part.npz", "missing", key)


def test_unknown_arrays_are_named(tmp_path):
    np.savez(tmp_path / "more.npz", **example()._asdict(), yaw=np.zeros(6))
    with pytest.raises(InputError) as error:
        load(tmp_path / "more.npz")
    assert_refused(error, "more.npz", "unknown", "'yaw'")


@pytest.mark.parametrize("content", [b"", b"hello", pickle.dumps({"a": 1}), b"PK\x05\x06" + bytes(18), b"PK\x03\x04"])
def test_other_files_are_refused(tmp_path, content):
    (tmp_path / "other.npz").write_bytes(content)
    with pytest.raises(InputError) as error:
        load(tmp_path / "other.npz")
    assert_refused(error, "other.npz", "missing" if content.startswith(b"PK\x05") else "not an .npz")


@pytest.mark.parametrize("name", ["absent.npz", "a\nb.npz", "a\0b.npz", "\udc80.npz", "x" * 300, "file.npz/inside.npz"])
def test_missing_paths_are_refused(tmp_path, name):
    (tmp_path / "file.npz").write_bytes(b"")
    with pytest.raises(InputError) as error:
        load(tmp_path / name)
    assert_refused(error, "no such file" if len(name) < 300 else "unreadable path")


def test_special_files_are_refused_without_waiting(tmp_path):
    os.mkfifo(tmp_path / "pipe.npz")
    with pytest.raises(InputError) as error:
        load(tmp_path / "pipe.npz")
    assert_refused(error, "pipe.npz", "not a regular file")


@pytest.mark.parametrize("savez", [np.savez, np.savez_compressed])
def test_damaged_files_give_a_set_or_a_refusal(tmp_path, savez):
    path = tmp_path / "damaged.npz"
    savez(path, **example()._asdict())
    good = path.read_bytes()
    # Half the flips land in zip and array headers, where they do most harm.
    marks = [m.start() for m in re.finditer(rb"PK|\x93NUMPY", good)]
    rng = np.random.default_rng(5)
    outcomes = {"refused": 0, "loaded": 0}
    for trial in range(300):
        data = bytearray(good)
        if trial % 3 == 0:
            data = data[: rng.integers(len(good))]
        else:
            for _ in range(rng.integers(1, 4)):
                near = rng.choice(marks) + rng.integers(130) if trial % 3 == 1 else rng.integers(len(good))
                data[min(near, len(good) - 1)] ^= 1 << rng.integers(8)
        path.write_bytes(data)
        try:
            fs = load(path)
        except InputError as error:
            assert len(str(error).splitlines()) == 1 and "damaged.npz" in str(error)
            outcomes["refused"] += 1
        else:
            assert_same(fs, example())  # the checksum lets no changed value through
            outcomes["loaded"] += 1
    assert outcomes["refused"] > 200 and outcomes["loaded"] > 0, outcomes


# --- one file per view -------------------------------------------------------------------------------------


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


# --- splits and hashes -------------------------------------------------------------------------------------


def test_split_sizes_of_the_paper():
    assert [part.size for part in split_indices(4994, 0)] == [3495, 749, 750]


@given(st.integers(7, 5000), st.integers(0, 2**63))
@settings(max_examples=100, deadline=None)
def test_splits_are_disjoint_complete_sorted_and_repeatable(n, seed):
    split = split_indices(n, seed)
    np.testing.assert_array_equal(np.sort(np.concatenate(split)), np.arange(n))
    for part, again in zip(split, split_indices(n, seed), strict=True):
        assert part.size > 0 and (np.diff(part) > 0).all()
        np.testing.assert_array_equal(part, again)
    assert split.train.size == 7 * n // 10 and split.val.size == 15 * n // 100


def test_seeds_give_different_splits():
    parts = {split_indices(500, seed).test.tobytes() for seed in range(20)}
    assert len(parts) == 20


@pytest.mark.parametrize(("n", "seed", "word"), [(6, 0, "at least 7"), (-1, 0, "at least 7"), (500, -1, "seed -1")])
def test_bad_splits_are_refused(n, seed, word):
    with pytest.raises(InputError) as error:
        split_indices(n, seed)
    assert_refused(error, word)


def test_require_frames():
    fs = make_feature_set(raw_features(199), np.zeros((199, 3)))
    with pytest.raises(InputError) as error:
        require_frames(fs, source="town.npz")
    assert_refused(error, "town.npz", "199 frames", "at least 200")
    require_frames(fs, 199, "town.npz")


def test_content_hash_depends_on_every_value_and_nothing_else(tmp_path):
    fs = example()
    key = content_hash(fs)
    assert re.fullmatch("[0-9a-f]{64}", key)
    save(tmp_path / "a.npz", fs)
    assert content_hash(load(tmp_path / "a.npz")) == key == content_hash(example())
    wide = fs._replace(frame_id=fs.frame_id.astype("<U40"), features=np.asfortranarray(fs.features))
    assert content_hash(wide) == key
    others = {key}
    for name, array in fs._asdict().items():
        rolled = np.roll(array, 1)
        others.add(content_hash(fs._replace(**{name: rolled})))
        others.add(content_hash(fs._replace(**{name: array[:-1]})))
    assert len(others) == 13


def test_content_hash_is_the_same_on_every_run():
    fs = FeatureSet(
        np.full((1, 4, 4), 0.5, np.float32),
        np.array([[1, 2, 3]], np.float32),
        np.array([0.5], np.float32),
        np.array([2], np.int32),
        np.array([1], np.int32),
        np.array(["000042"]),
    )
    assert content_hash(fs) == "39f6ff65fa303bd25f2dcb295a13f544ea2b74bff0db53f3dd9f3827c82a7802"

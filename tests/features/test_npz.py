"""Archives that nobody vouches for: every hostile or damaged one is refused by name, and nothing is unpickled."""

import os
import pickle
import re
import struct
import zipfile

import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.features import npz
from ovibjax.features.feature_files import load, save
from tests.features.cases import assert_refused, assert_same, example, raw_features


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


@pytest.mark.parametrize("key", ["features", "positions_m", "frame_id"])
def test_pickles_are_refused_and_never_run(tmp_path, key):
    Sentinel.fired = False
    payload = np.empty(6, object)
    payload[:] = [Sentinel() for _ in range(6)]
    path = tmp_path / "evil.npz"
    np.savez(path, **(example()._asdict() | {key: payload}))
    with pytest.raises(InputError) as error:
        load(path)
    assert_refused(error, "evil.npz", key, "pickled")
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


@pytest.mark.parametrize("name", ["depth", "timestamp", "yaw", "notes", "frame_idx"])
def test_arrays_of_other_names_are_left_alone(tmp_path, name):
    Sentinel.fired = False
    payload = np.array([Sentinel()] * 6, object)
    np.savez(tmp_path / "more.npz", **example()._asdict(), **{name: payload})
    assert_same(load(tmp_path / "more.npz"), example())
    assert not Sentinel.fired


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("yaw", "yaw_rad"),
        ("contexts", "context"),
        ("scene", "scene_id"),
        ("frame_ids", "frame_id"),
        ("yaw_rads", "yaw_rad"),
    ],
)
def test_arrays_that_may_be_misspelt_are_named(tmp_path, name, meant):
    arrays = example()._asdict()
    np.savez(tmp_path / "more.npz", **{name: arrays.pop(meant)}, **arrays)
    with pytest.raises(InputError) as error:
        load(tmp_path / "more.npz")
    assert_refused(error, "more.npz", f"'{name}'", f"did you mean '{meant}'")


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

"""Feature sets: what is accepted, normalised and refused in memory and in a file, and the hash of their content."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.errors import InputError
from ovibjax.features.feature_files import load, save
from ovibjax.features.frames import CONTEXTS, FeatureSet, content_hash, make_feature_set, validate
from tests.features.cases import assert_refused, assert_same, example, raw_features


def test_defaults_and_dtypes():
    fs = make_feature_set(raw_features(3).astype(np.float64), np.zeros((3, 3)))
    assert [a.dtype.name for a in fs] == ["float32", "float64", "float32", "int32", "int32", "str192"]
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
    "huge position": ({"positions_m": np.full((6, 3), 1e300)}, ["positions_m", "beyond 1e+09 m"]),
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

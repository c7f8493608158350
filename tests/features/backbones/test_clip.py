"""CLIP without torch: features equal a slow NumPy tower, weights are found and checked, bad models are one line."""

import json

import ml_dtypes
import numpy as np
import pytest
from flax.serialization import msgpack_serialize
from flax.traverse_util import unflatten_dict

from ovibjax.errors import InputError
from ovibjax.features.backbones import clip as backbone_clip
from ovibjax.features.backbones.by_name import open_backbone
from tests.features.backbones.random_clip import DIM, HEADS, SIZE_PX, WIDTH, random_weights, write_config, write_model
from tests.oracles import clip as oracle

pytest.importorskip("safetensors")
pytest.importorskip("huggingface_hub")


@pytest.fixture(scope="module")
def weights():
    return random_weights()


@pytest.fixture(scope="module")
def folder(tmp_path_factory, weights):
    return write_model(tmp_path_factory.mktemp("clip"), weights)


@pytest.fixture(scope="module")
def inputs():
    return np.random.default_rng(1).normal(size=(19, 3, SIZE_PX, SIZE_PX)).astype(np.float32)


def refused(spec, *words):
    with pytest.raises(InputError) as caught:
        open_backbone(spec)
    assert "\n" not in str(caught.value) and all(word in str(caught.value) for word in words), caught.value


@pytest.mark.parametrize(("activation", "epsilon"), [("quick_gelu", 1e-5), ("gelu", 1e-5), ("quick_gelu", 0.1)])
def test_features_equal_those_of_a_tower_in_numpy(tmp_path, weights, inputs, activation, epsilon):
    write_model(tmp_path, weights, vision={"hidden_act": activation, "layer_norm_eps": epsilon})
    got = open_backbone(f"clip:{tmp_path}").embed(inputs)
    assert got.shape == (19, DIM) and got.dtype == np.float32
    for row in (0, 17, 18):
        expected = oracle.feature(weights, inputs[row], HEADS, activation, epsilon)
        np.testing.assert_allclose(got[row], expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("count", [1, 15, 16, 17, 40])
def test_a_feature_does_not_depend_on_what_else_is_there(folder, inputs, count):
    backbone = open_backbone(f"clip:{folder}")
    many = backbone.embed(np.concatenate([inputs] * 3)[:count])
    np.testing.assert_allclose(many[0], backbone.embed(inputs[:1])[0], atol=1e-5)
    assert len(many) == count


@pytest.mark.parametrize("dtype", [np.float16, ml_dtypes.bfloat16, np.float64])
def test_weights_of_any_precision_are_computed_in_single(tmp_path, weights, inputs, dtype):
    rounded = {name: array.astype(dtype) for name, array in weights.items()}
    write_model(tmp_path, rounded)
    got = open_backbone(f"clip:{tmp_path}").embed(inputs[:1])
    single = {name: array.astype(np.float32) for name, array in rounded.items()}
    assert got.dtype == np.float32
    np.testing.assert_allclose(got[0], oracle.feature(single, inputs[0], HEADS), rtol=1e-4, atol=1e-4)


def as_flax(weights):
    """The nested tree that flax models are saved as: kernels are transposed, scales and embeddings have names."""
    flat = {}
    for name, array in weights.items():
        *parts, kind = name.split(".")
        if kind == "weight" and "norm" in parts[-1]:
            kind = "scale"
        elif kind == "weight" and parts[-1] == "position_embedding":
            kind = "embedding"
        elif kind == "weight" and array.ndim >= 2:
            kind, array = "kernel", np.ascontiguousarray(array.transpose(2, 3, 1, 0) if array.ndim == 4 else array.T)
        flat[(*parts, kind)] = array
    return unflatten_dict(flat)


def test_weights_of_flax_are_read_where_there_are_no_others(tmp_path, folder, weights, inputs):
    write_config(tmp_path)
    (tmp_path / "flax_model.msgpack").write_bytes(msgpack_serialize(as_flax(weights)))
    backbone, other = open_backbone(f"clip:{tmp_path}"), open_backbone(f"clip:{folder}")
    np.testing.assert_array_equal(backbone.embed(inputs), other.embed(inputs))
    assert backbone.fingerprint == other.fingerprint
    (tmp_path / "flax_model.msgpack").write_bytes(b"\x81\xa1")
    refused(f"clip:{tmp_path}", "damaged")


def test_a_vision_model_alone_is_as_good(tmp_path, weights, inputs, folder):
    kept = {name: array for name, array in weights.items() if name.startswith("vis")}
    write_model(tmp_path, kept)
    whole = json.loads((tmp_path / "config.json").read_text())["vision_config"] | {"model_type": "clip_vision_model"}
    (tmp_path / "config.json").write_text(json.dumps(whole))
    expected = open_backbone(f"clip:{folder}").embed(inputs)
    np.testing.assert_array_equal(open_backbone(f"clip:{tmp_path}").embed(inputs), expected)


def test_a_model_is_found_by_name_in_the_cache(tmp_path, weights, monkeypatch):
    import huggingface_hub.constants

    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_CACHE", str(tmp_path))
    for name in (backbone_clip.CLIP_NAME, "some/model"):
        place = tmp_path / f"models--{name.replace('/', '--')}"
        write_model(place / "snapshots/abc", weights)
        (place / "refs").mkdir()
        (place / "refs/main").write_text("abc")
    assert open_backbone("clip").name == "clip"
    assert open_backbone("clip:some/model").fingerprint == open_backbone("clip").fingerprint
    refused("clip:some/other", "some/other", "hf download some/other", "clip:FOLDER")
    refused("clip:a b/c", "a b/c")


def test_fingerprint_follows_weights_and_preprocessing(folder, tmp_path, weights):
    mark = open_backbone(f"clip:{folder}").fingerprint
    assert mark == open_backbone(f"clip:{folder}").fingerprint
    changed = dict(weights)
    changed["visual_projection.weight"] = changed["visual_projection.weight"] + np.float32(1)
    write_model(tmp_path, changed)
    marks = {mark, open_backbone(f"clip:{tmp_path}").fingerprint}
    stated = {"image_mean": [0.5, 0.5, 0.5]}
    for file, content in (("processor_config.json", {"image_processor": stated}), ("preprocessor_config.json", {})):
        (tmp_path / file).write_text(json.dumps(content))
        marks.add(open_backbone(f"clip:{tmp_path}").fingerprint)
    assert len(marks) == 3  # the second file counts where it is there, and says nothing
    write_model(tmp_path, weights | {"text_model.final_layer_norm.weight": np.ones(7, np.float32)})
    assert open_backbone(f"clip:{tmp_path}").fingerprint == mark


@pytest.mark.parametrize(
    "stated",
    [
        *({"size": 40}, {"size": {"shortest_edge": 7}}, {"crop_size": {"height": 1}}, {"resample": 2}),
        *({"image_mean": [1]}, {"image_std": [1, 1, 0]}, {"image_mean": "abc"}),
    ],
)
def test_other_preprocessing_is_refused(tmp_path, weights, stated):
    write_model(tmp_path, weights)
    (tmp_path / "preprocessor_config.json").write_text(json.dumps(stated))
    refused(f"clip:{tmp_path}", "preprocessor_config.json")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"model_type": "siglip"}, "siglip"),
        ({"vision": {"hidden_act": "relu"}}, "activation 'relu'"),
        ({"vision": {"num_attention_heads": 3}}, "does not fit its weights"),
        ({"vision": {"num_attention_heads": "x"}}, "describes no vision tower"),
        ({"vision": {"image_size": 30}}, "does not fit its weights"),
        ({"vision": {"image_size": 40}}, "position_embedding.weight has shape"),
        ({"vision": {"layer_norm_eps": None}}, "describes no vision tower"),
    ],
)
def test_configurations_that_do_not_fit(tmp_path, weights, changes, words):
    refused(f"clip:{write_model(tmp_path, weights, **changes)}", str(tmp_path), words)


@pytest.mark.parametrize(
    ("name", "shape", "words"),
    [
        ("visual_projection.weight", None, "weights are missing from the model: visual_projection.weight"),
        ("vision_model.encoder.layers.2.mlp.fc2.bias", None, "layers.2.mlp.fc2.bias"),
        ("vision_model.encoder.layers.1.layer_norm1.weight", None, "layers.1.layer_norm1.weight"),
        ("vision_model.post_layernorm.bias", (3,), "has shape [3], expected [16]"),
        ("vision_model.embeddings.patch_embedding.weight", (WIDTH, 3, 8, 4), "does not fit its weights"),
        ("vision_model.encoder.layers.0.self_attn.q_proj.weight", (WIDTH, 5), "q_proj.weight has shape [16, 5]"),
    ],
)
def test_weights_that_do_not_fit_are_named(tmp_path, weights, name, shape, words):
    changed = dict(weights)
    del changed[name]
    if shape is not None:
        changed[name] = np.ones(shape, np.float32)
    refused(f"clip:{write_model(tmp_path, changed)}", str(tmp_path), words)


@pytest.mark.parametrize("content", [b"", b"\x10" * 40, b"\x02\0\0\0\0\0\0\0{}", b'\x05\0\0\0\0\0\0\0{"a":'])
def test_damaged_weights(tmp_path, content):
    write_config(tmp_path)
    (tmp_path / "model.safetensors").write_bytes(content)
    refused(f"clip:{tmp_path}", str(tmp_path))


def test_what_is_missing_is_said_in_one_line(tmp_path):
    refused("clip:/nowhere/at/all", "config.json")
    refused(f"clip:{tmp_path}", "config.json")
    for content in ("{", "[]", "[" * 10**5):
        (tmp_path / "config.json").write_text(content)
        refused(f"clip:{tmp_path}", "config.json", "JSON")
    write_config(tmp_path)
    refused(f"clip:{tmp_path}", "no model.safetensors", "save_pretrained")
    (tmp_path / "pytorch_model.bin").write_bytes(b"x")
    refused(f"clip:{tmp_path}", "pytorch_model.bin, which is not read")

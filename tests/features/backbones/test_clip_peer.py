"""CLIP beside transformers on torch (extra [bench]): equal features on random weights, equal preprocessing."""

import numpy as np
import pytest

from ovibjax.features.backbones.by_name import open_backbone

torch = pytest.importorskip("torch")
transformers = pytest.importorskip("transformers")
pytestmark = pytest.mark.filterwarnings("default")  # of two large libraries

SMALL = {"hidden_size": 16, "intermediate_size": 32, "num_hidden_layers": 2, "num_attention_heads": 2}
SIZES = {
    "B/32": {"patch_size": 32},
    "B/16": {"patch_size": 16},
    "L/14": {"patch_size": 14, "hidden_size": 1024, "intermediate_size": 4096, "num_hidden_layers": 24}
    | {"num_attention_heads": 16},
}
LONG = [pytest.param(name, marks=pytest.mark.long) for name in SIZES]


def saved(folder, **vision):
    """A model with random weights, saved by transformers."""
    torch.manual_seed(0)
    text = {**SMALL, "vocab_size": 60, "max_position_embeddings": 8, "bos_token_id": 0, "eos_token_id": 1}
    config = transformers.CLIPConfig(text_config=text, vision_config=vision, projection_dim=512)
    model = transformers.CLIPModel(config).eval()
    model.save_pretrained(folder)
    return model


def theirs(model, inputs):
    with torch.no_grad():
        found = model.get_image_features(pixel_values=torch.from_numpy(inputs))
    return getattr(found, "pooler_output", found).numpy()


def images():
    rng = np.random.default_rng(0)
    sizes = [(300, 400), (401, 299), (33, 32), (97, 1013), (32, 32), (20, 31), (7, 5)]
    return [rng.integers(0, 256, (*size, 3), np.uint8) for size in sizes]


@pytest.mark.parametrize("name", ["small", *LONG])
def test_features_equal_those_of_transformers(tmp_path, name):
    model = saved(tmp_path, **(SIZES[name] if name != "small" else SMALL | {"image_size": 32, "patch_size": 8}))
    backbone = open_backbone(f"clip:{tmp_path}")
    inputs = np.stack([backbone.preprocess(rgb) for rgb in images()])
    got, expected = backbone.embed(inputs), theirs(model, inputs)
    assert got.shape == expected.shape and got.dtype == np.float32
    # 1e-4 of a feature of unit norm.
    scale = np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(got / scale, expected / scale, atol=1e-4)
    half = tmp_path / "half"
    model.half().save_pretrained(half)
    halved = open_backbone(f"clip:{half}").embed(inputs)
    np.testing.assert_allclose(halved / scale, expected / scale, atol=1e-2)


def test_a_vision_model_with_projection(tmp_path):
    torch.manual_seed(0)
    config = transformers.CLIPVisionConfig(**SMALL, image_size=32, patch_size=8, projection_dim=20)
    model = transformers.CLIPVisionModelWithProjection(config).eval()
    model.save_pretrained(tmp_path)
    backbone = open_backbone(f"clip:{tmp_path}")
    inputs = np.stack([backbone.preprocess(rgb) for rgb in images()])
    with torch.no_grad():
        expected = model(pixel_values=torch.from_numpy(inputs)).image_embeds.numpy()
    np.testing.assert_allclose(backbone.embed(inputs), expected, atol=1e-4)


def processor():
    """The slow processor, on Pillow, that CLIP was published with; its name has changed over time."""
    try:
        from transformers.models.clip.image_processing_pil_clip import CLIPImageProcessorPil as Processor
    except ImportError:
        from transformers import CLIPImageProcessor as Processor
    return Processor(size={"shortest_edge": 32}, crop_size={"height": 32, "width": 32})


def test_preprocessing_equals_that_of_transformers(tmp_path):
    saved(tmp_path, **SMALL, image_size=32, patch_size=8)
    their = processor()
    their.save_pretrained(tmp_path)
    backbone = open_backbone(f"clip:{tmp_path}")
    for rgb in images():
        expected = their(rgb, return_tensors="np", input_data_format="channels_last")["pixel_values"][0]
        got = backbone.preprocess(rgb)
        assert got.shape == (3, 32, 32) and got.dtype == np.float32
        np.testing.assert_allclose(got, expected, atol=1e-6)

"""CLIP with small random weights, saved here: features and preprocessing equal those of transformers."""

import json

import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.features.backbones import clip as backbone_clip
from ovibjax.features.backbones.by_name import open_backbone

torch = pytest.importorskip("torch")
transformers = pytest.importorskip("transformers")
pytestmark = pytest.mark.filterwarnings("default")  # of two large libraries

SIZE_PX, DIM = 32, 24


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    torch.manual_seed(0)
    tower = {"hidden_size": 16, "intermediate_size": 32, "num_hidden_layers": 2, "num_attention_heads": 2}
    config = transformers.CLIPConfig(
        text_config={**tower, "vocab_size": 60, "max_position_embeddings": 8, "bos_token_id": 0, "eos_token_id": 1},
        vision_config={**tower, "image_size": SIZE_PX, "patch_size": 8},
        projection_dim=DIM,
    )
    path = tmp_path_factory.mktemp("clip")
    transformers.CLIPModel(config).save_pretrained(path)
    return path


def processor():
    """The slow processor, on Pillow, that CLIP was published with; its name has changed over time."""
    try:
        from transformers.models.clip.image_processing_pil_clip import CLIPImageProcessorPil as Processor
    except ImportError:
        from transformers import CLIPImageProcessor as Processor
    return Processor(size={"shortest_edge": SIZE_PX}, crop_size={"height": SIZE_PX, "width": SIZE_PX})


def images():
    rng = np.random.default_rng(0)
    sizes = [(300, 400), (401, 299), (33, 32), (97, 1013), (32, 32), (20, 31), (7, 5)]
    return [rng.integers(0, 256, (*size, 3), np.uint8) for size in sizes]


def test_preprocessing_equals_that_of_transformers(folder):
    backbone, theirs = open_backbone(f"clip:{folder}"), processor()
    for rgb in images():
        expected = theirs(rgb, return_tensors="np", input_data_format="channels_last")["pixel_values"][0]
        got = backbone.preprocess(rgb)
        assert got.shape == (3, SIZE_PX, SIZE_PX) and got.dtype == np.float32
        np.testing.assert_allclose(got, expected, atol=1e-6)


def test_features_equal_those_of_transformers(folder):
    backbone = open_backbone(f"clip:{folder}")
    inputs = np.stack([backbone.preprocess(rgb) for rgb in images()])
    inputs = np.concatenate([inputs] * 6)
    model = transformers.CLIPModel.from_pretrained(folder).eval()
    with torch.no_grad():
        expected = model.get_image_features(pixel_values=torch.from_numpy(inputs))
    expected = getattr(expected, "pooler_output", expected).numpy()
    got = backbone.embed(inputs)
    assert got.shape == (len(inputs), DIM) and got.dtype == np.float32
    np.testing.assert_allclose(got, expected, rtol=1e-4, atol=1e-6)


def test_fingerprint_follows_weights_and_preprocessing(folder, tmp_path):
    mark = open_backbone(f"clip:{folder}").fingerprint
    assert mark == open_backbone(f"clip:{folder}").fingerprint
    model = transformers.CLIPModel.from_pretrained(folder)
    with torch.no_grad():
        model.visual_projection.weight[0, 0] += 1
    model.save_pretrained(tmp_path)
    changed = open_backbone(f"clip:{tmp_path}").fingerprint
    (tmp_path / "preprocessor_config.json").write_text(json.dumps({"image_mean": [0.5, 0.5, 0.5]}))
    assert len({mark, changed, open_backbone(f"clip:{tmp_path}").fingerprint}) == 3
    # Half-precision weights on disk: computed in float32 all the same.
    model.half().save_pretrained(tmp_path)
    backbone = open_backbone(f"clip:{tmp_path}")
    assert backbone.embed(backbone.preprocess(images()[0])[None]).dtype == np.float32


def test_what_is_missing_or_wrong_is_said_in_one_line(folder, tmp_path, monkeypatch):
    def refused(spec, *words):
        with pytest.raises(InputError) as caught:
            open_backbone(spec)
        assert "\n" not in str(caught.value) and all(word in str(caught.value) for word in words), caught.value

    monkeypatch.setattr(backbone_clip, "CLIP_NAME", "nobody/no-such-model")
    refused("clip", "nobody/no-such-model", "clip:FOLDER")
    config = json.loads((folder / "config.json").read_text())
    (tmp_path / "config.json").write_text(json.dumps(config))
    refused(f"clip:{tmp_path}", str(tmp_path))
    (tmp_path / "config.json").write_text(json.dumps(config | {"model_type": "siglip"}))
    refused(f"clip:{tmp_path}", "siglip")
    (tmp_path / "config.json").write_text("{")
    refused(f"clip:{tmp_path}", str(tmp_path))
    (tmp_path / "config.json").write_text(json.dumps(config))
    (tmp_path / "model.safetensors").write_bytes(b"\x10" * 40)
    refused(f"clip:{tmp_path}", str(tmp_path))

"""Backbones by name: each against plain NumPy or its own library, and one line for whatever is wrong."""

import json
import sys

import jax
import numpy as np
import pytest
from PIL import Image

from ovibjax.errors import Doubt, InputError
from ovibjax.features.backbones.by_name import BackboneOptions, open_backbone
from ovibjax.features.backbones.image_encoder import CLIP_MEAN, CLIP_STD, resize_and_crop
from ovibjax.features.backbones.pyramid import EMBEDDED_HEIGHT_PX, EMBEDDED_WIDTH_PX, embed
from tests.features.backbones import onnx_bytes

RNG = np.random.default_rng(7)
WEIGHT = RNG.normal(size=(3, 20)).astype(np.float32)


def image(rows=75, columns=100):
    return RNG.integers(0, 256, (rows, columns, 3), np.uint8)


def refused(spec, *words, options=BackboneOptions()):  # noqa: B008
    with pytest.raises(InputError) as caught:
        open_backbone(spec, options)
    assert "\n" not in str(caught.value) and all(word in str(caught.value) for word in words), caught.value


def test_embedded_takes_any_size_and_any_batch():
    backbone = open_backbone("embedded")
    images = [image(), image(301, 401), image(EMBEDDED_HEIGHT_PX, EMBEDDED_WIDTH_PX)]
    inputs = np.stack([backbone.preprocess(rgb) for rgb in images])
    assert inputs.shape == (3, EMBEDDED_HEIGHT_PX, EMBEDDED_WIDTH_PX, 3) and inputs.dtype == np.float32
    # An image of the pyramid's own size passes unchanged.
    np.testing.assert_array_equal(inputs[2], images[2] / np.float32(255))
    jax.clear_caches()
    features = backbone.embed(inputs)
    many = backbone.embed(np.concatenate([inputs] * 40))
    assert embed._cache_size() == 1
    np.testing.assert_allclose(np.linalg.norm(features, axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(many, np.tile(features, (40, 1)), atol=1e-5)
    assert backbone.fingerprint == open_backbone("embedded").fingerprint


def test_embedded_shrinks_without_aliasing():
    """A fine checkerboard becomes grey, whatever its phase."""
    board = (np.indices((300, 400)).sum(axis=0) % 2 * 255).astype(np.uint8)
    small = open_backbone("embedded").preprocess(np.repeat(board[..., None], 3, axis=2))
    np.testing.assert_allclose(small, 0.5, atol=0.01)


def test_unknown_names_and_needless_options_are_refused(tmp_path):
    for spec in ("", "clap", "onnx", "onnx:", "clip:", "embedded:x", "Embedded"):
        refused(spec, repr(spec), "onnx:FILE")
    refused("embedded", "size", options=BackboneOptions(size_px=(32, 32)))
    refused(f"onnx:{tmp_path / 'absent.onnx'}", "absent.onnx", "no such")
    refused(f"clip:{tmp_path}", str(tmp_path), "config.json")


@pytest.mark.parametrize(("rows", "columns"), [(300, 400), (401, 299), (224, 500), (97, 1013), (1, 1)])
def test_images_cover_the_input_and_are_cut_in_the_middle(rows, columns):
    rgb = image(rows, columns)
    got = resize_and_crop(rgb, (48, 48))
    # CLIP's own words: shorter side to 48, the other rounded down; then the middle.
    short = min(rows, columns)
    scaled = Image.fromarray(rgb).resize((48 * columns // short, 48 * rows // short), Image.Resampling.BICUBIC)
    top, left = (scaled.height - 48) // 2, (scaled.width - 48) // 2
    np.testing.assert_array_equal(got, np.asarray(scaled)[top : top + 48, left : left + 48])
    assert resize_and_crop(rgb, (30, 70)).shape == (30, 70, 3)


class TestOnnx:
    @pytest.fixture(autouse=True)
    def _extra(self):
        pytest.importorskip("onnxruntime")

    def write(self, tmp_path, content, side=None):
        path = tmp_path / "net.onnx"
        path.write_bytes(content)
        if side is not None:
            (tmp_path / "net.onnx.json").write_text(side if isinstance(side, str) else json.dumps(side))
        return f"onnx:{path}"

    def features(self, spec, images, **options):
        backbone = open_backbone(spec, BackboneOptions(**options))
        return backbone.embed(np.stack([backbone.preprocess(rgb) for rgb in images]))

    def test_arithmetic_of_named_output_in_any_batch(self, tmp_path):
        spec = self.write(tmp_path, onnx_bytes.pooled_product(WEIGHT))
        images = [image(40, 60) for _ in range(19)]
        got = self.features(spec, images, size_px=(40, 60), output="feature")
        means = np.stack([(rgb / 255).mean(axis=(0, 1)) for rgb in images])
        expected = (means - CLIP_MEAN) / CLIP_STD @ WEIGHT
        assert got.shape == (19, 20) and got.dtype == np.float32
        np.testing.assert_allclose(got, expected, rtol=1e-4, atol=1e-5)
        # Without a name: the first output with two axes, which is said, and CLIP's input size.
        with pytest.warns(Doubt, match=r"output pooled \[n, 3\] is taken.*feature \[n, 20\].*--output"):
            backbone = open_backbone(spec)
        inputs = backbone.preprocess(images[0])
        assert inputs.shape == (3, 224, 224) and backbone.embed(inputs[None]).shape == (1, 3)

    @pytest.mark.parametrize("batch", [1, 4, "n"])
    def test_fixed_and_dynamic_batch_channels_last(self, tmp_path, batch):
        weight = RNG.normal(size=(6 * 8 * 3, 11)).astype(np.float32)
        spec = self.write(tmp_path, onnx_bytes.flat_product(weight, (batch, 6, 8, 3)))
        images = [image(6, 8) for _ in range(6)]
        got = self.features(spec, images, mean=(0.0, 0.0, 0.0), std=(1.0, 1.0, 1.0))
        expected = np.stack(images).reshape(6, -1) / 255 @ weight
        np.testing.assert_allclose(got, expected, rtol=1e-4, atol=1e-4)

    def test_side_file_and_options_over_it(self, tmp_path):
        side = {"size": [5, 7], "layout": "nchw", "mean": [0.5, 0.5, 0.5], "std": [0.5, 0.25, 1], "output": "feature"}
        spec = self.write(tmp_path, onnx_bytes.pooled_product(WEIGHT), side)
        rgb = image(5, 7)
        expected = ((rgb / 255).mean(axis=(0, 1)) - 0.5) / [0.5, 0.25, 1] @ WEIGHT
        np.testing.assert_allclose(self.features(spec, [rgb])[0], expected, rtol=1e-4, atol=1e-5)
        assert self.features(spec, [rgb], output="pooled").shape == (1, 3)
        marks = {open_backbone(spec, options).fingerprint for options in (BackboneOptions(), BackboneOptions((9, 9)))}
        other = tmp_path / "other.json"
        other.write_text('{"size": 9, "output": "feature"}')
        marks.add(open_backbone(spec, BackboneOptions(side_file=other)).fingerprint)
        self.write(tmp_path, onnx_bytes.pooled_product(2 * WEIGHT))
        marks.add(open_backbone(spec).fingerprint)
        assert len(marks) == 4

    def test_what_cannot_work_is_said_in_one_line(self, tmp_path):
        good = onnx_bytes.pooled_product(WEIGHT)
        for side, word in (
            ('{"sise": 3}', "'sise'"),
            ("[1]", "object"),
            ("{", "JSON"),
            ("[" * 10**5, "JSON"),
            ('{"size": 0}', "size"),
            ('{"size": [1, 2, 3]}', "size"),
            ('{"size": true}', "size"),
            ('{"size": 1e9}', "size"),
            ('{"layout": "hwcn"}', "hwcn"),
            ('{"layout": [1]}', "layout"),
            ('{"mean": [0, 0]}', "mean"),
            ('{"std": [1, 1, 0]}', "std"),
            ('{"std": [1, 1, NaN]}', "std"),
            ('{"output": 3}', "output"),
            ('{"output": "nothing"}', "pooled, feature"),
            ('{"layout": "nhwc"}', "nhwc"),
        ):
            refused(self.write(tmp_path, good, side), word)
        (tmp_path / "net.onnx.json").unlink()
        flat = np.ones((12, 2), np.float32)
        for content, word in (
            (b"", "net.onnx"),
            (b"\x80\x04 pickle", "net.onnx"),
            (good[:60], "net.onnx"),
            (onnx_bytes.flat_product(flat, ("n", 12)), "axes"),
            (onnx_bytes.pooled_product(WEIGHT, ("n", 4, "h", "w")), "shape"),
            (
                onnx_bytes.model([("Cast", ("a",), "b")], {}, [("a", (1, 3, 2, 2), 7)], [("b", (1, 3, 2, 2))]),
                "net.onnx",
            ),
            (
                onnx_bytes.model(
                    [("Add", ("a", "b"), "c")], {}, [("a", (1, 3, 2, 2)), ("b", (1, 3, 2, 2))], [("c", (1, 3, 2, 2))]
                ),
                "2 inputs",
            ),
        ):
            refused(self.write(tmp_path, content), word)
        refused(self.write(tmp_path, good), "not.json", options=BackboneOptions(side_file=tmp_path / "not.json"))

    def test_no_output_with_two_axes(self, tmp_path):
        relu = onnx_bytes.model([("Relu", ("a",), "b")], {}, [("a", ("n", 3, 2, 2))], [("b", ("n", 3, 2, 2))])
        with pytest.raises(InputError, match=r"\[batch, d\]"):
            self.features(self.write(tmp_path, relu), [image()])


def test_missing_extras_are_named(tmp_path, monkeypatch):
    (tmp_path / "net.onnx").write_bytes(b"x")
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    monkeypatch.setitem(sys.modules, "safetensors", None)
    refused(f"onnx:{tmp_path / 'net.onnx'}", "[onnx]", "pip install")
    refused("clip", "[clip]", "pip install")
    (tmp_path / "config.json").write_text('{"model_type": "clip"}')
    (tmp_path / "model.safetensors").write_bytes(b"")
    refused(f"clip:{tmp_path}", "[clip]", "pip install")

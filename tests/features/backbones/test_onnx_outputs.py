"""Outputs of ONNX networks: tokens and maps pooled, the one taken of several named, causes of failures in one line."""

import numpy as np
import pytest

from ovibjax.errors import Doubt, InputError
from ovibjax.features.backbones.by_name import open_backbone
from ovibjax.features.backbones.image_encoder import BackboneOptions
from ovibjax.features.backbones.onnx_errors import cause_of
from ovibjax.features.backbones.onnx_outputs import vectors
from tests.features.backbones import onnx_bytes

pytest.importorskip("onnxruntime")

PLAIN = {"mean": (0.0, 0.0, 0.0), "std": (1.0, 1.0, 1.0)}
IMAGES = np.random.default_rng(0).integers(0, 256, (18, 4, 4, 3), np.uint8)
PIXELS = IMAGES.transpose(0, 3, 1, 2).astype(np.float32) / 255


def spec_of(tmp_path, content):
    (tmp_path / "net.onnx").write_bytes(content)
    return f"onnx:{tmp_path / 'net.onnx'}"


def features(spec, **options):
    backbone = open_backbone(spec, BackboneOptions(**PLAIN, **options))
    return backbone.embed(np.stack([backbone.preprocess(rgb) for rgb in IMAGES]))


def refused(spec, *words, **options):
    with pytest.raises(InputError) as caught:
        features(spec, **options)
    said = str(caught.value)
    assert "\n" not in said and len(said) < 450 and all(word in said for word in words), said


def gem(maps, axes):
    return (np.maximum(maps.astype(np.float64), 1e-6) ** 3).mean(axis=axes) ** (1 / 3)


@pytest.mark.parametrize("declared", [True, False])
@pytest.mark.parametrize(
    ("shape", "pool", "expected"),
    [
        ((0, 8, 6), "first", lambda x: x.reshape(-1, 8, 6)[:, 0]),
        ((0, 8, 6), "mean", lambda x: x.reshape(-1, 8, 6).mean(1)),
        ((0, 3, 4, 4), "mean", lambda x: x.mean((2, 3))),
        ((0, 12, 2, 2), "gem", lambda x: gem(x.reshape(-1, 12, 2, 2), (2, 3))),
        ((0, 48), None, lambda x: x.reshape(-1, 48)),
        ((0, 48, 1, 1), None, lambda x: x.reshape(-1, 48)),
    ],
)
def test_tokens_and_maps_become_vectors(tmp_path, shape, pool, expected, declared):
    got = features(spec_of(tmp_path, onnx_bytes.reshaped(shape, declared=declared)), pool=pool)
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, expected(PIXELS), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("pool", ["mean", "gem"])
def test_maps_with_channels_last(pool, tmp_path):
    relu = onnx_bytes.model([("Relu", ("image",), "out")], {}, [("image", ("n", 4, 4, 3))], [("out", ("n", 4, 4, 3))])
    expected = PIXELS.mean((2, 3)) if pool == "mean" else gem(PIXELS, (2, 3))
    np.testing.assert_allclose(features(spec_of(tmp_path, relu), pool=pool), expected, rtol=1e-5)


def test_the_pool_is_part_of_the_fingerprint_and_of_the_side_file(tmp_path):
    spec = spec_of(tmp_path, onnx_bytes.reshaped((0, 8, 6)))
    marks = {open_backbone(spec, BackboneOptions(pool=pool)).fingerprint for pool in ("first", "mean")}
    (tmp_path / "net.onnx.json").write_text('{"pool": "mean"}')
    marks.add(open_backbone(spec).fingerprint)
    assert len(marks) == 2
    np.testing.assert_allclose(features(spec), PIXELS.reshape(-1, 8, 6).mean(1), rtol=1e-5)
    (tmp_path / "net.onnx.json").write_text('{"pool": "max"}')
    refused(spec, "'max'", "first, mean, gem")


@pytest.mark.parametrize("declared", [True, False])
@pytest.mark.parametrize(
    ("shape", "pool", "words"),
    [
        ((0, 8, 6), None, ["no output of shape [batch, d]", "(16, 8, 6)", "--pool first or mean"]),
        ((0, 3, 4, 4), None, ["--pool gem or mean"]),
        ((0, 8, 6), "gem", ["--pool gem is for an output of 4 axes"]),
        ((0, 3, 4, 4), "first", ["--pool first is for an output of 3 axes"]),
        ((0, 48), "mean", ["--pool mean is for an output of 3 or 4 axes"]),
        ((0, 2, 2, 2, 6), None, ["--output"]),
    ],
)
def test_what_does_not_fit_names_the_option(tmp_path, shape, pool, words, declared):
    refused(spec_of(tmp_path, onnx_bytes.reshaped(shape, declared=declared)), *words, pool=pool)


def test_several_outputs_that_would_do_are_named(tmp_path):
    spec = spec_of(tmp_path, onnx_bytes.reshaped((0, 3, 16), (0, 48), (0, 48), (0, 8, 6)))
    with pytest.warns(Doubt, match=r"output out1 \[n, 48\] is taken, .*\(out2 \[n, 48\]\); --output"):
        open_backbone(spec)
    with pytest.warns(Doubt, match=r"output out0 \[n, 3, 16\] is taken"):
        open_backbone(spec, BackboneOptions(pool="first"))
    # A name settles it: nothing is said.
    np.testing.assert_allclose(features(spec, pool="mean", output="out3"), PIXELS.reshape(-1, 8, 6).mean(1), rtol=1e-5)
    refused(spec, "leave out --pool", pool="mean", output="out1")


def test_half_precision_is_pooled_in_single():
    tokens = np.full((2, 4000, 3), 30, np.float16)
    np.testing.assert_allclose(vectors("x", [tokens], 2, "mean", "nchw"), 30)


RELU = onnx_bytes.model([("Relu", ("a",), "b")], {}, [("a", ("n", 3, 4, 4))], [("b", ("n", 48))])
ODD = onnx_bytes.model([("Frobnicate", ("a",), "b")], {}, [("a", ("n", 3, 4, 4))], [("b", ("n", 48))])
CAUSES = {
    "IR too new": (
        onnx_bytes.with_versions(RELU, ir=99),
        ["IR version 99", "reads up to", "pip install -U onnxruntime"],
    ),
    "opset too new": (onnx_bytes.with_versions(RELU, opset=99), ["opset 99", "reads up to", "export the model"]),
    "weights are missing": (onnx_bytes.external_product((3, 4), "big.bin"), ["its weights are in", "big.bin", "copy"]),
    "weights are cut": (
        onnx_bytes.external_product((3, 4), "short.bin"),
        ["3 bytes", "needs 48", "copy"],
    ),
    "weights lie elsewhere": (onnx_bytes.external_product((3, 4), "../big.bin"), ["escapes model directory"]),
    "unknown operator": (ODD, ["needs the operator Frobnicate"]),
    "cut": (RELU[:60], ["Protobuf parsing failed"]),
    "empty": (b"", ["No graph was found"]),
    "no image": (onnx_bytes.flat_product(np.ones((7, 2), np.float32), ("n", 3, "h", "w")), ["dimension mismatch"]),
}


@pytest.mark.parametrize("name", CAUSES)
def test_the_cause_of_a_failure_is_given(tmp_path, name):
    content, words = CAUSES[name]
    (tmp_path / "short.bin").write_bytes(b"abc")
    # A deep folder does not push the cause out of the line.
    folder = tmp_path / ("d" * 60) / ("e" * 60)
    folder.mkdir(parents=True)
    (folder / "short.bin").write_bytes(b"abc")
    refused(spec_of(folder, content), *words)


def test_what_onnxruntime_says_is_cut_to_its_cause():
    loading = "[ONNXRuntimeError] : 1 : FAIL : Load model from a b.onnx failed:"
    for place in ("/src/core/x.cc:12 void a::B(const c&) ", "tensor.cc:6 Foo ", ""):
        assert cause_of(RuntimeError(f"{loading}{place}Bad thing\nhere"), "1.0") == "Bad thing here"
    assert cause_of(ValueError(""), "1.0") == ""
    assert len(cause_of(ValueError("x" * 999), "1.0")) == 200

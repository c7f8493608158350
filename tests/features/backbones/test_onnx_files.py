"""A network's fingerprint covers every file it reads, wherever the model names it, and nothing else."""

import shutil

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.errors import InputError
from ovibjax.features.backbones.by_name import BackboneOptions, open_backbone
from ovibjax.features.backbones.image_encoder import fingerprint
from ovibjax.features.backbones.onnx_files import model_files
from ovibjax.features.images.extraction import _SOURCES
from tests.features.backbones import onnx_bytes
from tests.features.backbones.onnx_bytes import _field, external
from tests.features.images.made_images import run, write, write_layout

WEIGHT = np.random.default_rng(3).normal(size=(3, 8)).astype("<f4")
NAMES = ["weights.bin", "net.onnx.data", "net.onnx_data", "net.data", "tensors/0", "model.safetensors", "ä b", "net"]


# What leads to a tensor, from the tensor's own message up (onnx.proto): each takes a tensor and gives a model.
def in_attribute(tensor):
    return _field(5, _field(1, "value") + _field(5, tensor))


WAYS = {
    "initializer": lambda t: _field(7, _field(5, t)),
    "sparse initializer": lambda t: _field(7, _field(15, _field(1, t))),
    "sparse indices": lambda t: _field(7, _field(15, _field(2, t))),
    "constant": lambda t: _field(7, _field(1, in_attribute(t))),
    "constants": lambda t: _field(7, _field(1, _field(5, _field(10, t)))),
    "sparse constant": lambda t: _field(7, _field(1, _field(5, _field(22, _field(1, t))))),
    "branch": lambda t: _field(7, _field(1, _field(5, _field(6, _field(5, t))))),
    "branches": lambda t: _field(7, _field(1, _field(5, _field(11, _field(1, in_attribute(t)))))),
    "function": lambda t: _field(25, _field(7, in_attribute(t))),
}


@pytest.mark.parametrize("way", WAYS)
def test_a_tensor_is_found_wherever_it_stands(tmp_path, way):
    plain = onnx_bytes.pooled_product(WEIGHT)
    path = write(tmp_path / "net.onnx", plain + WAYS[way](external("w", (3, 8), "far/away.bin")))
    assert model_files(path) == [path, tmp_path / "far/away.bin"]


LOCATIONS = st.text(st.characters(min_codepoint=32, exclude_categories=["Cs"], exclude_characters="/\0"), min_size=1)


@given(st.lists(st.tuples(st.sampled_from(sorted(WAYS)), LOCATIONS), max_size=8))
@settings(max_examples=150, deadline=None)
def test_any_names_in_any_places(tmp_path_factory, tensors):
    folder = tmp_path_factory.mktemp("model")
    content = onnx_bytes.pooled_product(WEIGHT)
    content += b"".join(WAYS[way](external("w", (2, 2), name)) for way, name in tensors)
    path = write(folder / "net.onnx", content)
    assert model_files(path) == [path, *(folder / name for name in sorted({name for _, name in tensors}))]


@given(st.binary(min_size=1, max_size=200))
@settings(max_examples=300, deadline=None)
def test_what_is_no_protocol_buffer_counts_with_all_beside_it(tmp_path_factory, content):
    folder = tmp_path_factory.mktemp("model")
    write(folder / "net.bin", b"x")
    write(folder / "other.bin", b"x")
    assert model_files(write(folder / "net.ort", content)) in (
        [folder / "net.ort"],  # bytes may happen to be one
        [folder / "net.ort", folder / "net.bin"],
    )


def test_nesting_without_end_is_no_model(tmp_path):
    graph = b""
    for _ in range(80):
        graph = _field(1, _field(5, _field(6, graph)))
    path = write(tmp_path / "net.onnx", _field(7, graph))
    assert model_files(path) == [path]


class TestWithOnnxruntime:
    @pytest.fixture(autouse=True)
    def _extra(self):
        pytest.importorskip("onnxruntime")

    @pytest.mark.parametrize("name", NAMES)
    def test_weights_of_any_name_count(self, tmp_path, name):
        model = write(tmp_path / "net.onnx", onnx_bytes.external_product(WEIGHT.shape, name))
        write(tmp_path / name, WEIGHT.tobytes())
        first = open_backbone(f"onnx:{model}").fingerprint
        assert open_backbone(f"onnx:{model}").fingerprint == first
        write(tmp_path / name, (2 * WEIGHT).tobytes())
        assert open_backbone(f"onnx:{model}").fingerprint != first
        # A neighbour that the model does not read is nobody's business, nor is the folder.
        write(tmp_path / name, WEIGHT.tobytes())
        write(tmp_path / "net.onnx.old", b"x")
        copy = shutil.copytree(tmp_path, tmp_path.parent / f"{tmp_path.name}-copy")
        assert open_backbone(f"onnx:{model}").fingerprint == first
        assert open_backbone(f"onnx:{copy / 'net.onnx'}").fingerprint == first

    @pytest.mark.parametrize("name", ["weights.bin", "net.onnx.data"])
    def test_an_extraction_does_not_go_on_with_other_weights(self, tmp_path, name):
        town = write_layout(tmp_path / "town", 6)
        model = write(tmp_path / "net.onnx", onnx_bytes.external_product(WEIGHT.shape, name))
        write(tmp_path / name, WEIGHT.tobytes())

        def stop(done, total):
            if done == 4:
                raise KeyboardInterrupt

        def extract(on_frames=None):
            options = BackboneOptions(size_px=(8, 8))
            return run(town, tmp_path / "x.npz", open_backbone(f"onnx:{model}", options), on_frames=on_frames)

        with pytest.raises(KeyboardInterrupt, match="4 of 6 frames are kept"):
            extract(stop)
        write(tmp_path / name, (2 * WEIGHT).tobytes())
        with pytest.raises(InputError, match="weights or preprocessing was"):
            extract()
        write(tmp_path / name, WEIGHT.tobytes())
        assert extract().resumed == 4


def test_a_fingerprint_takes_files_by_content(tmp_path):
    one, other = write(tmp_path / "a", b"12"), write(tmp_path / "b", b"12")
    assert fingerprint(one) == fingerprint(other) != fingerprint(write(tmp_path / "c", b"21"))
    assert fingerprint(one, other) != fingerprint(write(tmp_path / "d", b"1212"))


def test_the_code_of_every_backbone_counts():
    named = {name.removeprefix("features.backbones.") for name in _SOURCES}
    assert {"onnx", "clip", "pyramid", "embedded", "image_encoder", "onnx_files"} <= named

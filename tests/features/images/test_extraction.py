"""Images to features: the right numbers, and what has none is named and left out."""

import shutil
import struct
import warnings
import zlib
from pathlib import Path

import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.features.backbones.by_name import open_backbone
from ovibjax.features.backbones.pyramid import embed as pyramid
from ovibjax.features.backbones.pyramid import embedded_backbone
from ovibjax.features.feature_files import load
from tests.features.images.made_images import (
    N,
    embed,
    encode,
    listing,
    pixels,
    preprocess,
    run,
    tiny_backbone,
    write,
)


def test_features_are_those_of_the_images(town, whole):
    made = load(whole[0])
    rows = [row for row in range(N) if row != 5]
    assert made.frame_id.tolist() == [f"{row:06d}" for row in rows]
    assert made.positions_m[3].tolist() == [9, -7.5, 30] and made.yaw_rad[3] == pytest.approx(np.pi / 4)
    for at, row in enumerate(rows):
        raw = np.concatenate([embed(preprocess(pixels(row, view))[None]) for view in range(5)])
        np.testing.assert_allclose(made.features[at], raw / np.linalg.norm(raw, axis=1, keepdims=True), atol=1e-5)


def test_what_does_not_decode_is_named_and_refused_if_strict(town, tmp_path):
    done = run(town, tmp_path / "x.npz")
    assert [(one.frame_id, one.reason) for one in done.failed] == [("000005", "an image does not decode")]
    assert done.failed[0].detail.startswith("rgb/Right/000005.png: corrupt or truncated")
    assert done.resumed == 0 and listing(tmp_path) == ["x.npz"]
    with pytest.raises(InputError, match="1 frame refused: 1 an image does not decode"):
        run(town, tmp_path / "y.npz", strict=True)
    # Finished batches are kept; without --strict the same command goes on.
    assert run(town, tmp_path / "y.npz").resumed == 4
    assert (tmp_path / "y.npz").read_bytes() == (tmp_path / "x.npz").read_bytes()


def test_the_batch_is_always_full_and_frames_keep_their_place(town, tmp_path):
    seen = []

    def watch(inputs):
        seen.append(inputs.copy())
        return embed(inputs)

    run(town, tmp_path / "x.npz", tiny_backbone(embed=watch), batch=4)
    assert [inputs.shape for inputs in seen] == [(20, 4, 4, 3)] * 3
    np.testing.assert_array_equal(seen[1][10], preprocess(pixels(6, 0)))
    assert not seen[1][5:10].any() and not seen[2][15:].any()


def test_the_embedded_backbone_sees_the_whole_image():
    backbone = open_backbone("embedded")
    y, x = np.mgrid[:96, :128]
    image = np.stack([x, y, 127 + 60 * np.sin(x / 20) * np.cos(y / 15)], axis=-1).astype(np.uint8)
    small = image.reshape(48, 2, 64, 2, 3).mean(axis=(1, 3)) / 255
    np.testing.assert_allclose(backbone.preprocess(image), small, atol=2 / 255)
    got = backbone.embed(np.stack([backbone.preprocess(image)]))
    np.testing.assert_allclose(got, pyramid(embedded_backbone(), small[None].astype(np.float32)), atol=0.02)
    assert backbone.name == "embedded" and len(backbone.fingerprint) >= 16
    with pytest.raises(InputError, match="embedded"):
        open_backbone("resnet")


def test_features_that_mean_nothing_leave_their_frame_out(town, tmp_path):
    def odd(inputs):
        features = embed(inputs)
        features[0], features[7] = np.nan, 0
        return features

    failed = run(town, tmp_path / "x.npz", tiny_backbone(embed=odd), batch=20).failed
    assert [one.detail for one in failed[1:]] == [
        f"rgb/{v}: zero or not finite" for v in ("Front/000000.png", "Left/000001.png")
    ]
    with pytest.raises(InputError, match="features of shape"):
        run(town, tmp_path / "y.npz", tiny_backbone(embed=lambda inputs: embed(inputs)[1:]))
    with pytest.raises(InputError, match="no usable frame"):
        run(town, tmp_path / "y.npz", tiny_backbone(embed=lambda inputs: 0 * embed(inputs)))
    assert listing(tmp_path) == ["x.npz"]


def test_large_images_are_refused_without_a_warning(town, tmp_path):
    root = Path(shutil.copytree(town, tmp_path / "town"))
    header = bytearray(encode(pixels(0)))
    header[16:24] = struct.pack(">II", 10_000, 10_000)
    header[29:33] = struct.pack(">I", zlib.crc32(bytes(header[12:29])))
    write(root / "rgb/Front/000000.png", bytes(header))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        failed = run(root, tmp_path / "x.npz").failed
    assert "10000 x 10000 pixels" in failed[0].detail

"""Image files to pixels: every common mode becomes RGB, upright, and as bright as it was."""

import io
import json
import struct
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from ovibjax.errors import InputError
from ovibjax.features.images.decoding import decode_image
from ovibjax.views import VIEWS
from tests.features.images.made_images import about, encode, pixels, run, write


def test_every_common_mode_becomes_rgb():
    rgb = pixels(1)
    grey = rgb[..., 0]
    wide = (grey.astype(np.uint16) << 8) + 200
    alpha = np.dstack([rgb, grey])
    palette = io.BytesIO()
    Image.fromarray(rgb).quantize(16).save(palette, "png", transparency=bytes(range(16)))
    cases = {
        encode(rgb): rgb,
        encode(alpha): rgb,
        encode(grey): np.repeat(grey[..., None], 3, 2),
        encode(wide): np.repeat(grey[..., None], 3, 2),
        encode(rgb, "webp", lossless=True): rgb,
        encode(rgb, "bmp"): rgb,
    }
    for content, expected in cases.items():
        np.testing.assert_array_equal(decode_image(content), expected)
    for content in (palette.getvalue(), encode(np.dstack([rgb, grey]), "webp"), encode(rgb, "jpeg")):
        assert decode_image(content).shape == rgb.shape
    cmyk = io.BytesIO()
    Image.fromarray(rgb).convert("CMYK").save(cmyk, "jpeg")
    assert decode_image(cmyk.getvalue()).shape == rgb.shape


def test_orientation_marks_are_applied():
    exif = Image.Exif()
    exif[0x0112] = 6
    upright = decode_image(encode(pixels(1), "png", exif=exif))
    np.testing.assert_array_equal(upright, np.rot90(pixels(1), -1))


def sixteen(grey: np.ndarray, significant: int | None = None) -> bytes:
    """A PNG of 16 bits, with the chunk that says how many of them count."""
    content = encode(grey.astype(np.uint16))
    if significant is None:
        return content
    chunk = b"sBIT" + bytes([significant])
    return content[:33] + struct.pack(">I", 1) + chunk + struct.pack(">I", zlib.crc32(chunk)) + content[33:]


def ramp(bits: int) -> np.ndarray:
    """Every brightness of so many bits."""
    return np.linspace(0, 2**bits - 1, 40 * 30).round().astype(np.uint16).reshape(40, 30)


@pytest.mark.parametrize("bits", range(8, 17))
def test_upper_bits_that_are_empty_are_no_darkness(bits):
    exact = ramp(bits) >> bits - 8
    for content, said in ((sixteen(ramp(bits)), bits), (sixteen(ramp(bits), bits), None)):
        found = decode_image(content, said)
        np.testing.assert_array_equal(found, np.repeat(exact[..., None].astype(np.uint8), 3, 2))
        assert found.max() == 255


@pytest.mark.parametrize("bits", [8, 10, 12, 13])
def test_black_is_not_made_of_them_without_a_word(bits):
    with pytest.raises(ValueError, match="16 bits of which the upper ones are empty; say --bits 12") as caught:
        decode_image(sixteen(ramp(bits)))
    assert len(str(caught.value).splitlines()) == 1
    assert decode_image(sixteen(ramp(bits)), 16).max() < 64


@given(st.integers(2**14, 2**16 - 1), st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_images_of_sixteen_bits_raise_no_doubt(peak, seed):
    grey = np.random.default_rng(seed).integers(0, peak + 1, (8, 9)).astype(np.uint16)
    grey[0, 0] = peak
    assert decode_image(sixteen(grey)).max() == peak >> 8


def test_what_is_black_is_black():
    assert decode_image(sixteen(np.zeros((8, 9)))).max() == 0
    assert decode_image(encode(np.full((8, 9), 3, np.uint8))).max() == 3  # eight bits are eight bits


def colour_of_sixteen(rgb: np.ndarray) -> bytes:
    """A PNG of three channels of 16 bits, which Pillow reads and does not write."""
    height, width, _ = rgb.shape
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in rgb)
    parts = [
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(rows)),
        (b"IEND", b""),
    ]
    chunks = (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in parts
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def test_colour_of_sixteen_bits():
    rgb = pixels(1).astype(np.uint16)
    np.testing.assert_array_equal(decode_image(colour_of_sixteen(rgb << 8)), rgb)
    for said in (None, 12):
        with pytest.raises(ValueError, match="convert it to 8 bits"):
            decode_image(colour_of_sixteen(rgb << 4), said)


def test_an_extraction_takes_the_bits_and_names_the_option(tmp_path):
    for frame in range(3):
        for view, camera in enumerate(VIEWS):
            grey = np.random.default_rng([frame, view]).integers(0, 4096, (9, 12))
            write(tmp_path / "town/rgb" / camera / f"{frame:06d}.png", sixteen(grey))
        write(tmp_path / "town/metadata" / f"{frame:06d}.json", json.dumps(about(frame)).encode())
    with pytest.raises(InputError, match=r"no usable frame.*upper ones are empty"):
        run(tmp_path / "town", tmp_path / "x.npz")
    with pytest.raises(InputError, match="--bits 17"):
        run(tmp_path / "town", tmp_path / "x.npz", bits=17)
    assert len(run(tmp_path / "town", tmp_path / "x.npz", bits=12).features.features) == 3

"""Image files to pixels: every common mode becomes RGB, upright."""

import io

import numpy as np
from PIL import Image

from ovibjax.features.images.decoding import decode_image
from tests.features.images.made_images import (
    encode,
    pixels,
)


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

"""From the bytes of an image file that nobody vouches for to RGB pixels."""

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError

MAX_PIXELS = 64_000_000
"""Largest image decoded; a few kilobytes can claim gigabytes of pixels."""
MAX_ASPECT = 100
"""Longest side over shortest; beyond, a backbone that scales the shorter side would need gigabytes."""
_FORMATS = ("PNG", "JPEG", "WEBP", "BMP")


def decode_image(content: bytes) -> NDArray[np.uint8]:
    """Decode a PNG, JPEG, WebP or BMP image.

    Transparency is dropped, 16-bit grey is cut to 8 bits, JPEG orientation marks are applied.

    Args:
        content: the file's bytes.

    Returns:
        [H, W, 3] red, green, blue.

    Raises:
        ValueError: no such image, truncated, corrupt or too large; the message is one line.
    """
    try:
        with Image.open(io.BytesIO(content), formats=_FORMATS) as image:
            width, height = image.size
            if width * height <= MAX_PIXELS and max(width, height) <= MAX_ASPECT * min(width, height):
                return _rgb(ImageOps.exif_transpose(image))
    except Image.DecompressionBombError:
        raise ValueError(f"more than {MAX_PIXELS} pixels") from None
    except Exception as error:
        # Corrupt bytes surface as a dozen exception types of Pillow, zlib and struct; all mean the same.
        text = " ".join(str(error).split())[:80]
        known = isinstance(error, UnidentifiedImageError)
        raise ValueError("not a PNG, JPEG, WebP or BMP image" if known else f"corrupt or truncated ({text})") from error
    raise ValueError(f"{width} x {height} pixels, over {MAX_PIXELS} pixels or {MAX_ASPECT} times as long as wide")


def _rgb(image: Image.Image) -> NDArray[np.uint8]:
    if image.mode.startswith("I"):  # 16-bit grey; Pillow's own conversion saturates
        grey = np.asarray(image).astype(np.int64) >> 8
        return np.repeat(np.clip(grey, 0, 255).astype(np.uint8)[..., None], 3, axis=2)
    if image.mode == "P" and "transparency" in image.info:
        image = image.convert("RGBA")
    return np.asarray(image.convert("RGB"))

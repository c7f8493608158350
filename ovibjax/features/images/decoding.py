"""From the bytes of an image file that nobody vouches for to RGB pixels."""

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError

MAX_PIXELS = 64_000_000
"""Largest image decoded; a few kilobytes can claim gigabytes of pixels."""
MAX_ASPECT = 100
"""Longest side over shortest; beyond, a backbone that scales the shorter side would need gigabytes."""
BITS = range(8, 17)
"""Bits that a channel of 16 may really have."""

_PNG = b"\x89PNG\r\n\x1a\n"
_DARK = 0.25  # of the full range: what no normal exposure stays below
_FORMATS = ("PNG", "JPEG", "WEBP", "BMP")


def decode_image(content: bytes, bits: int | None = None) -> NDArray[np.uint8]:
    """Decode a PNG, JPEG, WebP or BMP image.

    Transparency is dropped, 16-bit grey is cut to 8 bits, JPEG orientation marks are applied. Cameras of 10 to 14 bits
    write 16-bit files whose upper bits are empty: cut to the upper 8 they would be black.

    Args:
        content: the file's bytes.
        bits: bits that a channel of 16 really has; what the file says, or 16, if None.

    Returns:
        [H, W, 3] red, green, blue.

    Raises:
        ValueError: no such image, truncated, corrupt, too large, or of 16 bits of which the upper ones are empty; the
            message is one line.
    """
    try:
        wide, stated = _depth(content)
        with Image.open(io.BytesIO(content), formats=_FORMATS) as image:
            width, height = image.size
            if width * height <= MAX_PIXELS and max(width, height) <= MAX_ASPECT * min(width, height):
                if wide:
                    _refuse_empty_bits(image, bits or stated)
                return _rgb(ImageOps.exif_transpose(image), bits or stated or 16)
    except _Doubtful:
        raise
    except Image.DecompressionBombError:
        raise ValueError(f"more than {MAX_PIXELS} pixels") from None
    except Exception as error:
        # Corrupt bytes surface as a dozen exception types of Pillow, zlib and struct; all mean the same.
        text = " ".join(str(error).split())[:80]
        known = isinstance(error, UnidentifiedImageError)
        raise ValueError("not a PNG, JPEG, WebP or BMP image" if known else f"corrupt or truncated ({text})") from error
    raise ValueError(f"{width} x {height} pixels, over {MAX_PIXELS} pixels or {MAX_ASPECT} times as long as wide")


class _Doubtful(ValueError):
    """An image that can be decoded and hardly means what comes of it."""


def _depth(content: bytes) -> tuple[bool, int | None]:
    """Whether a file is a PNG of 16 bits per channel, and how many of them it says are significant (chunk sBIT)."""
    if not content.startswith(_PNG) or content[24:25] != b"\x10":
        return False, None
    at = len(_PNG)
    while at + 12 <= len(content):
        length, kind = int.from_bytes(content[at : at + 4], "big"), content[at + 4 : at + 8]
        if kind == b"sBIT" and length:
            stated = max(content[at + 8 : at + 8 + min(length, 3)])
            return True, stated if stated in BITS else None
        if kind == b"IDAT":
            break
        at += 12 + length
    return True, None


def _refuse_empty_bits(image: Image.Image, bits: int | None) -> None:
    """Refuse a 16-bit image whose upper bits are empty, where nobody said that they are, and colour where they are."""
    colour = not image.mode.startswith("I")
    if colour and bits is not None and bits < 16:
        raise _Doubtful(f"colour of {bits} bits in 16, which cannot be read; convert it to 8 bits")
    # Pillow gives colour in its upper 8 bits.
    peak = int(np.asarray(image).max(initial=0)) / (255 if colour else 65535)
    if 0 < peak < _DARK and bits is None:
        way = "convert it to 8 bits" if colour else "say --bits 12, or as many as it has"
        raise _Doubtful(f"16 bits of which the upper ones are empty; {way} (--bits 16: it is only dark)")


def _rgb(image: Image.Image, bits: int) -> NDArray[np.uint8]:
    if image.mode.startswith("I"):  # 16-bit grey; Pillow's own conversion saturates
        grey = np.asarray(image).astype(np.int64) >> bits - 8
        return np.repeat(np.clip(grey, 0, 255).astype(np.uint8)[..., None], 3, axis=2)
    if image.mode == "P" and "transparency" in image.info:
        image = image.convert("RGBA")
    return np.asarray(image.convert("RGB"))

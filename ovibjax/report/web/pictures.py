"""Pictures inside a page: as few bytes as show no difference at the size at which a page shows them."""

import base64
import io
import re
from pathlib import Path
from typing import NamedTuple

from PIL import Image, UnidentifiedImageError

from ovibjax.errors import InputError

MOST_WIDE_PX = 1600
"""Twice the width at which a page shows a picture, for screens with fine pixels and for paper."""

_COLOURS = 128
"""Colours of a drawing: enough for its lines and the soft edges of its letters."""

_QUALITY = 70


class Picture(NamedTuple):
    """A picture that is part of a page.

    Attributes:
        uri: the picture itself, as the address that an `img` takes.
        width: pixels.
        height: pixels.
    """

    uri: str
    width: int
    height: int


def embedded(path: Path) -> Picture:
    """A picture as part of a page: drawings without loss in few colours, photographs with some, whichever is smaller.

    Args:
        path: a PNG or other file that Pillow reads.

    Returns:
        The picture.

    Raises:
        InputError: it cannot be read.
    """
    try:
        with Image.open(path) as file:
            image = file.convert("RGB")
    except (OSError, UnidentifiedImageError) as error:
        raise InputError(f"{path}: not a picture ({error}); remove it, or make the figure again") from error
    if image.width > MOST_WIDE_PX:
        image.thumbnail((MOST_WIDE_PX, image.height), Image.Resampling.LANCZOS)
    drawn = image.quantize(_COLOURS, dither=Image.Dither.NONE).convert("RGB")
    ways = (_webp(drawn, lossless=True, quality=80, method=4), _webp(image, quality=_QUALITY, method=4))
    # A drawing stays sharp without loss; only where that is far larger is it a photograph.
    best = ways[0] if len(ways[0]) < 1.3 * len(ways[1]) else ways[1]
    return Picture(f"data:image/webp;base64,{base64.b64encode(best).decode()}", image.width, image.height)


def without_pictures(html: str) -> str:
    """A page with the bytes of its pictures left out, which depend on the version of the library that packs them."""
    return re.sub(r"data:image/webp;base64,[A-Za-z0-9+/=]+", "data:image/webp;base64,", html)


def _webp(image: Image.Image, **options: object) -> bytes:
    stream = io.BytesIO()
    image.save(stream, "WEBP", **options)
    return stream.getvalue()

"""What every image backbone Φ is: preprocessing and embedding under one name (paper, "Feature Extraction")."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

CLIP_SIZE_PX = 224
CLIP_MEAN = (0.48145466, 0.4578275, 0.40821073)
CLIP_STD = (0.26862954, 0.26130258, 0.27577711)
"""Input side, channel means and deviations of CLIP ViT-B/32, images in [0, 1]."""
LAYOUTS = ("nchw", "nhwc")


@dataclass(frozen=True)
class BackboneOptions:
    """Choices of an `onnx:FILE` backbone; what is None comes from the side file, the model, or CLIP's values.

    Attributes:
        size_px: rows and columns of the network's input.
        layout: `nchw` (channels first) or `nhwc`.
        mean: mean of red, green and blue, images in [0, 1].
        std: standard deviation of red, green and blue.
        output: name of the output to use; the first one with two axes otherwise, or with those that `pool` is for.
        pool: how an output becomes a vector: `first` or `mean` of [N, T, d] tokens, `mean` or `gem` of [N, C, H, W].
        side_file: JSON file with any of `size`, `layout`, `mean`, `std`, `output`, `pool`; `FILE.json` if that exists.
    """

    size_px: tuple[int, int] | None = None
    layout: str | None = None
    mean: tuple[float, float, float] | None = None
    std: tuple[float, float, float] | None = None
    output: str | None = None
    pool: str | None = None
    side_file: Path | None = None


@dataclass(frozen=True)
class Backbone:
    """An image encoder Φ.

    Attributes:
        name: "embedded", "clip", "onnx:FILE".
        fingerprint: hex hash of weights and preprocessing: a resumed extraction must meet the same one.
        preprocess: RGB [H, W, 3] uint8 to one float32 input of the network.
        embed: inputs [B, ...] to features [B, d] float32 of any norm; takes any B.
    """

    name: str
    fingerprint: str
    preprocess: Callable[[NDArray[np.uint8]], NDArray[np.float32]]
    embed: Callable[[NDArray[np.float32]], NDArray[np.float32]]


def resize_and_crop(rgb: NDArray[np.uint8], size_px: tuple[int, int]) -> NDArray[np.uint8]:
    """CLIP's geometry: scale until the image just covers the input (bicubic, antialiased), then cut the middle.

    Args:
        rgb: [H, W, 3] image.
        size_px: rows and columns wanted.

    Returns:
        [*size_px, 3] image.
    """
    height, width = rgb.shape[:2]
    rows, columns = size_px
    # Whole-number arithmetic: the covered side fits exactly, the other is rounded down as CLIP does.
    if rows * width >= columns * height:
        scaled = (rows, max(rows * width // height, columns))
    else:
        scaled = (max(columns * height // width, rows), columns)
    image = Image.fromarray(rgb).resize((scaled[1], scaled[0]), Image.Resampling.BICUBIC)
    top, left = (scaled[0] - rows) // 2, (scaled[1] - columns) // 2
    return np.asarray(image.crop((left, top, left + columns, top + rows)))


def normalise(
    rgb: NDArray[np.uint8], mean: tuple[float, ...], std: tuple[float, ...], layout: str
) -> NDArray[np.float32]:
    """Pixels in [0, 1] less the mean, over the deviation, in the network's layout.

    Args:
        rgb: [H, W, 3] image.
        mean: per channel.
        std: per channel.
        layout: one of `LAYOUTS`.

    Returns:
        [3, H, W] or [H, W, 3] float32.
    """
    scaled = (rgb / 255.0 - np.array(mean)) / np.array(std)
    return np.ascontiguousarray(scaled.transpose(2, 0, 1) if layout == "nchw" else scaled, np.float32)


def fingerprint(*parts: bytes | str | Path) -> str:
    """Hash of weights and settings, in the order given; 32 hexadecimal digits.

    Args:
        parts: bytes, text, or files whose content counts, and whose names do not.

    Returns:
        The hash.

    Raises:
        OSError: a file cannot be read.
    """
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, Path):
            with part.open("rb") as file:
                content = hashlib.file_digest(file, "sha256").digest()
        else:
            content = part.encode() if isinstance(part, str) else part
        digest.update(len(content).to_bytes(8, "little"))
        digest.update(content)
    return digest.hexdigest()[:32]

"""CLIP's image features, the paper's Φ: the backbone `clip`, `clip:FOLDER` or `clip:OWNER/NAME`.

Nothing is downloaded: weights come from a folder, or from the model cache of this machine, where `hf download` puts
them. The tower runs in JAX on any device.
"""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ovibjax.errors import InputError
from ovibjax.features.backbones.clip_weights import read_json, read_tower
from ovibjax.features.backbones.image_encoder import (
    CLIP_MEAN,
    CLIP_STD,
    Backbone,
    fingerprint,
    normalise,
    resize_and_crop,
)
from ovibjax.features.backbones.vision_tower import embed
from ovibjax.runtime.batches import padded_batches

CLIP_NAME = "openai/clip-vit-base-patch32"
_BATCH = 16  # divides the images of 16 frames, whether they have four views or five
_embed = jax.jit(embed, static_argnames="config")


def open_clip(place: str | None = None) -> Backbone:
    """CLIP's image tower, its projection and its preprocessing; float32.

    Args:
        place: folder of a model, or its name `OWNER/NAME` in this machine's model cache; ViT-B/32 if None.

    Returns:
        The backbone; d is the model's projection dimension, 512 for ViT-B/32.

    Raises:
        InputError: the extra `[clip]` or the weights are missing, or the folder holds another kind of model.
    """
    folder = _folder(place)
    tower, static, image_size_px = read_tower(folder)
    size, mean, std = _preprocessing(folder, image_size_px)

    def preprocess(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        return normalise(resize_and_crop(rgb, (size, size)), mean, std, "nchw")

    def embed_all(inputs: NDArray[np.float32]) -> NDArray[np.float32]:
        batches = padded_batches(inputs, _BATCH)
        return np.concatenate(
            [np.asarray(_embed(tower, jnp.asarray(batch), config=static))[:n] for n, batch in batches]
        )

    weights = [np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(tower)]
    mark = fingerprint("clip", repr((static, size, mean, std)), *weights)
    return Backbone("clip" if place is None else f"clip:{place}", mark, preprocess, embed_all)


def _folder(place: str | None) -> Path:
    """Where the model lies: a folder as it stands, else the snapshot of a name in the model cache."""
    if place is not None and (Path(place).exists() or place.count("/") != 1):
        return Path(place)
    try:
        from huggingface_hub import try_to_load_from_cache
        from huggingface_hub.errors import HFValidationError
    except ImportError as error:
        raise InputError('clip needs the extra [clip]: pip install "ovibjax[clip]"') from error
    name = place or CLIP_NAME
    try:
        found = try_to_load_from_cache(name, "config.json")
    except HFValidationError:
        found = None
    if not isinstance(found, str):
        advice = f"fetch them once where there is a network (hf download {name}), or name a folder: clip:FOLDER"
        raise InputError(f"the weights of {name} are not on this machine; {advice}")
    return Path(found).parent


def _preprocessing(folder: Path, image_size: int) -> tuple[int, tuple[float, ...], tuple[float, ...]]:
    """Side of the input and channel statistics, as the model's own preprocessor file states them."""
    stated: dict[str, Any] = {}
    if (folder / "preprocessor_config.json").is_file():
        stated = read_json(folder / "preprocessor_config.json")
    elif (folder / "processor_config.json").is_file():
        stated = read_json(folder / "processor_config.json").get("image_processor", {})
    size, crop = stated.get("size", image_size), stated.get("crop_size", image_size)
    size = size.get("shortest_edge", size.get("height")) if isinstance(size, dict) else size
    crop = crop.get("height") if isinstance(crop, dict) else crop
    mean, std = (stated.get(key, value) for key, value in (("image_mean", CLIP_MEAN), ("image_std", CLIP_STD)))
    numbers = [value for part in (mean, std) if isinstance(part, list | tuple) for value in part]
    usual = size == crop == image_size and stated.get("resample", 3) == 3 and len(numbers) == 6
    if not usual or not all(isinstance(value, int | float) for value in numbers) or min(numbers[3:]) <= 0:
        raise InputError(f"{folder}: its preprocessor_config.json does not describe CLIP's preprocessing")
    return image_size, tuple(numbers[:3]), tuple(numbers[3:])

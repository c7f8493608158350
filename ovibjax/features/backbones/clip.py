"""CLIP's image features through transformers: the backbone `clip` or `clip:FOLDER`, the paper's Φ.

Nothing is downloaded: weights come from a folder, or from the model cache of this machine.
"""

import os
from contextlib import redirect_stderr
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ovibjax.errors import InputError
from ovibjax.features.backbones.image_encoder import (
    CLIP_MEAN,
    CLIP_STD,
    Backbone,
    fingerprint,
    normalise,
    resize_and_crop,
)

CLIP_NAME = "openai/clip-vit-base-patch32"
_BATCH = 32


def open_clip(folder: str | None = None) -> Backbone:
    """CLIP's image tower, its projection and its preprocessing; float32, in evaluation mode.

    Args:
        folder: a model saved by transformers; ViT-B/32 from this machine's model cache if None.

    Returns:
        The backbone; d is the model's projection dimension, 512 for ViT-B/32.

    Raises:
        InputError: the extra `[clip]` or the weights are missing, or the folder holds another kind of model.
    """
    if folder is not None and not (Path(folder) / "config.json").is_file():
        raise InputError(f"{folder}: no CLIP model: the folder has no config.json; save one with save_pretrained")
    try:
        import torch
        from transformers import CLIPConfig, CLIPModel
        from transformers.image_processing_utils import BaseImageProcessor
    except ImportError as error:
        raise InputError('clip needs the extra [clip]: pip install "ovibjax[clip]"') from error
    source = folder or CLIP_NAME
    try:
        kind = CLIPConfig.get_config_dict(source, local_files_only=True)[0].get("model_type")
        if kind != "clip":
            raise InputError(f"{source}: a model of type {kind!r}, not CLIP; use onnx:FILE for other networks")
        with Path(os.devnull).open("w") as sink, redirect_stderr(sink):
            model, found = CLIPModel.from_pretrained(source, local_files_only=True, output_loading_info=True)
    except InputError:
        raise
    except Exception as error:
        advice = f"fetch them once where there is a network (hf download {CLIP_NAME}), or name a folder: clip:FOLDER"
        if folder is None:
            raise InputError(f"the weights of {CLIP_NAME} are not on this machine; {advice}") from error
        raise InputError(f"{folder}: not a CLIP model ({' '.join(str(error).split())[:160]})") from error
    if missing := sorted(name for name in found["missing_keys"] if name.startswith("vis")):
        raise InputError(f"{source}: weights are missing from the model: {missing[0]} and {len(missing) - 1} more")
    model.float().eval()
    try:
        stated = BaseImageProcessor.get_image_processor_dict(source, local_files_only=True)[0]
    except (OSError, ValueError):
        stated = {}
    size, mean, std = _preprocessing(source, stated, model.config.vision_config.image_size)

    def preprocess(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        return normalise(resize_and_crop(rgb, (size, size)), mean, std, "nchw")

    def embed(inputs: NDArray[np.float32]) -> NDArray[np.float32]:
        parts = []
        with torch.no_grad():
            for start in range(0, len(inputs), _BATCH):
                pixels = torch.from_numpy(np.ascontiguousarray(inputs[start : start + _BATCH]))
                pooled = model.vision_model(pixel_values=pixels).pooler_output
                parts.append(model.visual_projection(pooled).numpy())
        return np.concatenate(parts)

    towers = (model.vision_model, model.visual_projection)
    weights = [tensor.detach().numpy().tobytes() for tower in towers for tensor in tower.state_dict().values()]
    mark = fingerprint("clip", repr((size, mean, std)), *weights)
    return Backbone("clip" if folder is None else f"clip:{folder}", mark, preprocess, embed)


def _preprocessing(
    source: str, stated: dict[str, Any], image_size: int
) -> tuple[int, tuple[float, ...], tuple[float, ...]]:
    """Side of the input and channel statistics, as the model's own preprocessor file states them."""
    size, crop = stated.get("size", image_size), stated.get("crop_size", image_size)
    size = size.get("shortest_edge", size.get("height")) if isinstance(size, dict) else size
    crop = crop.get("height") if isinstance(crop, dict) else crop
    mean, std = (tuple(stated.get(key, value)) for key, value in (("image_mean", CLIP_MEAN), ("image_std", CLIP_STD)))
    usual = size == crop == image_size and stated.get("resample", 3) == 3 and len(mean) == len(std) == 3
    if not usual:
        raise InputError(f"{source}: its preprocessor_config.json does not describe CLIP's preprocessing")
    return image_size, mean, std

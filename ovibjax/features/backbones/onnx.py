"""Any image network saved as ONNX, run by onnxruntime on the CPU: the backbone `onnx:FILE`.

What the options leave open comes from the side file (`FILE.json` beside the model, keys `size`, `layout`, `mean`,
`std`, `output`, `pool`), then from the model's declared input shape, then from CLIP: 224 x 224 px, channels first,
CLIP's channel means and deviations. Images are scaled to cover the input (bicubic) and cut in the middle, as CLIP does.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ovibjax.errors import InputError, refusal
from ovibjax.features.backbones.image_encoder import (
    CLIP_MEAN,
    CLIP_SIZE_PX,
    CLIP_STD,
    LAYOUTS,
    Backbone,
    BackboneOptions,
    fingerprint,
    normalise,
    resize_and_crop,
)
from ovibjax.features.backbones.onnx_errors import cause_of
from ovibjax.features.backbones.onnx_files import model_files
from ovibjax.features.backbones.onnx_outputs import POOLS, choose_output, vectors
from ovibjax.runtime.batches import padded_batches

SIDE_KEYS = ("size", "layout", "mean", "std", "output", "pool")
_MAX_SIDE_BYTES = 64 * 1024
_MAX_SIZE_PX = 4096
_BATCH = 16
_DTYPES: dict[str, type[np.floating[Any]]] = {"tensor(float)": np.float32, "tensor(float16)": np.float16}


@dataclass(frozen=True)
class _Input:
    """The network's one input, and how images become it."""

    name: str
    dtype: type[np.floating[Any]]
    batch: int | None  # None: any
    size_px: tuple[int, int]
    layout: str
    mean: tuple[float, ...]
    std: tuple[float, ...]


def open_onnx(file: str, options: BackboneOptions) -> Backbone:
    """Open an ONNX model as an image backbone.

    Args:
        file: the model.
        options: size, layout, mean, std, output, pool; see the module.

    Returns:
        The backbone; features have whatever dimension the output has.

    Raises:
        InputError: the extra `[onnx]` is missing, the file is no usable model, or options contradict it.
    """
    try:
        import onnxruntime
    except ImportError as error:
        raise InputError('onnx:FILE needs the extra [onnx]: pip install "ovibjax[onnx]"') from error
    path = Path(file)
    if not path.is_file():
        raise refusal(path, "no such model file")
    choices = _choices(path, options)
    settings = onnxruntime.SessionOptions()
    settings.log_severity_level = 4  # what goes wrong is said once, below
    try:
        session = onnxruntime.InferenceSession(str(path), settings, providers=["CPUExecutionProvider"])
    except Exception as error:
        raise refusal(path, f"cannot be loaded: {cause_of(error, onnxruntime.__version__)}") from error
    entry = _entry(path, session, choices)
    pool = choices["pool"]
    output = choose_output(path, session.get_outputs(), choices["output"], pool)
    batch_size = entry.batch or _BATCH

    def embed(inputs: NDArray[np.float32]) -> NDArray[np.float32]:
        parts = []
        for count, batch in padded_batches(inputs, batch_size):
            try:
                found = session.run([output] if output else None, {entry.name: batch.astype(entry.dtype)})
            except Exception as error:
                cause = cause_of(error, onnxruntime.__version__)
                raise refusal(path, f"the model fails on its input of shape {batch.shape}: {cause}") from error
            parts.append(vectors(path, found, len(batch), pool, entry.layout)[:count])
        return np.concatenate(parts)

    def preprocess(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        return normalise(resize_and_crop(rgb, entry.size_px), entry.mean, entry.std, entry.layout)

    try:
        mark = fingerprint("onnx", onnxruntime.__version__, repr((entry, output, pool)), *model_files(path))
    except OSError as error:
        raise refusal(path, f"cannot be read ({error.strerror})") from error
    return Backbone(f"onnx:{file}", mark, preprocess, embed)


def _choices(path: Path, options: BackboneOptions) -> dict[str, Any]:
    """Options over side file, checked; None where neither says anything."""
    side = options.side_file or path.with_name(path.name + ".json")
    stated = _side_file(side) if options.side_file or side.is_file() else {}
    given = {"size": options.size_px, "layout": options.layout, "mean": options.mean, "std": options.std}
    given |= {"output": options.output, "pool": options.pool}
    chosen: dict[str, Any] = {}
    for key in SIDE_KEYS:
        source, value = (path, given[key]) if given[key] is not None else (side, stated.get(key))
        chosen[key] = None if value is None else _checked(source, key, value)
    return chosen


def _side_file(side: Path) -> dict[str, Any]:
    try:
        with side.open("rb") as file:
            content = json.loads(file.read(_MAX_SIDE_BYTES + 1))
    except OSError as error:
        raise refusal(side, f"cannot be read ({error.strerror})") from error
    except (ValueError, RecursionError) as error:
        raise refusal(side, f"is not a JSON file of at most {_MAX_SIDE_BYTES} bytes") from error
    if not isinstance(content, dict):
        raise refusal(side, f"is not a JSON object with any of {', '.join(SIDE_KEYS)}")
    for key in content:
        if key not in SIDE_KEYS:
            raise refusal(side, f"unknown key {key!r}; it may hold {', '.join(SIDE_KEYS)}")
    return content


def _checked(source: Path, key: str, value: Any) -> Any:
    """One choice in its own type."""
    numbers = list(value) if isinstance(value, list | tuple) else [value]
    real = all(isinstance(x, int | float) and not isinstance(x, bool) and math.isfinite(x) for x in numbers)
    if key == "size":
        whole = real and all(isinstance(x, int) and 1 <= x <= _MAX_SIZE_PX for x in numbers)
        if whole and len(numbers) in (1, 2):
            return numbers[0], numbers[-1]
        raise refusal(source, f"size {value!r} is not a side, or rows and columns, of 1 to {_MAX_SIZE_PX} px")
    if key in ("mean", "std"):
        if real and len(numbers) == 3 and (key == "mean" or min(numbers) > 0):
            return tuple(float(x) for x in numbers)
        raise refusal(source, f"{key} {value!r} is not three numbers{' above zero' if key == 'std' else ''}")
    if key == "layout" and value not in LAYOUTS:
        raise refusal(source, f"layout {value!r} is not one of {', '.join(LAYOUTS)}")
    if key == "pool" and value not in POOLS:
        raise refusal(source, f"pool {value!r} is not one of {', '.join(POOLS)}")
    if not isinstance(value, str):
        raise refusal(source, f"{key} {value!r} is not a name")
    return value


def _entry(path: Path, session: Any, choices: dict[str, Any]) -> _Input:
    """The input: its declared shape and the choices, which must not contradict each other."""
    inputs = session.get_inputs()
    if len(inputs) != 1:
        names = ", ".join(entry.name for entry in inputs)
        raise refusal(path, f"has {len(inputs)} inputs ({names}); an image backbone has one")
    declared = inputs[0]
    if declared.type not in _DTYPES:
        raise refusal(path, f"input {declared.name!r} is {declared.type}, expected float images")
    shape = [length if isinstance(length, int) and length > 0 else None for length in declared.shape]
    if len(shape) != 4:
        raise refusal(path, f"input {declared.name!r} has {len(shape)} axes, expected 4: a batch of images")
    layout = choices["layout"] or ("nhwc" if shape[3] == 3 and shape[1] != 3 else "nchw")
    axes = (2, 3) if layout == "nchw" else (1, 2)
    channels, other = (shape[1], shape[3]) if layout == "nchw" else (shape[3], shape[1])
    size = choices["size"] or tuple(shape[axis] or CLIP_SIZE_PX for axis in axes)
    agreed = all(shape[axis] in (None, have) for axis, have in zip(axes, size, strict=True))
    if channels not in (None, 3) or (channels is None and other == 3) or not agreed:
        raise refusal(path, f"input has shape {declared.shape}, which is not {layout} images of {size[0]} x {size[1]}")
    mean, std = choices["mean"] or CLIP_MEAN, choices["std"] or CLIP_STD
    return _Input(declared.name, _DTYPES[declared.type], shape[0], size, layout, mean, std)

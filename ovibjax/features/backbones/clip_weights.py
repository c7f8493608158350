"""CLIP's vision tower from a folder as transformers saves one: `config.json` and `model.safetensors`.

Where a folder has `flax_model.msgpack` instead, that is read. PyTorch's `pytorch_model.bin` is a pickle, which may run
anything, and is never opened.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ovibjax.errors import InputError, one_line, refusal
from ovibjax.features.backbones.vision_tower import ACTIVATIONS, Affine, Layer, Tower, TowerConfig

_MAX_JSON_BYTES = 2**20
_KINDS = ("clip", "clip_vision_model")
# What transformers leaves out of a configuration where it is usual.
_USUAL = {"num_attention_heads": 12, "image_size": 224, "hidden_act": "quick_gelu", "layer_norm_eps": 1e-5}
_LAYERS = "vision_model.encoder.layers."
_PARTS = {
    "norm1": "layer_norm1",
    "query": "self_attn.q_proj",
    "key": "self_attn.k_proj",
    "value": "self_attn.v_proj",
    "out": "self_attn.out_proj",
    "norm2": "layer_norm2",
    "expand": "mlp.fc1",
    "shrink": "mlp.fc2",
}


def read_json(path: Path) -> dict[str, Any]:
    """A small JSON object.

    Raises:
        InputError: missing, unreadable, too large, or no object.
    """
    try:
        with path.open("rb") as file:
            content = json.loads(file.read(_MAX_JSON_BYTES))
    except OSError as error:
        raise refusal(path, f"cannot be read ({error.strerror or error})") from error
    except (ValueError, RecursionError) as error:
        raise refusal(path, "is no JSON file of at most 1 MiB; save the model again") from error
    if not isinstance(content, dict):
        raise refusal(path, "is no JSON object; save the model again")
    return content


def read_tower(folder: Path) -> tuple[Tower, TowerConfig, int]:
    """Weights and configuration of the vision tower in a folder.

    Args:
        folder: of the model.

    Returns:
        Weights in float32, what is static, and the side of the input in pixels.

    Raises:
        InputError: another kind of model, or weights that are missing, damaged or of shapes that do not fit.
    """
    config, size_px = _config(folder)
    weights = _Weights(folder)
    vision = "vision_model."
    token = weights.take(f"{vision}embeddings.class_embedding", None)
    width = len(token)
    patch = weights.take(f"{vision}embeddings.patch_embedding.weight", width, 3, None, None)
    side = patch.shape[-1]
    if patch.shape[2] != side or size_px % side or width % config["num_attention_heads"]:
        sizes = f"{patch.shape[2]} x {side} px patches, {size_px} px images, {config['num_attention_heads']} heads"
        raise refusal(folder, f"its config.json does not fit its weights ({sizes}, width {width})")
    hidden = len(weights.take(f"{_LAYERS}0.mlp.fc1.bias", None))
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(_PARTS, (width, width))
    shapes |= {"norm1": (width,), "norm2": (width,), "expand": (hidden, width), "shrink": (width, hidden)}
    count = len({name.removeprefix(_LAYERS).split(".")[0] for name in weights.names if name.startswith(_LAYERS)})
    layers = {}
    for part, name in _PARTS.items():
        places = [f"{_LAYERS}{number}.{name}" for number in range(count)]
        stacked = np.stack([weights.take(f"{place}.weight", *shapes[part]).T for place in places])
        biases = np.stack([weights.take(f"{place}.bias", shapes[part][0]) for place in places])
        layers[part] = Affine(jnp.asarray(stacked), jnp.asarray(biases))
    tower = Tower(
        patch=jnp.asarray(patch.reshape(width, -1).T),
        token=jnp.asarray(token),
        position=jnp.asarray(
            weights.take(f"{vision}embeddings.position_embedding.weight", (size_px // side) ** 2 + 1, width)
        ),
        norm_in=weights.norm(f"{vision}pre_layrnorm", width),
        layers=Layer(**layers),
        norm_out=weights.norm(f"{vision}post_layernorm", width),
        projection=jnp.asarray(weights.take("visual_projection.weight", None, width).T),
    )
    static = TowerConfig(side, config["num_attention_heads"], config["hidden_act"], float(config["layer_norm_eps"]))
    return tower, static, size_px


def _config(folder: Path) -> tuple[dict[str, Any], int]:
    """What the vision tower's part of config.json says, and the side of its input."""
    if not (folder / "config.json").is_file():
        raise InputError(f"{folder}: no CLIP model: the folder has no config.json; save one with save_pretrained")
    whole = read_json(folder / "config.json")
    if (kind := whole.get("model_type")) not in _KINDS:
        raise InputError(f"{folder}: a model of type {kind!r}, not CLIP; use onnx:FILE for other networks")
    part = whole if kind == _KINDS[1] else whole.get("vision_config", {})
    config: dict[str, Any] = _USUAL | {key: part[key] for key in _USUAL if isinstance(part, Mapping) and key in part}
    whole_numbers = (config["num_attention_heads"], config["image_size"])
    usable = all(isinstance(number, int) and 0 < number < 2**16 for number in whole_numbers)
    if not usable or not isinstance(config["layer_norm_eps"], float | int):
        raise refusal(folder / "config.json", f"describes no vision tower ({config}); save the model again")
    if config["hidden_act"] not in ACTIVATIONS:
        known = " and ".join(ACTIVATIONS)
        raise refusal(folder / "config.json", f"activation {config['hidden_act']!r}; CLIP's are {known}")
    return config, int(config["image_size"])


class _Weights:
    """Tensors of a folder by the names that transformers gives them."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._flat: dict[str, NDArray[Any]] | None = None
        try:
            if (folder / "model.safetensors").is_file():
                from safetensors import safe_open

                self._file = safe_open(folder / "model.safetensors", framework="numpy")
                self.names = frozenset(self._file.keys())
            elif (folder / "flax_model.msgpack").is_file():
                self._flat = _from_flax(folder / "flax_model.msgpack")
                self.names = frozenset(self._flat)
            else:
                found = [name for name in ("pytorch_model.bin", "tf_model.h5") if (folder / name).is_file()]
                has = f"it has {found[0]}, which is not read; " if found else ""
                advice = "save the model with transformers once, save_pretrained(FOLDER)"
                raise refusal(folder, f"no model.safetensors; {has}{advice}")
        except ImportError as error:
            raise InputError('clip needs the extra [clip]: pip install "ovibjax[clip]"') from error
        except InputError:
            raise
        except Exception as error:
            # Damaged files surface as several exception types; all mean the same.
            raise refusal(folder, f"its weights are damaged ({one_line(error, 120)}); copy them again") from error

    def take(self, name: str, *shape: int | None) -> NDArray[np.float32]:
        """A tensor in float32; of this shape, where None stands for any length."""
        if name not in self.names:
            raise refusal(self._folder, f"weights are missing from the model: {name}")
        try:
            array = self._flat[name] if self._flat is not None else self._file.get_tensor(name)
            found: NDArray[np.float32] = np.asarray(array).astype(np.float32)
        except Exception as error:
            raise refusal(self._folder, f"{name} cannot be read ({one_line(error, 120)})") from error
        if len(found.shape) != len(shape) or any(b not in (None, a) for a, b in zip(found.shape, shape, strict=True)):
            expected = ", ".join("?" if length is None else str(length) for length in shape)
            raise refusal(self._folder, f"{name} has shape {list(found.shape)}, expected [{expected}]")
        return found

    def norm(self, name: str, width: int) -> Affine:
        """Scale and shift of a layer normalisation."""
        return Affine(*(jnp.asarray(self.take(f"{name}.{part}", width)) for part in ("weight", "bias")))


def _from_flax(path: Path) -> dict[str, NDArray[Any]]:
    """Tensors of flax's own format, named and laid out as in the other."""
    from flax.serialization import msgpack_restore
    from flax.traverse_util import flatten_dict

    tensors = {}
    for place, array in flatten_dict(msgpack_restore(path.read_bytes())).items():
        *parts, kind = map(str, place)
        if kind == "kernel":  # [in, out], or [height, width, in, out] of a convolution
            array = array.transpose(3, 2, 0, 1) if array.ndim == 4 else array.T
        name = kind if kind in ("bias", "class_embedding") else "weight"
        tensors[".".join([*parts, name])] = array
    return tensors

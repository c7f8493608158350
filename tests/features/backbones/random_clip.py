"""CLIP models with random weights in a folder, as transformers saves them."""

import json
from pathlib import Path

import numpy as np

SIZE_PX, PATCH_PX, WIDTH, HIDDEN, HEADS, LAYERS, DIM = 32, 8, 16, 40, 2, 3, 24
CONFIG = {"model_type": "clip", "projection_dim": DIM}
VISION = {"image_size": SIZE_PX, "patch_size": PATCH_PX, "num_attention_heads": HEADS, "hidden_size": WIDTH}


def shapes() -> dict[str, tuple[int, ...]]:
    """Shapes of the vision tower's tensors by name."""
    tokens = (SIZE_PX // PATCH_PX) ** 2 + 1
    found: dict[str, tuple[int, ...]] = {
        "vision_model.embeddings.class_embedding": (WIDTH,),
        "vision_model.embeddings.patch_embedding.weight": (WIDTH, 3, PATCH_PX, PATCH_PX),
        "vision_model.embeddings.position_embedding.weight": (tokens, WIDTH),
        "visual_projection.weight": (DIM, WIDTH),
        "text_model.final_layer_norm.weight": (7,),
        "logit_scale": (),
    }
    norms, linears = ["pre_layrnorm", "post_layernorm"], {}
    for number in range(LAYERS):
        name = f"encoder.layers.{number}"
        norms += [f"{name}.layer_norm1", f"{name}.layer_norm2"]
        linears |= {f"{name}.self_attn.{part}_proj": (WIDTH, WIDTH) for part in ("q", "k", "v", "out")}
        linears |= {f"{name}.mlp.fc1": (HIDDEN, WIDTH), f"{name}.mlp.fc2": (WIDTH, HIDDEN)}
    for name, shape in {**dict.fromkeys(norms, (WIDTH,)), **linears}.items():
        found |= {f"vision_model.{name}.weight": shape, f"vision_model.{name}.bias": shape[:1]}
    return found


def random_weights(seed: int = 0) -> dict[str, np.ndarray]:
    """Tensors of a size at which no activation is dead or saturated."""
    rng = np.random.default_rng(seed)
    scales = {name: float("norm" in name and name.endswith("weight")) for name in shapes()}
    return {
        name: np.asarray(rng.normal(size=shape) * 0.3 + scales[name], np.float32) for name, shape in shapes().items()
    }


def write_config(folder: Path, vision: dict | None = None, **changes) -> None:
    """`config.json` of this model, with changes."""
    whole = CONFIG | {"vision_config": VISION | (vision or {})} | changes
    (folder / "config.json").write_text(json.dumps(whole))


def write_model(folder: Path, weights: dict[str, np.ndarray], **changes) -> Path:
    """A folder with configuration and `model.safetensors`."""
    from safetensors.numpy import save_file

    folder.mkdir(parents=True, exist_ok=True)
    write_config(folder, **changes)
    save_file(weights, folder / "model.safetensors")
    return folder

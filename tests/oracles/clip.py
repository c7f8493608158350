"""CLIP's vision tower token by token in NumPy, from its paper and the layout of the saved tensors; slow and obvious."""

import numpy as np
from scipy.special import erf


def linear(weights, name, x):
    return weights[f"{name}.weight"] @ x + weights[f"{name}.bias"]


def normalised(weights, name, x, epsilon):
    return (x - x.mean()) / np.sqrt(x.var() + epsilon) * weights[f"{name}.weight"] + weights[f"{name}.bias"]


def activated(x, activation):
    return x / (1 + np.exp(-1.702 * x)) if activation == "quick_gelu" else x * (1 + erf(x / np.sqrt(2))) / 2


def attended(weights, name, tokens, heads):
    parts = {part: [linear(weights, f"{name}.{part}_proj", token) for token in tokens] for part in "qkv"}
    width = len(tokens[0]) // heads
    mixed = [np.zeros(len(tokens[0])) for _ in tokens]
    for head in range(heads):
        cut = slice(head * width, (head + 1) * width)
        for row, query in enumerate(parts["q"]):
            scores = np.exp([query[cut] @ key[cut] / np.sqrt(width) for key in parts["k"]])
            shares = scores / scores.sum()
            mixed[row][cut] = sum(share * value[cut] for share, value in zip(shares, parts["v"], strict=True))
    return [linear(weights, f"{name}.out_proj", token) for token in mixed]


def feature(weights, image, heads, activation="quick_gelu", epsilon=1e-5):
    """The feature of one image [3, H, W]; weights by the names in which they are saved."""
    weights = {name.removeprefix("vision_model."): array.astype(np.float64) for name, array in weights.items()}
    kernel = weights["embeddings.patch_embedding.weight"]
    side = kernel.shape[-1]
    tokens = [weights["embeddings.class_embedding"]]
    for top in range(0, image.shape[1], side):
        for left in range(0, image.shape[2], side):
            patch = image[:, top : top + side, left : left + side]
            tokens.append((kernel * patch).sum(axis=(1, 2, 3)))
    positions = weights["embeddings.position_embedding.weight"]
    tokens = [token + place for token, place in zip(tokens, positions, strict=True)]
    tokens = [normalised(weights, "pre_layrnorm", token, epsilon) for token in tokens]
    layers = len({name.split(".")[2] for name in weights if name.startswith("encoder.layers.")})
    for number in range(layers):
        name = f"encoder.layers.{number}"
        inner = [normalised(weights, f"{name}.layer_norm1", token, epsilon) for token in tokens]
        inner = attended(weights, f"{name}.self_attn", inner, heads)
        tokens = [a + b for a, b in zip(tokens, inner, strict=True)]
        for row, token in enumerate(tokens):
            hidden = linear(weights, f"{name}.mlp.fc1", normalised(weights, f"{name}.layer_norm2", token, epsilon))
            tokens[row] = token + linear(weights, f"{name}.mlp.fc2", activated(hidden, activation))
    return weights["visual_projection.weight"] @ normalised(weights, "post_layernorm", tokens[0], epsilon)

"""Multi-view fusion in float64 NumPy: one frame, one head, one query at a time, over the present views only."""

import numpy as np

from tests.oracles.encoder import gelu


def dense(layer, x):
    return x @ np.asarray(layer["kernel"], np.float64) + np.asarray(layer["bias"], np.float64)


def layer_norm(layer, x):
    """Zero mean and unit variance over the last axis, then scale and shift."""
    centred = x - x.mean(axis=-1, keepdims=True)
    normed = centred / np.sqrt((centred**2).mean(axis=-1, keepdims=True) + 1e-6)
    return normed * np.asarray(layer["scale"], np.float64) + np.asarray(layer["bias"], np.float64)


def attention(layer, tokens):
    """Multi-head self-attention of tokens [S, W] (Vaswani et al., scaled dot products, no biases)."""
    kernels = {name: np.asarray(part["kernel"], np.float64) for name, part in layer.items()}
    out = np.zeros(tokens.shape)
    for head in range(kernels["query"].shape[1]):
        q, k, v = (tokens @ kernels[n][:, head] for n in ("query", "key", "value"))
        for i in range(len(tokens)):
            weights = np.array([np.exp(q[i] @ key / np.sqrt(len(key))) for key in k])
            out[i] += (weights / weights.sum()) @ v @ kernels["out"][head]
    return out


def predict(params, x, view_mask):
    """Standardised positions of x [B, M, r]; absent views are left out of the computation, not masked."""
    p = params["params"]
    positions = []
    for frame, mask in zip(np.asarray(x, np.float64), view_mask, strict=True):
        kernel, embedding = np.asarray(p["token"], np.float64), np.asarray(p["view_embedding"], np.float64)
        tokens = np.stack([frame[m] @ kernel[m] + embedding[m] for m in np.flatnonzero(mask)])
        for block in range(sum(name.startswith("attention_") for name in p)):
            tokens = tokens + attention(p[f"attention_{block}"], layer_norm(p[f"norm_attention_{block}"], tokens))
            hidden = gelu(dense(p[f"mlp_in_{block}"], layer_norm(p[f"norm_mlp_{block}"], tokens)))
            tokens = tokens + dense(p[f"mlp_out_{block}"], hidden)
        pooled = layer_norm(p["norm_pooled"], tokens.mean(axis=0))
        positions.append(dense(p["head_out"], gelu(dense(p["head_in"], pooled))))
    return np.array(positions)

"""CLIP's vision tower in JAX: a vision transformer whose first token, normalised and projected, is the feature.

Radford et al., "Learning Transferable Visual Models From Natural Language Supervision" (ICML 2021). Layers are stacked
and scanned, so that a tower of any depth compiles as one layer.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

ACTIVATIONS = ("quick_gelu", "gelu")


@dataclass(frozen=True)
class TowerConfig:
    """What is static of a tower; the rest is in the shapes of its weights.

    Attributes:
        patch_px: side of a patch.
        heads: of an attention.
        activation: one of `ACTIVATIONS`; CLIP's own is quick_gelu.
        epsilon: of layer normalisation.
    """

    patch_px: int
    heads: int
    activation: str = "quick_gelu"
    epsilon: float = 1e-5


class Affine(NamedTuple):
    """Weights [..., in, out] of a linear map, or [..., D] of a layer normalisation, and their bias."""

    weight: jax.Array
    bias: jax.Array


class Layer(NamedTuple):
    """Weights of a layer, or of all layers with a leading axis [L, ...]."""

    norm1: Affine
    query: Affine
    key: Affine
    value: Affine
    out: Affine
    norm2: Affine
    expand: Affine
    shrink: Affine


class Tower(NamedTuple):
    """Weights of a tower; D is its width, P the side of a patch, T the number of tokens.

    Attributes:
        patch: [3 P P, D] from the pixels of a patch, channels first.
        token: [D] the first token.
        position: [T, D].
        norm_in: before the layers.
        layers: [L, ...] of each.
        norm_out: of the first token, after the layers.
        projection: [D, d].
    """

    patch: jax.Array
    token: jax.Array
    position: jax.Array
    norm_in: Affine
    layers: Layer
    norm_out: Affine
    projection: jax.Array


def embed(tower: Tower, images: jax.Array, config: TowerConfig) -> jax.Array:
    """Features of images.

    Args:
        tower: the weights, float32.
        images: [B, 3, H, W] preprocessed as the network was trained, H and W multiples of the patch.
        config: what is static.

    Returns:
        [B, d] of any norm.
    """
    # Products in full float32 on any device: GPUs and TPUs would take fewer digits.
    with jax.default_matmul_precision("float32"):
        tokens = _patches(images, config.patch_px) @ tower.patch
        first = jnp.broadcast_to(tower.token, (len(images), 1, tower.token.size))
        tokens = jnp.concatenate([first, tokens], axis=1) + tower.position[None]
        tokens = _normalise(tower.norm_in, tokens, config.epsilon)

        def step(tokens: jax.Array, layer: Layer) -> tuple[jax.Array, None]:
            return _layer(layer, tokens, config), None

        tokens, _ = jax.lax.scan(step, tokens, tower.layers)
        return _normalise(tower.norm_out, tokens[:, 0], config.epsilon) @ tower.projection


def _patches(images: jax.Array, side: int) -> jax.Array:
    """[B, patches, 3 P P], patches by rows, channels first in each: the convolution by patches as one product."""
    batch, channels, height, width = images.shape
    cut = images.reshape(batch, channels, height // side, side, width // side, side)
    return cut.transpose(0, 2, 4, 1, 3, 5).reshape(batch, -1, channels * side * side)


def _layer(layer: Layer, tokens: jax.Array, config: TowerConfig) -> jax.Array:
    """Attention, then the perceptron, each with a normalised input and a shortcut around it."""
    tokens = tokens + _attend(layer, _normalise(layer.norm1, tokens, config.epsilon), config.heads)
    hidden = _linear(layer.expand, _normalise(layer.norm2, tokens, config.epsilon))
    if config.activation == "quick_gelu":
        hidden = hidden * jax.nn.sigmoid(1.702 * hidden)
    else:
        hidden = jax.nn.gelu(hidden, approximate=False)
    return tokens + _linear(layer.shrink, hidden)


def _attend(layer: Layer, tokens: jax.Array, heads: int) -> jax.Array:
    """Every token attends to all others of its image."""
    shape = (*tokens.shape[:2], heads, -1)
    query, key, value = (_linear(part, tokens).reshape(shape) for part in (layer.query, layer.key, layer.value))
    mixed = jax.nn.dot_product_attention(query, key, value)
    return _linear(layer.out, mixed.reshape(tokens.shape))


def _linear(weights: Affine, x: jax.Array) -> jax.Array:
    return x @ weights.weight + _wide(weights.bias, x)


def _normalise(weights: Affine, x: jax.Array, epsilon: float) -> jax.Array:
    """Zero mean and unit variance over the last axis, then scale and shift."""
    return jax.nn.standardize(x, epsilon=epsilon) * _wide(weights.weight, x) + _wide(weights.bias, x)


def _wide(vector: jax.Array, x: jax.Array) -> jax.Array:
    """A vector for the last axis of an array."""
    return vector.reshape((1,) * (x.ndim - 1) + (-1,))

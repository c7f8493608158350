"""Image backbones Φ: from the views of a frame to one unit-norm feature per view (paper, "Feature Extraction").

The embedded backbone stands in for CLIP ViT-B/32 where no weights can be downloaded: a fixed, seeded convolution
pyramid whose pooled responses are projected to 512 dimensions. It has never seen an image, and it is no CLIP; what
it shares with CLIP is the interface (image in, 512-d unit vector out) and smoothness under small motion.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

EMBEDDED_DIM = 512
EMBEDDED_HEIGHT_PX, EMBEDDED_WIDTH_PX = 48, 64
_CHANNELS = (24, 48, 64)
_GRID = (3, 4)


class EmbeddedBackbone(NamedTuple):
    """Weights of the embedded backbone.

    Attributes:
        filters: convolution kernels, each [h, w, in, out].
        projection: [pooled, 512].
    """

    filters: tuple[np.ndarray, ...]
    projection: np.ndarray


def embedded_backbone(seed: int = 0) -> EmbeddedBackbone:
    """The seeded weights; equal on every machine.

    Args:
        seed: another seed is another backbone.

    Returns:
        The backbone's weights.
    """
    rng = np.random.default_rng([seed, 0xB0])
    filters, channels = [], 3
    for size, out in zip((5, 3, 3), _CHANNELS, strict=True):
        kernel = rng.standard_normal((size, size, channels, out)).astype(np.float32)
        # Two thirds of the filters see edges and texture only; the rest also see brightness and colour.
        edge = np.arange(out) % 3 != 0
        kernel -= edge * kernel.mean(axis=(0, 1), keepdims=True)
        kernel /= np.sqrt((kernel**2).sum(axis=(0, 1, 2), keepdims=True))
        filters.append(kernel)
        channels = out
    pooled = sum(_CHANNELS) * _GRID[0] * _GRID[1]
    projection = rng.standard_normal((pooled, EMBEDDED_DIM)).astype(np.float32) / np.sqrt(pooled)
    return EmbeddedBackbone(tuple(filters), projection.astype(np.float32))


@partial(jax.jit, static_argnames=())
def embed(backbone: EmbeddedBackbone, rgb: jax.Array) -> jax.Array:
    """Features of a batch of images.

    Args:
        backbone: weights from `embedded_backbone`.
        rgb: [B, 48, 64, 3] float32 in [0, 1].

    Returns:
        [B, 512] float32, unit norm.
    """
    x = (rgb - 0.5) * 2.0
    pooled = []
    for kernel in backbone.filters:
        x = jax.lax.conv_general_dilated(
            x, jnp.asarray(kernel), (2, 2), "SAME", dimension_numbers=("NHWC", "HWIO", "NHWC")
        )
        x = jnp.maximum(x, 0.0)
        b, h, w, c = x.shape
        cells = x.reshape(b, _GRID[0], h // _GRID[0], _GRID[1], w // _GRID[1], c).mean(axis=(2, 4))
        # Each level enters with the same weight, whatever its scale; the square root tames bright cells.
        cells = jnp.sqrt(cells)
        cells = cells - cells.mean(axis=(1, 2, 3), keepdims=True)
        pooled.append(cells.reshape(b, -1) / jnp.linalg.norm(cells.reshape(b, -1), axis=1, keepdims=True))
        x = x / (jnp.sqrt(jnp.mean(x**2, axis=(1, 2, 3), keepdims=True)) + 1e-6)
    feature = jnp.concatenate(pooled, axis=1) @ jnp.asarray(backbone.projection)
    return feature / jnp.linalg.norm(feature, axis=1, keepdims=True)

"""The embedded convolution pyramid: from the views of a frame to one unit-norm feature per view.

It stands in for CLIP ViT-B/32 where no weights can be downloaded: a fixed, seeded convolution pyramid whose pooled
responses are projected to 512 dimensions. It has never seen an image, and it is no CLIP; what it shares with CLIP is
the interface (image in, 512-d unit vector out) and smoothness under small motion.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

EMBEDDED_DIM = 512
EMBEDDED_HEIGHT_PX, EMBEDDED_WIDTH_PX = 48, 64
_CHANNELS = (24, 48, 64)
_GRIDS = ((3, 4), (3, 3), (2, 2))  # pooling cells per level, rows x columns: the deeper, the coarser


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
    pooled = sum(c * rows * columns for c, (rows, columns) in zip(_CHANNELS, _GRIDS, strict=True))
    projection = rng.standard_normal((pooled, EMBEDDED_DIM)).astype(np.float32) / np.sqrt(pooled)
    return EmbeddedBackbone(tuple(filters), projection.astype(np.float32))


@jax.jit
def embed(backbone: EmbeddedBackbone, rgb: jax.Array) -> jax.Array:
    """Features of a batch of images.

    Args:
        backbone: weights from `embedded_backbone`.
        rgb: [B, 48, 64, 3] float32 in [0, 1].

    Returns:
        [B, 512] float32, unit norm.
    """
    # Neighbouring frames shift edges by a pixel; blurring first makes the feature change smoothly with the pose.
    x = _blur(_blur(_blur(_blur(rgb - 0.5))))
    levels = []
    for kernel, grid in zip(backbone.filters, _GRIDS, strict=True):
        x = jnp.maximum(_convolve(x, jnp.asarray(kernel)), 0.0)
        # The square root tames bright cells; every level enters with the same weight, whatever its scale.
        cells = jnp.sqrt(_pool(x, grid)).reshape(x.shape[0], -1)
        cells = cells - cells.mean(axis=1, keepdims=True)
        levels.append(cells / jnp.linalg.norm(cells, axis=1, keepdims=True))
        x = x / (jnp.sqrt(jnp.mean(x**2, axis=(1, 2, 3), keepdims=True)) + 1e-6)
    feature = jnp.concatenate(levels, axis=1) @ jnp.asarray(backbone.projection)
    return feature / jnp.linalg.norm(feature, axis=1, keepdims=True)


def _blur(x: jax.Array) -> jax.Array:
    """Binomial 3 x 3 blur, edges repeated."""
    x = jnp.pad(x, ((0, 0), (1, 1), (1, 1), (0, 0)), mode="edge")
    x = (x[:, :-2] + 2 * x[:, 1:-1] + x[:, 2:]) / 4
    return (x[:, :, :-2] + 2 * x[:, :, 1:-1] + x[:, :, 2:]) / 4


def _convolve(x: jax.Array, kernel: jax.Array) -> jax.Array:
    """Convolution of stride 2 with an odd kernel, zeros around the image."""
    stride, pad = (2, 2), [(kernel.shape[0] // 2,) * 2] * 2
    if x.shape[3] < 8 and kernel.shape[0] == 5:
        # Three channels leave a CPU's vectors mostly empty: twelve, of 2 x 2 pixels, are ten times as fast.
        x, kernel, stride, pad = _fold_image(x), _fold_kernel(kernel), (1, 1), [(1, 1)] * 2
    return jax.lax.conv_general_dilated(x, kernel, stride, pad, dimension_numbers=("NHWC", "HWIO", "NHWC"))


def _fold_image(x: jax.Array) -> jax.Array:
    """Each 2 x 2 pixels as one of four times the channels, [B, H/2, W/2, 4 C]."""
    size, rows, columns, channels = x.shape
    blocks = x.reshape(size, rows // 2, 2, columns // 2, 2, channels).transpose(0, 1, 3, 2, 4, 5)
    return blocks.reshape(size, rows // 2, columns // 2, 4 * channels)


def _fold_kernel(kernel: jax.Array) -> jax.Array:
    """The [3, 3, 4 C, out] kernel that does at stride 1 on folded images what a [5, 5, C, out] one does at stride 2."""
    channels, out = kernel.shape[2:]
    whole = jnp.pad(kernel, ((0, 1), (0, 1), (0, 0), (0, 0))).reshape(3, 2, 3, 2, channels, out)
    return whole.transpose(0, 2, 1, 3, 4, 5).reshape(3, 3, 4 * channels, out)


def _pool(x: jax.Array, grid: tuple[int, int]) -> jax.Array:
    """Means over overlapping Gaussian cells, [B, rows, columns, C]."""
    rows, columns = _windows(x.shape[1], grid[0]), _windows(x.shape[2], grid[1])
    return jnp.einsum("bhwc,yh,xw->byxc", x, rows, columns)


def _windows(size: int, cells: int) -> np.ndarray:
    centre = (np.arange(cells) + 0.5) / cells
    at = (np.arange(size) + 0.5) / size
    weight = np.exp(-0.5 * ((at[None] - centre[:, None]) * cells / 0.6) ** 2)
    return (weight / weight.sum(axis=1, keepdims=True)).astype(np.float32)

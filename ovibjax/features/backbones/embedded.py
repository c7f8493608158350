"""The convolution pyramid on images of any size: the backbone `embedded`."""

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ovibjax.features.backbones.image_encoder import Backbone, fingerprint
from ovibjax.features.backbones.pyramid import EMBEDDED_HEIGHT_PX, EMBEDDED_WIDTH_PX, embed, embedded_backbone
from ovibjax.runtime.batches import padded_batches

_BATCH = 80  # images per call: enough to fill the vector units, little to waste on padding


def open_embedded() -> Backbone:
    """The embedded backbone: images are scaled to 64 x 48 px and to [0, 1]; batches have one size, compiled once."""
    weights = embedded_backbone()
    arrays = jax.tree.map(jnp.asarray, weights)

    def preprocess(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        # Pillow widens the filter when it shrinks an image, so nothing aliases.
        image = Image.fromarray(rgb).resize((EMBEDDED_WIDTH_PX, EMBEDDED_HEIGHT_PX), Image.Resampling.BILINEAR)
        return np.asarray(image, np.float32) / np.float32(255)

    def embed_all(inputs: NDArray[np.float32]) -> NDArray[np.float32]:
        parts = [np.asarray(embed(arrays, jnp.asarray(batch)))[:n] for n, batch in padded_batches(inputs, _BATCH)]
        return np.concatenate(parts)

    mark = fingerprint("embedded", "bilinear", *(leaf.tobytes() for leaf in jax.tree.leaves(weights)))
    return Backbone("embedded", mark, preprocess, embed_all)

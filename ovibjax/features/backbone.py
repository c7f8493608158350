"""Image backbones Φ by name (paper, "Feature Extraction")."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ovibjax.errors import InputError


@dataclass(frozen=True)
class BackboneOptions:
    """Choices of a backbone that takes any; the embedded one takes none."""


@dataclass(frozen=True)
class Backbone:
    """An image encoder Φ.

    Attributes:
        name: "embedded".
        fingerprint: hex hash of weights and preprocessing: a resumed extraction must meet the same one.
        preprocess: RGB [H, W, 3] uint8 to one float32 input of the network.
        embed: inputs [B, ...] to features [B, d] float32 of any norm.
    """

    name: str
    fingerprint: str
    preprocess: Callable[[NDArray[np.uint8]], NDArray[np.float32]]
    embed: Callable[[NDArray[np.float32]], NDArray[np.float32]]


def open_backbone(spec: str, options: BackboneOptions = BackboneOptions()) -> Backbone:
    """Make an image backbone ready to use.

    Args:
        spec: `embedded`.
        options: choices of the backbone.

    Returns:
        The backbone.

    Raises:
        InputError: an unknown spec.
    """
    if spec != "embedded":
        raise InputError(f"backbone {spec!r} is not available; this version has: embedded")
    import jax
    import jax.numpy as jnp

    from ovibjax.features.pyramid import EMBEDDED_HEIGHT_PX, EMBEDDED_WIDTH_PX, embed, embedded_backbone

    weights = embedded_backbone()
    arrays = jax.tree.map(jnp.asarray, weights)

    def preprocess(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        # Means over pixel areas: nothing aliases, whatever the size of the image.
        image = Image.fromarray(rgb).resize((EMBEDDED_WIDTH_PX, EMBEDDED_HEIGHT_PX), Image.Resampling.BOX)
        return np.asarray(image, np.float32) / np.float32(255)

    def embed_all(inputs: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.asarray(embed(arrays, jnp.asarray(inputs)))

    digest = hashlib.sha256(b"embedded, box")
    for leaf in jax.tree.leaves(weights):
        digest.update(leaf.tobytes())
    return Backbone("embedded", digest.hexdigest(), preprocess, embed_all)

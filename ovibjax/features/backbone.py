"""Image backbones Φ by name: `embedded`, `clip`, `clip:FOLDER` or `onnx:FILE` (paper, "Feature Extraction")."""

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ovibjax.errors import InputError
from ovibjax.features.image_encoder import Backbone, BackboneOptions, fingerprint, padded_batches
from ovibjax.features.pyramid import EMBEDDED_HEIGHT_PX, EMBEDDED_WIDTH_PX, embed, embedded_backbone

__all__ = ["Backbone", "BackboneOptions", "open_backbone"]

_BATCH = 80  # images per call: enough to fill the vector units, little to waste on padding
_NAMES = "embedded, clip, clip:FOLDER or onnx:FILE"


def open_backbone(spec: str, options: BackboneOptions = BackboneOptions()) -> Backbone:  # noqa: B008 (frozen)
    """Make an image backbone ready to use.

    Args:
        spec: `embedded`; `clip` (CLIP ViT-B/32 from this machine's model cache) or `clip:FOLDER`; `onnx:FILE`.
        options: choices of an ONNX backbone.

    Returns:
        The backbone.

    Raises:
        InputError: an unknown spec, options that the backbone does not take, a missing extra, or missing weights.
    """
    kind, _, place = spec.partition(":")
    if kind == "onnx" and place:
        from ovibjax.features.backbone_onnx import open_onnx

        return open_onnx(place, options)
    if options != BackboneOptions():
        raise InputError(f"backbone {spec!r} takes no options for size, layout, mean, std or output; onnx:FILE does")
    if kind == "clip" and (place or ":" not in spec):
        from ovibjax.features.backbone_clip import open_clip

        return open_clip(place or None)
    if spec == "embedded":
        return _open_embedded()
    raise InputError(f"backbone {spec!r} is not one of {_NAMES}")


def _open_embedded() -> Backbone:
    """The convolution pyramid on images of any size."""
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

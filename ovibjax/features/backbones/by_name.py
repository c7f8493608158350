"""Image backbones Φ by name: `embedded`, `clip`, `clip:FOLDER`, `clip:OWNER/NAME` or `onnx:FILE` (the paper's "Feature
Extraction").

Each is opened by its own module, imported when it is asked for: they stand on libraries that take seconds to load.
"""

from ovibjax.errors import InputError
from ovibjax.features.backbones.image_encoder import Backbone, BackboneOptions

__all__ = ["Backbone", "BackboneOptions", "open_backbone"]


def open_backbone(spec: str, options: BackboneOptions = BackboneOptions()) -> Backbone:  # noqa: B008 (frozen)
    """Make an image backbone ready to use.

    Args:
        spec: `embedded`; `clip` (CLIP ViT-B/32 from this machine's model cache), `clip:FOLDER` or `clip:OWNER/NAME`;
            `onnx:FILE`.
        options: choices of an ONNX backbone.

    Returns:
        The backbone.

    Raises:
        InputError: an unknown spec, options that the backbone does not take, a missing extra, or missing weights.
    """
    kind, _, place = spec.partition(":")
    if kind == "onnx" and place:
        from ovibjax.features.backbones.onnx import open_onnx

        return open_onnx(place, options)
    if options != BackboneOptions():
        raise InputError(f"backbone {spec!r} takes no size, layout, mean, std, output or pool; onnx:FILE does")
    if kind == "clip" and (place or ":" not in spec):
        from ovibjax.features.backbones.clip import open_clip

        return open_clip(place or None)
    if spec == "embedded":
        from ovibjax.features.backbones.embedded import open_embedded

        return open_embedded()
    raise InputError(f"backbone {spec!r} is not one of embedded, clip, clip:FOLDER or onnx:FILE")

"""Where data begins: the embedded world, image backbones and feature sets."""

"""Image backbones: networks that turn an image into a feature vector, opened by name or brought along."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

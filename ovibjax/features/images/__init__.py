"""From image files of somebody else to features: sources of images, decoding, resumable extraction, image codecs."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

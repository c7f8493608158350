from .by_name import open_backbone as open_backbone
from .image_encoder import Backbone as Backbone
from .image_encoder import BackboneOptions as BackboneOptions
from .image_encoder import fingerprint as fingerprint
from .image_encoder import normalise as normalise
from .image_encoder import resize_and_crop as resize_and_crop

__all__ = [
    "Backbone",
    "BackboneOptions",
    "fingerprint",
    "normalise",
    "open_backbone",
    "resize_and_crop",
]

from . import backbones as backbones
from . import images as images
from .backbones.by_name import open_backbone as open_backbone
from .basis import fit_basis as fit_basis
from .basis import project as project
from .description import describe as describe
from .feature_files import load as load
from .feature_files import save as save
from .frames import CONTEXTS as CONTEXTS
from .frames import FeatureSet as FeatureSet
from .frames import make_feature_set as make_feature_set
from .images.by_path import open_source as open_source
from .images.extraction import extract as extract
from .splits import Split as Split
from .splits import split_indices as split_indices

__all__ = [
    "CONTEXTS",
    "FeatureSet",
    "Split",
    "backbones",
    "describe",
    "extract",
    "fit_basis",
    "images",
    "load",
    "make_feature_set",
    "open_backbone",
    "open_source",
    "project",
    "save",
    "split_indices",
]

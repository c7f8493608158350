from .catalog import card_names as card_names
from .catalog import card_paths as card_paths
from .catalog import load_card as load_card
from .job import PRESETS as PRESETS
from .job import CardInterrupted as CardInterrupted
from .job import Job as Job
from .loading import load_features as load_features
from .loading import load_pair as load_pair

__all__ = [
    "PRESETS",
    "CardInterrupted",
    "Job",
    "card_names",
    "card_paths",
    "load_card",
    "load_features",
    "load_pair",
]

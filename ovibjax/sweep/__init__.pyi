from .cluster import on_ray as on_ray
from .engine import Interrupted as Interrupted
from .engine import run as run
from .grid import Axis as Axis
from .merging import merge as merge
from .reading import open as open
from .select import best as best
from .select import take as take
from .select import tree_of as tree_of
from .store import config_of as config_of
from .store import open_dataset as open_dataset
from .work import Along as Along

__all__ = [
    "Along",
    "Axis",
    "Interrupted",
    "best",
    "config_of",
    "merge",
    "on_ray",
    "open",
    "open_dataset",
    "run",
    "take",
    "tree_of",
]

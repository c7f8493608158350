from .cluster import on_ray as on_ray
from .engine import Interrupted as Interrupted
from .engine import run as run
from .grid import Axis as Axis
from .halving import halve as halve
from .merging import merge as merge
from .reading import open as open
from .sampling import Range as Range
from .sampling import random_points as random_points
from .sampling import sobol as sobol
from .select import best as best
from .select import take as take
from .select import tree_of as tree_of
from .staged import Staged as Staged
from .store import config_of as config_of
from .store import open_dataset as open_dataset
from .work import Along as Along

__all__ = [
    "Along",
    "Axis",
    "Interrupted",
    "Range",
    "Staged",
    "best",
    "config_of",
    "halve",
    "merge",
    "on_ray",
    "open",
    "open_dataset",
    "random_points",
    "run",
    "sobol",
    "take",
    "tree_of",
]

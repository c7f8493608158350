"""Whole grids in compiled calls: describe a grid, run it, store it, resume it, spread it.

from ovibjax import sweep
dataset = sweep.run(fn, {"beta": [1e-4, 1e-3], "gamma": [0, 0.1], "seed": range(5)}, data, store="runs/mine.zarr")
"""

from ovibjax.sweep.engine import Interrupted, run
from ovibjax.sweep.grid import Axis
from ovibjax.sweep.select import best, take, tree_of
from ovibjax.sweep.store import open_dataset
from ovibjax.sweep.work import Along

__all__ = ["Along", "Axis", "Interrupted", "best", "open_dataset", "run", "take", "tree_of"]

"""Whole grids in compiled calls: describe a grid, run it, store it, resume it, spread it.

>>> from ovibjax import sweep
>>> def member(key, point, shared):  # computed at every point of the grid, in one program
...     return {"cost": (point["beta"] - shared) ** 2 + point["gamma"]}
>>> dataset = sweep.run(member, {"beta": [0.0, 1.0, 2.0], "gamma": [0.0, 0.5]}, 1.0)
>>> dataset.cost.sel(gamma=0.5).values.tolist()
[1.5, 0.5, 1.5]
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Worlds made up and rendered by this project, as data that needs no download: towns to drive through, and rooms.

Elsewhere in the project they are called the *embedded* town and rooms.

>>> from ovibjax import world
>>> config = world.TownConfig(seed=5)
>>> town = world.make_town(config)
>>> route = world.make_route(town, config, n_frames=10, seed=0)
>>> route.positions_m.shape
(10, 3)
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

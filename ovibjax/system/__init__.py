"""The whole chain as one program: encoder, retrieval, request control, edge scheduling, at every point of a grid.

`sweep_system` runs a grid from drives; `run` and `along` are the same as pure functions of one point.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

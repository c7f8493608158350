"""The edge server: where was this frame taken? Retrieval, regression, their mixture, and how a code is judged by it.

>>> import numpy as np
>>> from ovibjax import edge
>>> database = np.eye(3, dtype=np.float32)
>>> edge.retrieve(database[[2, 0]], database).tolist()
[2, 0]
>>> index = edge.build_index(database, positions=[[0, 0], [1, 0], [9, 0]], scene=[0, 0, 1], tile_m=5.0)
>>> edge.retrieve(database[[2, 0]], index, scenes=1).tolist()
[2, 0]
>>> edge.nearest(database[[2, 0]], edge.cluster_index(database), k=2).row[:, 0].tolist()
[2, 0]
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

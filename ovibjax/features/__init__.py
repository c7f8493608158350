"""Feature sets: a feature vector per view of every frame, with the frame's pose; read from files or made from images.

>>> import numpy as np
>>> from ovibjax import features
>>> views = np.random.default_rng(0).normal(size=(100, 5, 8))  # frames, views, dimension
>>> data = features.make_feature_set(views, positions_m=np.zeros((100, 3)))
>>> [len(part) for part in features.split_indices(100, seed=0)]
[70, 15, 15]
>>> basis = features.fit_basis(data.features, rank=3)
>>> features.project(basis, data.features).shape
(100, 5, 3)
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Prefixes as bytes: quantisers and integer tables per coordinate, and an exact arithmetic coder.

>>> import numpy as np
>>> from ovibjax.link import codes
>>> training = np.random.default_rng(0).normal(size=(1000, 8)).astype(np.float32)
>>> coder = codes.Coder("entropy", codes.fit_table("entropy", training))
>>> len(coder.encode(training[0])), coder.cut(coder.encode(training[0]), 8, 3) == coder.encode(training[0, :3])
(4, True)
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

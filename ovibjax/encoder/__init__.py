"""The O-VIB encoder: one learned code for all views of a frame, of which any prefix is a code too.

>>> import numpy as np
>>> from ovibjax import encoder
>>> encoder.prefix_mask(2, 4).tolist()
[1.0, 1.0, 0.0, 0.0]
>>> float(encoder.gaussian_kl(mu=np.array([2.0, 0.0]), logvar=np.zeros(2)))
2.0

`fit` trains one; `member_data` gives it the data of a seed; `encode`, `decode` and `locate` are its three parts.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

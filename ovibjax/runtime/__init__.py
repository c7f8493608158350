"""How programs run on this machine: caches, threads, progress, precision of products, cuts between loops."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

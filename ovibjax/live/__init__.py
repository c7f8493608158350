"""The whole chain as processes with real sockets and clocks: an edge server, robots that ask it, what both wrote down.

>>> from ovibjax import live
>>> answer = live.Answer("ok", client=3, sequence=7, residual_m=1.5, position_m=(10.0, -4.0, 20.0))
>>> live.unpack_answer(live.pack_answer(answer)) == answer
True
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""The wireless uplink: request packets, how long they take, the fading channel, measured throughput traces.

>>> from ovibjax import link
>>> packet = link.pack(link.Request("FS", [0.5, -1.0], voi_m=2.0, deadline_ms=100, client=1, sequence=7))
>>> len(packet), link.request_bytes(k=2, n_views=3)
(40, 40)
>>> float(link.transmit_s(len(packet), link.kbytes_per_s(4.0)))
0.009765625
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

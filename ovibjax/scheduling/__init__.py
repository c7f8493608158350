"""Whom the edge serves next: five rules, exact replay of the edge queue, the slotted optimizer and its theorem.

>>> import numpy as np
>>> from ovibjax import scheduling
>>> trace = scheduling.RequestTrace(
...     client=np.array([0, 1, 2]),
...     ready_ms=np.array([0.0, 1.0, 2.0]),
...     service_ms=np.array([10.0, 10.0, 10.0]),
...     service_est_ms=np.array([10.0, 10.0, 10.0]),
...     deadline_ms=np.array([100.0, 90.0, 50.0]),
...     voi_m=np.array([1.0, 1.0, 4.0]),
...     drift_m_per_s=np.zeros(3),
...     risk_m=np.zeros(3),
...     delay_est_ms=np.zeros(3),
...     urgency=np.ones(3),
...     valid=np.ones(3, bool),
... )
>>> scheduling.replay(trace, "fifo", scheduling.default_params()).start_ms.tolist()
[0.0, 10.0, 20.0]
>>> scheduling.replay(trace, "edf", scheduling.default_params()).start_ms.tolist()
[0.0, 20.0, 10.0]
>>> served = scheduling.solve(  # eq. "voi_scheduler": two of three requests fit 240 bytes
...     backlog=[1, 1, 3], voi=[2.0, 1.0, 0.5], payload=[96, 96, 104], service=[16, 16, 17], V=8.0,
...     payload_budget=240, service_budget=40,
... )
>>> served.tolist()
[1, 1, 0]
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

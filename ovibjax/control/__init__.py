"""When and how a client asks the edge: its belief, the value of information, request policies, replay of a route.

>>> import jax, jax.numpy as jnp
>>> from ovibjax import control
>>> prices = control.Prices(bandwidth_m_per_s=117.0, energy_m_per_j=0.0, delay_m_per_s=29.0)
>>> voi_m = control.net_voi(9.0, 3.0, payload_bytes=96, rate_bps=65536.0, delay_s=0.05, energy_j=0.0, prices=prices)
>>> round(float(voi_m), 2)  # of 6 m less risk, what 96 bytes at 64 Kbit/s and 50 ms of delay leave
3.18
>>> slots, actions = 60, len(control.ACTIONS)
>>> route = control.Route(
...     context=jnp.zeros(slots, jnp.int32),
...     yaw_rad=jnp.zeros(slots),
...     predicted_m=jnp.full((slots, actions), 2.0),
...     residual_m=jnp.ones((slots, actions, 2)),
...     risk_m=jnp.full((slots, actions), 1.5),
... )
>>> params = control.ControlParams(control.make_environment(), control.make_controller(control.ACTIONS))
>>> result = control.replay(jax.random.key(0), route, "periodic", params)
>>> int(control.summarize(result).requests)
2
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""ovibjax: task-oriented communications for edge-assisted multi-view localization, in pure-functional JAX.

`import ovibjax as ob`, and every room is an attribute: `ob.sweep.run`, `ob.encoder.fit`, `ob.edge.retrieve`,
`ob.control.replay`, `ob.scheduling.replay`, `ob.system.run`. Names are loaded when first touched (jax with them);
`__init__.pyi` beside this file lists them.
"""

import lazy_loader

__version__ = "0.2.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

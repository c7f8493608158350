"""ovibjax: task-oriented communications for edge-assisted multi-view localization, in pure-functional JAX."""

__version__ = "0.1.0"

"""Shape and dtype slips raise; warnings are errors (see pyproject)."""

import os

# One CPU device, stated before jax starts.
os.environ.setdefault("XLA_FLAGS", "--xla_force_host_platform_device_count=1")

import jax

jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

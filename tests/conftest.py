"""Shape and dtype slips raise; warnings are errors (see pyproject)."""

import os
import shutil
import tempfile

# One CPU device, stated before jax starts.
os.environ.setdefault(
    "XLA_FLAGS",
    "--xla_force_host_platform_device_count=1 --xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false",
)

# Programs compiled by one test process or command serve the others; workers inherit the folder of the first.
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    _compiled = tempfile.mkdtemp(prefix="ovibjax-compiled-")
    os.environ["JAX_COMPILATION_CACHE_DIR"] = _compiled
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.5"
else:
    _compiled = ""

import jax
from hypothesis import settings

# The same examples at every run; `pytest --hypothesis-profile explore` looks for new ones.
settings.register_profile("fixed", derandomize=True)
settings.register_profile("explore", derandomize=False)
settings.load_profile("fixed")

jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")


def pytest_unconfigure() -> None:
    """Remove what the first process made."""
    if _compiled:
        shutil.rmtree(_compiled, ignore_errors=True)

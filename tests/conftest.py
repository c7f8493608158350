"""Shape and dtype slips raise; warnings are errors (see pyproject)."""

import os
import shutil
import tempfile
from importlib.metadata import version

# One CPU device with one thread, as `ovibjax sweep` has it, stated before jax starts. The programs are many and small:
# most of the time would go to optimizing machine code.
os.environ.setdefault("NPROC", "1")
_flags = ["--xla_force_host_platform_device_count=1", "--xla_backend_optimization_level=0"]
# A flag that XLA does not know ends the process.
if tuple(int(part) for part in version("jaxlib").split(".")[:2]) < (0, 11):
    _flags.append("--xla_cpu_use_fusion_emitters=false")
os.environ.setdefault("XLA_FLAGS", " ".join(_flags))

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

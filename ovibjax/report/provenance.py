"""Where a result comes from: version, commit, packages, machine and what its processor can."""

import platform
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Any

import jax

import ovibjax
from ovibjax.runtime.hardware import accelerator, instructions, processor_name


def _commit() -> str:
    """Commit of the checkout the package runs from, marked if it has changes; "unknown" for a plain install."""
    root = Path(ovibjax.__file__).parent.parent
    if not (root / ".git").exists():
        return "unknown"
    try:
        run = {"cwd": root, "capture_output": True, "text": True, "timeout": 10, "check": True}
        commit = subprocess.run(["git", "rev-parse", "--short=12", "HEAD"], **run).stdout.strip()  # type: ignore[call-overload]
        # What a run writes, and the tests, are no change of the code that made the results.
        changed = subprocess.run(["git", "status", "--porcelain", "--", "ovibjax", "sweeps"], **run).stdout.strip()  # type: ignore[call-overload]
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return commit + ("-dirty" if changed else "")


def provenance(**facts: Any) -> dict[str, Any]:
    """Facts about a run, to be written beside its results.

    Args:
        **facts: what the run adds (preset, seeds, seconds, ...).

    Returns:
        A JSON-ready dictionary.
    """
    return {
        "version": ovibjax.__version__,
        "commit": _commit(),
        "jax": jax.__version__,
        "python": platform.python_version(),
        "packages": {name: metadata.version(name) for name in ("jaxlib", "flax", "optax", "numpy", "scipy")},
        "machine": ", ".join(filter(None, (processor_name(), accelerator()))),
        "instructions": instructions(),
        **facts,
    }

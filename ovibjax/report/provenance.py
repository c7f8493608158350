"""Where a result comes from: version, commit, seeds, preset, machine."""

import os
import platform
import subprocess
from pathlib import Path
from typing import Any

import jax

import ovibjax


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


def _machine() -> str:
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [
            line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")
        ]
        cpu = names[0] if names else cpu
    device = jax.devices()[0]
    accelerator = "" if device.platform == "cpu" else f", {device.device_kind}"
    return f"{os.cpu_count()} x {cpu}{accelerator}"


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
        "machine": _machine(),
        **facts,
    }

"""What machine this is: processor, the instructions of it that matter here, accelerator."""

import os
import platform
from pathlib import Path

INSTRUCTIONS = ("avx2", "avx512f", "avx512_bf16", "amx_bf16", "asimd", "bf16", "sve")
"""Vector instructions on which speed, precision and the last bits of a result depend."""


def processor_name() -> str:
    """Number of cores and model, such as "2 x AMD EPYC"."""
    model = _facts().get("model name") or platform.processor() or platform.machine()
    return f"{os.cpu_count()} x {model}"


def instructions() -> str:
    """The known instructions that this processor has, separated by blanks; empty where the system does not tell."""
    facts = _facts()
    flags = facts.get("flags", facts.get("Features", "")).split()
    return " ".join(name for name in INSTRUCTIONS if name in flags)


def accelerator() -> str:
    """The kind of the first device of jax where that is no processor; empty otherwise."""
    import jax

    device = jax.devices()[0]
    return "" if device.platform == "cpu" else str(device.device_kind)


def _facts() -> dict[str, str]:
    """What Linux says of its first processor; nothing elsewhere."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return {}
    # The last of equal names stands; processors of one machine agree in what is asked here.
    return {name.strip(): value.strip() for name, _, value in (line.partition(":") for line in lines)}

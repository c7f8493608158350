"""What must be settled before jax starts: into how many devices the processor is split, and threads per program."""

import json
import os
import sys
from contextlib import suppress
from pathlib import Path

from ovibjax.errors import InputError
from ovibjax.runtime.limits import MOST_PROGRAMS


def settle(out: Path, threads: int | None, devices: int | None = None) -> None:
    """Set the number of threads and devices; without effect on a process in which jax runs already.

    Bits depend on the number of threads, so that a store keeps the one that it was begun with, whatever machine goes on
    with it. XLA runs no more programs side by side than it has threads, and splits sums among all of them. The default
    is therefore a thread for each program that may run at a time on any machine: on two cores, eight cost the encoder's
    sweep 5 % of what two take, and one leaves a core idle.

    Args:
        out: the store.
        threads: what the user asks for.
        devices: likewise; one if None.

    Raises:
        InputError: a number that is not positive.
    """
    for name, value in (("threads", threads), ("devices", devices)):
        if value is not None and value < 1:
            raise InputError(f"--{name} {value} is not positive")
    if "jax" in sys.modules:
        return
    os.environ["NPROC"] = str(threads or _begun_with(out) or os.environ.get("NPROC") or MOST_PROGRAMS)
    if devices is not None:
        flags = os.environ.get("XLA_FLAGS", "")
        os.environ["XLA_FLAGS"] = f"{flags} --xla_force_host_platform_device_count={devices}".strip()


def one_thread() -> None:
    """Keep programs to one thread, as many small ones side by side want it; without effect once jax runs."""
    if "jax" not in sys.modules:
        os.environ.setdefault("NPROC", "1")


def _begun_with(out: Path) -> int | None:
    """Threads of a store's programs, read without what would start jax; whatever is wrong with it is said later."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        return int(json.loads((out / "sweep.json").read_text(encoding="utf-8"))["config"]["environment"]["threads"])
    return None

"""What a member's bits depend on: what a store says of itself, and compares before it takes another member."""

import os
from dataclasses import asdict
from functools import partial
from typing import Any

import jax

from ovibjax.runtime.hardware import instructions
from ovibjax.sweep.program import MemberFn
from ovibjax.sweep.staged import Staged
from ovibjax.sweep.work import Along, Work

_HARMLESS = ("--xla_force_host_platform_device_count", "--xla_dump", "--xla_cpu_parallel_codegen_split_count")
"""Flags on which no bit depends (devices share a batch, not a member)."""


def identity(work: Work, settings: dict[str, Any]) -> dict[str, Any]:
    """What a member's bits depend on beside its point and the data that differ along an axis, as JSON."""
    return {
        "settings": settings,
        "function": _name_of(work.fn),
        "program": work.text_hash,
        "data": work.shared.axis if isinstance(work.shared, Along) else work.digests[0].hex(),
        "execution": asdict(work.batch),
        "environment": environment(work.threads),
    }


def _name_of(fn: MemberFn) -> str:
    """What stores call a function."""
    if isinstance(fn, Staged):
        return fn.named
    fn = fn.func if isinstance(fn, partial) else fn
    named = fn if hasattr(fn, "__qualname__") else type(fn)
    return f"{named.__module__}.{named.__qualname__}"


def environment(threads: int) -> dict[str, Any]:
    """The part of a configuration that is not of the sweep; accelerators do not care for a CPU's threads and kind."""
    platform = jax.default_backend()
    found: dict[str, Any] = {"jax": jax.__version__, "platform": platform}
    if platform == "cpu":
        found |= {"threads": threads, "instructions": instructions()}
    flags = [flag for flag in os.environ.get("XLA_FLAGS", "").split() if not flag.startswith(_HARMLESS)]
    return found | ({"xla_flags": sorted(flags)} if flags else {})

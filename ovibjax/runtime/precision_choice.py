"""Which operands of products are faster on this machine: measured once, then kept in the cache folder.

What a processor's flags promise is not what a training step gets: some convert to bfloat16 and multiply no faster,
some without matrix units gain a little. A third of a second says it.
"""

import hashlib
import json
import os
import secrets
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp

from ovibjax.errors import InputError
from ovibjax.runtime.cache import cache_folder, made_folder, processor
from ovibjax.runtime.precision import PRECISIONS, dot_general

WORTH_IT = 1.2
"""How many times faster bfloat16 must be: for less, the rounding is not worth it."""

_ROWS, _INNER, _COLUMNS = 256, 320, 512  # the first layer of a training step: batch, views x coordinates, width
_TRIES = 12


def faster_precision() -> str:
    """The operands to train with where the user leaves it to the machine; measured at the first call on it.

    Returns:
        One of `PRECISIONS`: "float32", unless "bfloat16" is faster by a factor of `WORTH_IT`.
    """
    device = jax.devices()[0].device_kind
    # A new jax may bring other kernels, and flags may split the processor.
    facts = f"{processor()} {device} {jax.__version__} {os.environ.get('XLA_FLAGS', '')}"
    name = hashlib.sha256(facts.encode()).hexdigest()[:12]
    return _kept_or_measured(cache_folder() / "precision" / f"{name}.json")


def chosen(seconds: dict[str, float]) -> str:
    """The operands that times speak for.

    Args:
        seconds: time of one step per name of `PRECISIONS`.

    Returns:
        One of `PRECISIONS`.
    """
    return "bfloat16" if seconds["float32"] >= WORTH_IT * seconds["bfloat16"] else "float32"


@cache
def _kept_or_measured(path: Path) -> str:
    """The choice that a file holds; where none can be read, it is made, and written if the folder allows."""
    with suppress(OSError, ValueError, TypeError, KeyError):
        kept = json.loads(path.read_text())["precision"]
        if kept in PRECISIONS:
            return str(kept)
    seconds = measure()
    found = {"precision": chosen(seconds), "seconds": seconds}
    with suppress(OSError, InputError):
        part = made_folder(path.parent) / f".{secrets.token_hex(8)}.part"
        part.write_text(json.dumps(found) + "\n")
        part.replace(path)
    return chosen(seconds)


def measure() -> dict[str, float]:
    """Time of a layer's product and both its gradients.

    Returns:
        Seconds, the best of several tries, per name of `PRECISIONS`.
    """
    x, kernel = jnp.ones((_ROWS, _INNER)), jnp.ones((_INNER, _COLUMNS))
    steps = {name: _step(name) for name in PRECISIONS}
    seconds = {name: float("inf") for name in PRECISIONS}
    for _ in range(1 + _TRIES):  # in turns, so that what else the machine does meets both
        for name, step in steps.items():
            started = time.perf_counter()
            jax.block_until_ready(step(x, kernel))
            seconds[name] = min(seconds[name], time.perf_counter() - started)
    return seconds


def _step(precision: str) -> Callable[[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]:
    product = dot_general(precision)

    def squared(x: jax.Array, kernel: jax.Array) -> jax.Array:
        return jnp.sum(jnp.square(product(x, kernel, (((1,), (0,)), ((), ())))))

    return jax.jit(jax.grad(squared, argnums=(0, 1)))

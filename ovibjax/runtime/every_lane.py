"""What holds for every lane of a mapped program.

Under `jax.vmap` a branch is computed on both sides and selected from. A condition on all lanes together is one number,
and a branch on it a real one.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap


@custom_vmap
def every_lane(condition: jax.Array) -> jax.Array:
    """Whether a condition holds, for all lanes however the caller is mapped.

    Args:
        condition: [...] bool of one lane.

    Returns:
        Scalar bool, the same for all lanes and not mapped.
    """
    return jnp.all(condition)


@every_lane.def_vmap
def _(size: int, batched: Sequence[bool], condition: jax.Array) -> tuple[jax.Array, bool]:
    return every_lane(condition), False

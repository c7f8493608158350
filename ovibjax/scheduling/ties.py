"""Which of several requests is served where a rule gives them equal priority; the paper does not say.

MaxWeight ties often: without a second request of one client every backlog is one, so that it ranks nothing. Base-DPP,
EDF and VOI-Lyapunov tie where values, deadlines or scores are exactly equal.
"""

import jax
import jax.numpy as jnp
import numpy as np

TIES = ("arrival", "client", "last")
"""Who is served among requests of exactly equal priority: the earliest arrival, the lowest client number (of it the
earliest arrival), the latest arrival. Equal arrival times go by their order in the trace."""

_CLIENT, _LAST = TIES.index("client"), TIES.index("last")
_MOST = np.int32(2**31 - 1)


def tie_order(client: jax.Array, arrival: jax.Array | int, ties: jax.Array) -> jax.Array:
    """What decides among requests of equal priority: the least of it is served, and of equals the earliest arrival.

    Args:
        client: [...] int32 client number.
        arrival: [...] int32 place in the order of arrival.
        ties: [...] int32 index into `TIES`.

    Returns:
        [...] int32.
    """
    return jnp.where(ties == _CLIENT, client, jnp.where(ties == _LAST, -arrival, 0))


def served_first(priority: jax.Array, client: jax.Array, arrival: jax.Array, ties: jax.Array) -> jax.Array:
    """The request to serve: the one of largest priority, among equals as `TIES` says.

    Args:
        priority: [W] float32, -inf where a request may not be served.
        client: [W] int32 client number.
        arrival: [W] int32 place in the order of arrival, no two the same.
        ties: int32 scalar, index into `TIES`.

    Returns:
        int32 scalar, its index in [0, W).
    """
    # A priority that is not a number counts as largest: what is chosen must be a request that waits.
    best = (priority == jnp.max(priority)) | jnp.isnan(priority)
    order = tie_order(client, arrival, ties)
    first = best & (order == jnp.min(jnp.where(best, order, _MOST)))
    return jnp.argmin(jnp.where(first, arrival, _MOST)).astype(jnp.int32)

"""Leave-one-out retrieval: what the edge would answer for a frame if that frame were not in its database."""

import jax
import jax.numpy as jnp

from ovibjax.edge.retrieval import normalize

_BLOCK = 512


def leave_one_out(query: jax.Array, reference: jax.Array, own: jax.Array) -> jax.Array:
    """Most similar reference of each query by cosine similarity, its own excluded.

    Args:
        query: [Q, d] descriptors.
        reference: [N, d] descriptors of the database, at least two.
        own: [Q] int32 row of the query itself in the database, or -1 where it is not in it.

    Returns:
        [Q] int32 rows of `reference`; equal similarities go to the lower row. Memory is bounded by blocks.
    """
    rows = jnp.arange(reference.shape[0], dtype=jnp.int32)
    unit = normalize(reference)

    def one(item: tuple[jax.Array, jax.Array]) -> jax.Array:
        descriptor, self_row = item
        return jnp.argmax(jnp.where(rows == self_row, -jnp.inf, unit @ descriptor)).astype(jnp.int32)

    return jax.lax.map(one, (query, own), batch_size=_BLOCK)

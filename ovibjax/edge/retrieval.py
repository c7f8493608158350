"""Nearest-neighbour retrieval by cosine similarity against the geo-tagged database (paper, "System Architecture")."""

import jax
import jax.numpy as jnp

_BLOCK = 8192


def normalize(rows: jax.Array) -> jax.Array:
    """Rows [..., d] scaled to unit norm; a zero row stays zero."""
    norm = jnp.sqrt(jnp.sum(rows**2, axis=-1, keepdims=True))
    return rows / jnp.where(norm > 0, norm, 1.0)


def brute_force(query: jax.Array, db: jax.Array) -> jax.Array:
    """Index of the most similar database row of each query.

    Equal similarities go to the lower index; rows that are duplicates of each other may differ by rounding.

    Args:
        query: [Q, d] descriptors; their scale does not matter.
        db: [N, d] reference descriptors; squared norms must stay in float32's range.

    Returns:
        [Q] int32 rows of `db`. Memory is bounded by blocks of queries.
    """
    reference = normalize(db)
    if query.shape[0] <= _BLOCK:
        return jnp.argmax(query @ reference.T, axis=1).astype(jnp.int32)
    return jax.lax.map(lambda q: jnp.argmax(reference @ q), query, batch_size=_BLOCK).astype(jnp.int32)

"""How near to orthonormal the rows of the posterior-mean projection W are: the loss term and what it guarantees.

Latent coordinates then carry different things, and none of them collapses (paper, Section "Orthogonality Under the IB
Objective").
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp


@jax.custom_vjp
def orthogonality_penalty(W: jax.Array) -> jax.Array:
    """How far the rows of W are from orthonormal: K^-2 ||W W^T - I||_F^2.

    Args:
        W: [K, d_h] posterior-mean projection.

    Returns:
        Scalar (paper, last term of eq. "composite_loss").
    """
    return _orthogonality_forward(W)[0]


def _orthogonality_forward(W: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
    size = W.shape[0]
    deviation = W @ W.T - jnp.eye(size, dtype=W.dtype)
    return jnp.sum(deviation**2) / size**2, (W, deviation)


def _orthogonality_backward(saved: tuple[jax.Array, jax.Array], gradient: jax.Array) -> tuple[jax.Array]:
    # One product instead of the two of automatic differentiation, as the deviation is symmetric; written so that
    # for a transposed kernel the transposes cancel.
    W, deviation = saved
    return ((4.0 / W.shape[0] ** 2) * gradient * (W.T @ deviation).T,)


orthogonality_penalty.defvjp(_orthogonality_forward, _orthogonality_backward)


class SingularValues(NamedTuple):
    """Proposition 1 for one matrix: lower <= values <= upper (paper, proposition "vib_orthogonal").

    Attributes:
        values: [K] singular values, descending; where K > d_h the last K - d_h are zero.
        epsilon: spectral norm of W W^T - I, the smallest epsilon of the proposition, which asks for epsilon < 1.
        lower: sqrt(1 - epsilon); zero where epsilon >= 1, which excludes nothing: the rank may have collapsed.
        upper: sqrt(1 + epsilon); holds for every epsilon.
    """

    values: jax.Array
    epsilon: jax.Array
    lower: jax.Array
    upper: jax.Array


def singular_values(W: jax.Array) -> SingularValues:
    """Singular values of the posterior-mean projection and the interval Proposition 1 puts them in.

    Args:
        W: [K, d_h] matrix.

    Returns:
        Values and bounds; the proposition applies where epsilon < 1.
    """
    size = W.shape[0]
    with jax.default_matmul_precision("float32"):
        values = jnp.linalg.svd(W, compute_uv=False)
        deviation = jnp.linalg.eigvalsh(W @ W.T - jnp.eye(size, dtype=W.dtype))
    epsilon = jnp.max(jnp.abs(deviation))
    return SingularValues(
        values=jnp.pad(values, (0, size - values.shape[0])),
        epsilon=epsilon,
        lower=jnp.sqrt(jnp.maximum(1.0 - epsilon, 0.0)),
        upper=jnp.sqrt(1.0 + epsilon),
    )

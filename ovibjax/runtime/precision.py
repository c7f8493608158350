"""Matrix products in float32, or faster in bfloat16.

With bfloat16 operands and float32 accumulation, processors with matrix units (AMX, tensor cores) multiply three to
six times faster; parameters, activations, losses and the optimizer stay in float32.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

PRECISIONS = ("float32", "bfloat16")
"""Types of the operands of a product."""

_BLOCK = 16
_ROWS_BY_COLUMNS = (((1,), (0,)), ((), ()))


def dot_general(precision: str) -> Any:
    """A replacement for `lax.dot_general` in dense layers.

    Args:
        precision: one of `PRECISIONS`.

    Returns:
        A function with the arguments of `lax.dot_general`, for inputs [B, n] and kernels [n, m].

    Raises:
        ValueError: unknown precision.
    """
    if precision not in PRECISIONS:
        raise ValueError(f"precision is one of {', '.join(PRECISIONS)}, not {precision!r}")
    if precision == "float32":
        return lax.dot_general

    def product(x: jax.Array, kernel: jax.Array, dimensions: Any, **_: Any) -> jax.Array:
        assert dimensions == _ROWS_BY_COLUMNS
        return _bfloat16_product(x, kernel)

    return product


@jax.custom_vjp
def _bfloat16_product(x: jax.Array, kernel: jax.Array) -> jax.Array:
    return _forward(x, kernel)[0]


def _forward(x: jax.Array, kernel: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
    operands = x.astype(jnp.bfloat16), kernel.astype(jnp.bfloat16)
    return lax.dot(*operands, preferred_element_type=jnp.float32), operands


def _backward(operands: tuple[jax.Array, jax.Array], gradient: jax.Array) -> tuple[jax.Array, jax.Array]:
    x, kernel = operands
    g = gradient.astype(jnp.bfloat16)
    dx = lax.dot_general(g, kernel, (((1,), (1,)), ((), ())), preferred_element_type=jnp.float32)
    return dx, lax.dot(_transpose(x), g, preferred_element_type=jnp.float32)


_bfloat16_product.defvjp(_forward, _backward)


def _transpose(x: jax.Array) -> jax.Array:
    """The transpose, block by block.

    XLA folds a plain transpose into the product, and on a CPU a product over the first dimension of both operands
    leaves the fast bfloat16 kernels (three times slower; under `vmap` sometimes unsupported). Two block swaps are not
    recognised and stay outside.
    """
    rows, columns = x.shape
    padded = jnp.pad(x, ((0, -rows % _BLOCK), (0, -columns % _BLOCK)))
    blocks = padded.reshape(padded.shape[0] // _BLOCK, _BLOCK, padded.shape[1] // _BLOCK, _BLOCK)
    return jnp.swapaxes(jnp.swapaxes(blocks, 0, 2), 1, 3).reshape(padded.shape[::-1])[:columns, :rows]

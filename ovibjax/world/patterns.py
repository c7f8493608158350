"""Patterns that materials are painted with: smooth noise, stripes, and a random number for each cell of a lattice."""

import jax
import jax.numpy as jnp

Colour = list[jax.Array]
"""Red, green and blue, or x, y and z: one array of all pixels each."""


def lattice_value(x: jax.Array, y: jax.Array, salt: jax.Array | int) -> jax.Array:
    """Uniform [0, 1) of integer lattice points; another salt gives other numbers."""
    h = x.astype(jnp.uint32) * jnp.uint32(0x9E3779B1) ^ y.astype(jnp.uint32) * jnp.uint32(0x85EBCA77)
    h = (h ^ jnp.asarray(salt).astype(jnp.uint32) * jnp.uint32(0xC2B2AE3D)) * jnp.uint32(0x27D4EB2F)
    h = (h ^ (h >> 15)) * jnp.uint32(0x2C1B3C6D)
    return (h >> 8).astype(jnp.float32) * jnp.float32(2.0**-24)


def lattice_cell(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The cell of the unit lattice that a coordinate lies in, and where in it, [0, 1)."""
    whole = jnp.floor(x)
    return whole.astype(jnp.int32), x - whole


def noise(x: jax.Array, y: jax.Array, salt: int) -> jax.Array:
    """Smooth value noise in [0, 1] with unit lattice."""
    ix, fx = lattice_cell(x)
    iy, fy = lattice_cell(y)
    fx, fy = fx * fx * (3 - 2 * fx), fy * fy * (3 - 2 * fy)
    low = lattice_value(ix, iy, salt) * (1 - fx) + lattice_value(ix + 1, iy, salt) * fx
    high = lattice_value(ix, iy + 1, salt) * (1 - fx) + lattice_value(ix + 1, iy + 1, salt) * fx
    return low * (1 - fy) + high * fy


def stripes(x: jax.Array, period: jax.Array | float, share: jax.Array | float, width: jax.Array) -> jax.Array:
    """Share of a pixel of the given width covered by stripes centred in each period (box-filtered pulse train)."""
    at, half = x / period, jnp.maximum(width / period, 1e-3) / 2

    def integral(u: jax.Array) -> jax.Array:
        whole = jnp.floor(u)
        return whole * share + jnp.clip(u - whole - (1 - share) / 2, 0.0, share)

    return (integral(at + half) - integral(at - half)) / (2 * half)

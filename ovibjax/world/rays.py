"""Rays for the renderers of towns and rooms: where the cameras look, a ray per pixel, where a ray enters a box."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp

VIEW_YAW_DEG = (0.0, 180.0, 90.0, -90.0, 0.0)
"""Heading of each camera relative to the platform, counter-clockwise, in the order of `views.VIEWS`."""

Vector = Sequence[jax.Array]
"""x, y and z, one array each: long vectors of one coordinate suit a CPU's vector units."""


def pinhole_rays(forward: Vector, right: Vector, up: Vector, height_px: int, width_px: int) -> list[jax.Array]:
    """Rays of unit depth through the pixels of pinhole cameras that see 90 degrees from side to side.

    Args:
        forward: x, y, z of each camera's optical axis, [V] each.
        right: of the axis to the right of the image.
        up: of the axis to the top of the image.
        height_px: image rows.
        width_px: image columns.

    Returns:
        x, y and z, each [V, H*W], rows from the top; a ray's length is its slant, its depth is one.
    """
    u = (jnp.arange(width_px, dtype=jnp.float32) + 0.5) / width_px * 2 - 1
    v = (1 - (jnp.arange(height_px, dtype=jnp.float32) + 0.5) / height_px * 2) * (height_px / width_px)
    right_px, up_px = (grid.ravel() for grid in jnp.meshgrid(u, v))
    axes = zip(forward, right, up, strict=True)
    return [f[:, None] + r[:, None] * right_px[None] + w[:, None] * up_px[None] for f, r, w in axes]


def enter_box(
    low: Vector, high: Vector, origin: Vector, ray: Vector, nearest_m: float, missed_m: float
) -> tuple[jax.Array, jax.Array]:
    """Where rays enter an axis-parallel box from outside (the slab test).

    Args:
        low: x, y, z of the corner with the smallest coordinates; arrays that broadcast against `ray`.
        high: of the opposite corner.
        origin: of the rays' starts.
        ray: of the rays, of any length.
        nearest_m: hits before this many lengths do not count.
        missed_m: what stands for no hit.

    Returns:
        Distance in lengths of the ray, and the axis (0, 1, 2) of the side it enters by.
    """
    near, far = jnp.full_like(ray[0], -missed_m), jnp.full_like(ray[0], missed_m)
    axis = jnp.zeros_like(ray[0], dtype=jnp.int32)
    for a in range(3):
        inverse = 1.0 / jnp.where(jnp.abs(ray[a]) < 1e-7, 1e-7, ray[a])
        one, other = (low[a] - origin[a]) * inverse, (high[a] - origin[a]) * inverse
        enter = jnp.minimum(one, other)
        axis = jnp.where(enter > near, a, axis)
        near, far = jnp.maximum(near, enter), jnp.minimum(far, jnp.maximum(one, other))
    return jnp.where((near < far) & (near > nearest_m), near, missed_m), axis

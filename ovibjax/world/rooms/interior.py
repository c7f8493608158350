"""A ray-caster for rooms: colour and depth of any camera pose between four walls, a floor and a ceiling.

Rooms are small and drives short, so every ray meets every box in one scan. Images are rendered with two by two rays a
pixel, as indoor textures are finer than a pixel of the backbone's input.
"""

from functools import partial

import jax
import jax.numpy as jnp

from ovibjax.world.patterns import Colour
from ovibjax.world.rays import Vector, enter_box, pinhole_rays
from ovibjax.world.rooms.furniture import KINDS, lamp_x_m
from ovibjax.world.rooms.room import FACES, Room
from ovibjax.world.rooms.shading import Surface, shade_box, shade_shell, wall_coordinates

_RAYS = 2  # per pixel and axis
_AMBIENT = 0.42
_LAMP = 1.15
_TAPE_M = 0.04


def camera_rays(yaw_rad: jax.Array, pitch_rad: jax.Array, height_px: int, width_px: int) -> list[jax.Array]:
    """Rays of unit depth through a pinhole camera of 90 degrees.

    Args:
        yaw_rad: [V] heading of each view.
        pitch_rad: [V] elevation of each view, -pi/2 looks straight down.
        height_px: image rows.
        width_px: image columns.

    Returns:
        x, y and z, each [V, H*W], rows from the top.
    """
    cy, sy, cp, sp = jnp.cos(yaw_rad), jnp.sin(yaw_rad), jnp.cos(pitch_rad), jnp.sin(pitch_rad)
    forward = (cp * cy, cp * sy, sp)
    right = (sy, -cy, jnp.zeros_like(cy))
    up = (-sp * cy, -sp * sy, cp)
    return pinhole_rays(forward, right, up, height_px, width_px)


def render_interior(
    room: Room, origin_m: jax.Array, yaw_rad: jax.Array, pitch_rad: jax.Array, height_px: int, width_px: int
) -> tuple[jax.Array, jax.Array]:
    """Render views of a room.

    The stages are compiled one by one, as in the town's `render`: one program would compute each of them again inside
    every consumer of its result.

    Args:
        room: the room's arrays.
        origin_m: [V, 3] camera positions, inside the room and outside its furniture.
        yaw_rad: [V] heading of each view.
        pitch_rad: [V] elevation of each view.
        height_px: image rows.
        width_px: image columns.

    Returns:
        [V, H, W, 3] float32 colour in [0, 1], and [V, H, W] depth along the optical axis in metres.
    """
    arrays = jax.tree.map(jnp.asarray, room)
    origin, ray = _rays(jnp.asarray(origin_m), jnp.asarray(yaw_rad), jnp.asarray(pitch_rad), height_px, width_px)
    surface = _surface(*_shell(arrays, origin, ray), *_nearest_box(arrays, origin, ray), origin, ray)
    footprint = surface.depth_m * (2.0 / (width_px * _RAYS))
    shell = shade_shell(arrays, surface, _decor_slot(arrays, surface), footprint)
    box_rgb = shade_box(arrays, surface, footprint)
    return _compose(surface, shell, box_rgb, _light(arrays, surface), height_px, width_px)


@partial(jax.jit, static_argnames=("height_px", "width_px"))
def _rays(
    origin_m: jax.Array, yaw_rad: jax.Array, pitch_rad: jax.Array, height_px: int, width_px: int
) -> tuple[Vector, Vector]:
    ray = camera_rays(yaw_rad, pitch_rad, height_px * _RAYS, width_px * _RAYS)
    return [jnp.broadcast_to(origin_m[:, a, None], ray[a].shape) for a in range(3)], ray


@jax.jit
def _surface(
    shell_m: jax.Array,
    face: jax.Array,
    box_m: jax.Array,
    slot: jax.Array,
    axis: jax.Array,
    origin: Vector,
    ray: Vector,
) -> Surface:
    in_box = box_m < shell_m
    depth_m = jnp.minimum(box_m, shell_m)
    normal = jnp.where(in_box, axis, jnp.where(face < 4, face // 2, 2))
    hit = [o + depth_m * r for o, r in zip(origin, ray, strict=True)]
    outward = [jnp.where(normal == a, -jnp.sign(ray[a]), 0.0) for a in range(3)]
    return Surface(depth_m, in_box, face, slot, axis, hit, outward)


@partial(jax.jit, static_argnames=("height_px", "width_px"))
def _compose(
    surface: Surface,
    shell: tuple[Colour, jax.Array],
    box_rgb: Colour,
    light: jax.Array,
    height_px: int,
    width_px: int,
) -> tuple[jax.Array, jax.Array]:
    """Light the winner of each ray and average the rays of a pixel."""
    shell_rgb, shines = shell
    glow = jnp.where(surface.in_box, 0.0, shines)
    rgb = []
    for c, tint in enumerate((1.02, 1.0, 0.95)):
        colour = jnp.where(surface.in_box, box_rgb[c], shell_rgb[c])
        rgb.append(jnp.clip(colour * (light * tint + glow * (1 - light * tint)), 0.0, 1.0))
    picture = jnp.stack(rgb, -1).reshape(-1, height_px, _RAYS, width_px, _RAYS, 3).mean(axis=(2, 4))
    depth = surface.depth_m.reshape(-1, height_px, _RAYS, width_px, _RAYS).mean(axis=(2, 4))
    # Gamma 1/2.2 is close enough to a square root.
    return jnp.sqrt(picture), depth


@jax.jit
def _shell(room: Room, origin: Vector, ray: Vector) -> tuple[jax.Array, jax.Array]:
    """Distance to the face of the room that a ray leaves through, and its code."""
    size = room.size_m
    low, high = (-size[0] / 2, -size[1] / 2, 0.0), (size[0] / 2, size[1] / 2, size[2])
    best, face = jnp.full_like(ray[0], jnp.inf), jnp.zeros_like(ray[0], dtype=jnp.int32)
    for a in range(3):
        forward = ray[a] > 0
        slope = jnp.where(jnp.abs(ray[a]) < 1e-7, 1e-7, ray[a])
        distance = (jnp.where(forward, high[a], low[a]) - origin[a]) / slope
        distance = jnp.where(jnp.abs(ray[a]) < 1e-7, jnp.inf, distance)
        positive, negative = (FACES.index("ceiling"), FACES.index("floor")) if a == 2 else (2 * a, 2 * a + 1)
        face = jnp.where(distance < best, jnp.where(forward, positive, negative), face)
        best = jnp.minimum(best, distance)
    return best, face


def _enter(row: jax.Array, origin: Vector, ray: Vector) -> tuple[jax.Array, jax.Array]:
    """Distance at which rays enter a piece of furniture, infinite where they miss it, and the axis of that side."""
    corners = [row[a] for a in range(6)]
    return enter_box(corners[:3], corners[3:], origin, ray, 1e-3, jnp.inf)


@jax.jit
def _nearest_box(room: Room, origin: Vector, ray: Vector) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Distance, row and entered axis of the first box on each ray."""
    boxes = room.boxes

    def step(slot: jax.Array, best: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        distance, axis = _enter(boxes[slot], origin, ray)
        closer = distance < best[0]
        return jnp.minimum(best[0], distance), jnp.where(closer, slot, best[1]), jnp.where(closer, axis, best[2])

    nothing = jnp.zeros_like(ray[0], dtype=jnp.int32)
    best = jax.lax.fori_loop(0, _used(boxes), step, (jnp.full_like(ray[0], jnp.inf), nothing, nothing))
    return best[0], best[1], best[2]


def _used(boxes: jax.Array) -> jax.Array:
    """Rows before the first empty one: a loop over these costs nothing for the padding."""
    return jnp.sum((boxes[:, 3] > boxes[:, 0]).astype(jnp.int32))


@jax.jit
def _decor_slot(room: Room, surface: Surface) -> jax.Array:
    """Row of the decoration at each point of the room's faces, -1 where there is none."""
    u, v = wall_coordinates(surface)

    def step(slot: jax.Array, top: jax.Array) -> jax.Array:
        row = room.decor[slot]
        rim = jnp.minimum(jnp.minimum(u - row[1], row[3] - u), jnp.minimum(v - row[2], row[4] - v))
        hollow = row[8].astype(jnp.int32) == KINDS.index("tape")
        inside = (surface.face == row[0].astype(jnp.int32)) & (rim > 0) & (~hollow | (rim < _TAPE_M))
        return jnp.where(inside, slot, top)  # what comes later lies on top

    count = jnp.sum((room.decor[:, 0] >= 0).astype(jnp.int32))
    return jax.lax.fori_loop(0, count, step, jnp.full_like(surface.face, -1))


@jax.jit
def _light(room: Room, surface: Surface) -> jax.Array:
    """Two ceiling lamps with shadows, ambient light, and the darkness of corners."""
    hit, outward, size, boxes = surface.hit, surface.outward, room.size_m, room.boxes
    total = jnp.full_like(hit[0], _AMBIENT)
    start = [h + 2e-3 * n for h, n in zip(hit, outward, strict=True)]
    for lamp_x in lamp_x_m(size[0]):
        lamp = (lamp_x, jnp.float32(0.0), size[2] - 0.02)
        way = [lamp[a] - start[a] for a in range(3)]
        distance = jnp.sqrt(way[0] ** 2 + way[1] ** 2 + way[2] ** 2)
        facing = sum((w * n for w, n in zip(way, outward, strict=True)), jnp.float32(0.0)) / distance

        def shade(slot: jax.Array, dark: jax.Array, way: Vector = way) -> jax.Array:
            return dark | (_enter(boxes[slot], start, way)[0] < 1.0)

        dark = jax.lax.fori_loop(0, _used(boxes), shade, jnp.zeros_like(distance, dtype=bool))
        strength = jnp.maximum(facing, 0.0) * jnp.maximum(way[2], 0.0) / distance / (0.6 + 0.25 * distance**2)
        total = total + _LAMP * strength * jnp.where(dark, 0.15, 1.0)
    gaps = [size[a] / 2 - jnp.abs(hit[a]) for a in range(2)] + [jnp.minimum(hit[2], size[2] - hit[2])]
    for gap, normal in zip(gaps, outward, strict=True):
        total = total * jnp.where(normal == 0, 1 - 0.28 * jnp.exp(-jnp.maximum(gap, 0.0) / 0.25), 1.0)
    return total

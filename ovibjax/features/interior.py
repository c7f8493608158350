"""A ray-caster for rooms: colour and depth of any camera pose between four walls, a floor and a ceiling.

Rooms are small and drives short, so every ray meets every box in one scan. Images are rendered with two by two rays a
pixel, as indoor textures are finer than a pixel of the backbone's input.
"""

from functools import partial

import jax
import jax.numpy as jnp

from ovibjax.features.room import FACES, KINDS, LOOKS, Room
from ovibjax.features.shading import noise, stripes

_RAYS = 2  # per pixel and axis
_AMBIENT = 0.42
_LAMP = 1.15

Colour = list[jax.Array]


def camera_rays(yaw_rad: jax.Array, pitch_rad: jax.Array, height_px: int, width_px: int) -> Colour:
    """Rays of unit depth through a pinhole camera of 90 degrees.

    Args:
        yaw_rad: [V] heading of each view.
        pitch_rad: [V] elevation of each view, -pi/2 looks straight down.
        height_px: image rows.
        width_px: image columns.

    Returns:
        x, y and z, each [V, H*W], rows from the top.
    """
    u = (jnp.arange(width_px, dtype=jnp.float32) + 0.5) / width_px * 2 - 1
    v = (1 - (jnp.arange(height_px, dtype=jnp.float32) + 0.5) / height_px * 2) * (height_px / width_px)
    right_px, up_px = (grid.ravel() for grid in jnp.meshgrid(u, v))
    cy, sy, cp, sp = jnp.cos(yaw_rad), jnp.sin(yaw_rad), jnp.cos(pitch_rad), jnp.sin(pitch_rad)
    forward = (cp * cy, cp * sy, sp)
    right = (sy, -cy, jnp.zeros_like(cy))
    up = (-sp * cy, -sp * sy, cp)
    axes = zip(forward, right, up, strict=True)
    return [f[:, None] + r[:, None] * right_px[None] + w[:, None] * up_px[None] for f, r, w in axes]


@partial(jax.jit, static_argnames=("height_px", "width_px"))
def render_interior(
    room: Room, origin_m: jax.Array, yaw_rad: jax.Array, pitch_rad: jax.Array, height_px: int, width_px: int
) -> tuple[jax.Array, jax.Array]:
    """Render views of a room.

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
    height, width = height_px * _RAYS, width_px * _RAYS
    ray = camera_rays(yaw_rad, pitch_rad, height, width)
    origin = [origin_m[:, a, None] for a in range(3)]
    shell_m, face = _shell(room, origin, ray)
    box_m, slot, axis = _nearest_box(room, origin, ray)
    in_box = box_m < shell_m
    depth_m = jnp.minimum(box_m, shell_m)
    hit = [origin[a] + depth_m * ray[a] for a in range(3)]
    footprint = depth_m * (2.0 / width)
    shell_rgb, glow = _shade_shell(room, hit, face, footprint)
    box_rgb = _shade_box(room, hit, slot, axis, footprint)
    normal = jnp.where(in_box, axis, jnp.where(face < 4, face // 2, 2))
    outward = [jnp.where(normal == a, -jnp.sign(ray[a]), 0.0) for a in range(3)]
    light = _light(room, hit, outward)
    glow = jnp.where(in_box, 0.0, glow)
    rgb = [jnp.where(in_box, box_rgb[c], shell_rgb[c]) for c in range(3)]
    tint = (1.02, 1.0, 0.95)
    rgb = [jnp.clip(c * (light * t + glow * (1 - light * t)), 0.0, 1.0) for c, t in zip(rgb, tint, strict=True)]
    picture = jnp.stack(rgb, -1).reshape(-1, height_px, _RAYS, width_px, _RAYS, 3).mean(axis=(2, 4))
    depth = depth_m.reshape(-1, height_px, _RAYS, width_px, _RAYS).mean(axis=(2, 4))
    # Gamma 1/2.2 is close enough to a square root.
    return jnp.sqrt(picture), depth


def _shell(room: Room, origin: Colour, ray: Colour) -> tuple[jax.Array, jax.Array]:
    """Distance to the face of the room that a ray leaves through, and its code."""
    size = jnp.asarray(room.size_m)
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


def _slab(row: jax.Array, origin: Colour, ray: Colour) -> tuple[jax.Array, jax.Array]:
    """Distance at which rays enter a box, infinite where they miss it, and the axis of the side they enter by."""
    near, far = jnp.full_like(ray[0], -jnp.inf), jnp.full_like(ray[0], jnp.inf)
    axis = jnp.zeros_like(ray[0], dtype=jnp.int32)
    for a in range(3):
        inverse = 1.0 / jnp.where(jnp.abs(ray[a]) < 1e-7, 1e-7, ray[a])
        one, other = (row[a] - origin[a]) * inverse, (row[3 + a] - origin[a]) * inverse
        enter = jnp.minimum(one, other)
        axis = jnp.where(enter > near, a, axis)
        near, far = jnp.maximum(near, enter), jnp.minimum(far, jnp.maximum(one, other))
    return jnp.where((near < far) & (near > 1e-3), near, jnp.inf), axis


def _nearest_box(room: Room, origin: Colour, ray: Colour) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Distance, row and entered axis of the first box on each ray."""

    def step(best: tuple[jax.Array, ...], inputs: tuple[jax.Array, jax.Array]) -> tuple[tuple[jax.Array, ...], None]:
        slot, row = inputs
        distance, axis = _slab(row, origin, ray)
        closer = distance < best[0]
        return (
            jnp.minimum(best[0], distance),
            jnp.where(closer, slot, best[1]),
            jnp.where(closer, axis, best[2]),
        ), None

    boxes = jnp.asarray(room.boxes)
    nothing = jnp.zeros_like(ray[0], dtype=jnp.int32)
    start = (jnp.full_like(ray[0], jnp.inf), nothing, nothing)
    best, _ = jax.lax.scan(step, start, (jnp.arange(boxes.shape[0]), boxes))
    return best[0], best[1], best[2]


def _cell(x: jax.Array, y: jax.Array, salt: int) -> jax.Array:
    """A number in [0, 1) for each cell of the unit lattice."""
    return noise(jnp.floor(x), jnp.floor(y), salt)


def _shade_shell(room: Room, hit: Colour, face: jax.Array, footprint: jax.Array) -> tuple[Colour, jax.Array]:
    """Walls, floor and ceiling with what hangs or lies on them; colour, and how much of it shines by itself."""
    paint = jnp.asarray(room.paint)[face]
    floor, wall = FACES.index("floor"), face < 4
    u = jnp.where(face < 2, hit[1], hit[0])
    v = jnp.where(wall, hit[2], hit[1])
    plank = 0.78 + 0.34 * _cell(v / 0.16, u / 1.1 + 3.7 * jnp.floor(v / 0.16), 81) - 0.25 * stripes(
        v, 0.16, 0.07, footprint
    )
    tile = 0.84 + 0.28 * _cell(u / 0.4, v / 0.4, 83) - 0.3 * jnp.maximum(
        stripes(u, 0.4, 0.05, footprint), stripes(v, 0.4, 0.05, footprint)
    )
    carpet = 0.8 + 0.4 * noise(u * 2.1, v * 2.1, 85)
    kind = jnp.asarray(room.floor_kind)
    ground = jnp.where(kind < 0.5, plank, jnp.where(kind < 1.5, tile, carpet))
    plaster = 0.95 + 0.1 * noise(u * 1.3, v * 1.3, 87)
    skirting = wall & (v < 0.08)
    tone = jnp.where(face == floor, ground, plaster)
    rgb = [jnp.where(skirting, 0.82, paint[..., c] * tone) for c in range(3)]

    def step(state: tuple[Colour, jax.Array], row: jax.Array) -> tuple[tuple[Colour, jax.Array], None]:
        rgb, glow = state
        s, t = (u - row[1]) / (row[3] - row[1]), (v - row[2]) / (row[4] - row[2])
        inside = (face == row[0].astype(jnp.int32)) & (s > 0) & (s < 1) & (t > 0) & (t < 1)
        colour, shines, covers = _decoration(row, s, t, u, v, footprint)
        inside = inside & covers
        rgb = [jnp.where(inside, new, old) for new, old in zip(colour, rgb, strict=True)]
        return (rgb, jnp.where(inside, shines, glow)), None

    (rgb, glow), _ = jax.lax.scan(step, (rgb, jnp.zeros_like(u)), jnp.asarray(room.decor))
    return rgb, glow


def _decoration(
    row: jax.Array, s: jax.Array, t: jax.Array, u: jax.Array, v: jax.Array, footprint: jax.Array
) -> tuple[Colour, jax.Array, jax.Array]:
    """Colour, glow and coverage of one decoration; s and t run from 0 to 1 across it."""
    base, kind, number = row[5:8], row[8].astype(jnp.int32), row[9]
    rim = jnp.minimum(jnp.minimum(s, 1 - s) * (row[3] - row[1]), jnp.minimum(t, 1 - t) * (row[4] - row[2]))
    one = jnp.ones_like(s)
    art = _cell(s * 4 + 11.0 * number, t * 5, 91)
    round_ = ((s - 0.5) ** 2 + (t - 0.45) ** 2 < 0.06) & (jnp.mod(number, 2.0) < 1)
    frame = jnp.maximum(
        jnp.where(rim < 0.05, 1.0, 0.0), jnp.maximum(stripes(s, 0.5, 0.06, 0.02 * one), stripes(t, 1.0, 0.03, 0.02 * one))
    )
    outside = 0.55 + 0.45 * noise(s * 3.0 + number, t * 2.0, 93)
    garden = t < 0.25 + 0.15 * noise(s * 6.0, number + 0.0 * s, 95)
    panel = (jnp.abs(s - 0.5) < 0.3) & (jnp.abs(jnp.mod(t * 2.0, 1.0) - 0.5) < 0.36)
    handle = (jnp.abs(s - 0.9) < 0.03) & (jnp.abs(t - 0.5) < 0.03)
    writing = (_cell(s * 9 + 5.0 * number, t * 8, 97) > 0.6) & (jnp.abs(jnp.mod(t * 8.0, 1.0) - 0.5) < 0.16)
    folds = 0.7 + 0.5 * stripes(u, 0.09, 0.5, footprint)
    weave = (rim < 0.09) | ((jnp.abs(jnp.mod(u / 0.3 + v / 0.3, 1.0) - 0.5) < 0.2) & (rim > 0.2))
    colours = []
    for c in range(3):
        poster = jnp.where(round_, base[(c + 1) % 3], jnp.where(art > 0.55, base[c], 0.35 + 0.6 * base[(c + 2) % 3]))
        view = jnp.where(garden, (0.30, 0.48, 0.22)[c], base[c] * outside)
        looks = (
            jnp.where(rim < 0.03, 0.95, poster),
            jnp.where(frame > 0.5, 0.93, view),
            base[c] * jnp.where(rim < 0.04, 0.6, jnp.where(handle, 0.3, jnp.where(panel, 0.82, 1.0))),
            jnp.where(rim < 0.03, 0.45, jnp.where(writing, (0.1, 0.2, 0.5)[c], base[c])),
            base[c] * folds,
            jnp.where(weave, 0.85 * base[c] + 0.1, 0.25 + 0.5 * base[(c + 1) % 3]),
            base[c] * one,
            base[c] * one,
        )
        colours.append(jnp.select([kind == k for k in range(len(KINDS))], looks))
    window = jnp.where(frame > 0.5, 0.0, 0.75)
    glow = jnp.where(kind == KINDS.index("lamp"), 1.0, jnp.where(kind == KINDS.index("window"), window, 0.0))
    return colours, glow * one, jnp.where(kind == KINDS.index("tape"), rim < 0.04, rim >= 0)


def _shade_box(room: Room, hit: Colour, slot: jax.Array, axis: jax.Array, footprint: jax.Array) -> Colour:
    """Furniture: books, drawers, cloth, leaves, screens or plain boards."""
    row = jnp.asarray(room.boxes)[slot]
    look, scale, number = row[..., 9].astype(jnp.int32), row[..., 10], row[..., 11]
    along = jnp.where(axis == 0, hit[1] - row[..., 1], hit[0] - row[..., 0])
    up = jnp.where(axis == 2, hit[1] - row[..., 1], hit[2] - row[..., 2])
    width = jnp.where(axis == 0, row[..., 4] - row[..., 1], row[..., 3] - row[..., 0])
    tall = jnp.where(axis == 2, row[..., 4] - row[..., 1], row[..., 5] - row[..., 2])
    rim = jnp.minimum(jnp.minimum(along, width - along), jnp.minimum(up, tall - up))
    on_top = axis == 2
    grain = 0.88 + 0.24 * noise(along * 3.0 + number, up * 14.0, 101)
    level = jnp.mod(up, scale) / scale
    spine = jnp.floor(along / 0.045)
    tint = _cell(spine, jnp.floor(up / scale) + 7.0 * jnp.mod(number, 5.0), 103)
    filled = level < 0.55 + 0.35 * _cell(spine, jnp.floor(up / scale) + 3.0, 105)
    board = (rim < 0.03) | (level < 0.07)
    joint = (rim < 0.015) | (jnp.mod(up, scale) < 0.02)
    knob = (jnp.abs(along - width / 2) < 0.05) & (jnp.abs(level - 0.5) < 0.06)
    cloth = 0.75 + 0.5 * noise(along * 9.0 + number, up * 9.0, 107)
    leaf = 0.5 + 1.0 * _cell(along / scale + hit[0] / scale, up / scale + number, 109)
    shown = noise(along * 12.0 + number, up * 9.0, 111)
    rgb = []
    for c in range(3):
        base = row[..., 6 + c]
        book = 0.15 + 0.75 * jnp.mod(tint * (5.0, 11.0, 17.0)[c], 1.0)
        looks = (
            base * grain * jnp.where(rim < 0.02, 0.8, 1.0),
            jnp.where(board, base * grain, jnp.where(filled, book, 0.18 * base)),
            base * grain * jnp.where(joint | knob, 0.45, 1.0),
            base * cloth,
            base * leaf,
            jnp.where(rim < 0.02, base, (0.25, 0.45, 0.7)[c] * (0.4 + 0.9 * shown)),
        )
        side = jnp.select([look == k for k in range(len(LOOKS))], looks)
        flat = (look == LOOKS.index("books")) | (look == LOOKS.index("drawers")) | (look == LOOKS.index("screen"))
        rgb.append(jnp.where(on_top & flat, base * grain, side))
    return rgb


def _light(room: Room, hit: Colour, outward: Colour) -> jax.Array:
    """Two ceiling lamps with shadows, ambient light, and the darkness of corners."""
    size = jnp.asarray(room.size_m)
    boxes = jnp.asarray(room.boxes)
    total = jnp.full_like(hit[0], _AMBIENT)
    start = [h + 2e-3 * n for h, n in zip(hit, outward, strict=True)]
    for sign in (-1.0, 1.0):
        lamp = (sign * size[0] / 4, jnp.float32(0.0), size[2] - 0.02)
        way = [lamp[a] - start[a] for a in range(3)]
        distance = jnp.sqrt(way[0] ** 2 + way[1] ** 2 + way[2] ** 2)
        facing = sum((w * n for w, n in zip(way, outward, strict=True)), jnp.float32(0.0)) / distance

        def shade(dark: jax.Array, row: jax.Array, way: Colour = way) -> tuple[jax.Array, None]:
            return dark | (_slab(row, start, way)[0] < 1.0), None

        dark, _ = jax.lax.scan(shade, jnp.zeros_like(distance, dtype=bool), boxes)
        strength = jnp.maximum(facing, 0.0) * jnp.maximum(way[2], 0.0) / distance / (0.6 + 0.25 * distance**2)
        total = total + _LAMP * strength * jnp.where(dark, 0.15, 1.0)
    gaps = [size[a] / 2 - jnp.abs(hit[a]) for a in range(2)] + [jnp.minimum(hit[2], size[2] - hit[2])]
    for gap, normal in zip(gaps, outward, strict=True):
        total = total * jnp.where(normal == 0, 1 - 0.28 * jnp.exp(-jnp.maximum(gap, 0.0) / 0.25), 1.0)
    return total

"""Materials of the embedded rooms: floors, walls and what hangs on them, furniture.

Every function takes per-ray arrays [V, P] and returns colours as three such arrays.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.world.patterns import Colour, noise, stripes
from ovibjax.world.rays import Vector
from ovibjax.world.rooms.furniture import KINDS, LOOKS
from ovibjax.world.rooms.room import FACES, Room


class Surface(NamedTuple):
    """What each ray meets; arrays [V, P].

    Attributes:
        depth_m: distance along the optical axis.
        in_box: whether it is furniture.
        face: face of the room behind it.
        slot: row of the furniture.
        axis: normal of the side that is seen.
        hit: point in the room.
        outward: unit normal towards the camera.
    """

    depth_m: jax.Array
    in_box: jax.Array
    face: jax.Array
    slot: jax.Array
    axis: jax.Array
    hit: Vector
    outward: Vector


def wall_coordinates(surface: Surface) -> tuple[jax.Array, jax.Array]:
    """Coordinates u and v on the face of the room that a ray ends at."""
    hit, face = surface.hit, surface.face
    return jnp.where(face < 2, hit[1], hit[0]), jnp.where(face < 4, hit[2], hit[1])


@jax.jit
def shade_shell(room: Room, surface: Surface, slot: jax.Array, footprint: jax.Array) -> tuple[Colour, jax.Array]:
    """Walls, floor and ceiling with what hangs or lies on them; colour, and how much of it shines by itself."""
    face = surface.face
    paint = room.paint[face]
    u, v = wall_coordinates(surface)
    plank = 0.78 + 0.34 * _cell(v / 0.16, u / 1.1 + 3.7 * jnp.floor(v / 0.16), 81)
    plank = plank - 0.25 * stripes(v, 0.16, 0.07, footprint)
    joints = jnp.maximum(stripes(u, 0.4, 0.05, footprint), stripes(v, 0.4, 0.05, footprint))
    tile = 0.84 + 0.28 * _cell(u / 0.4, v / 0.4, 83) - 0.3 * joints
    carpet = 0.8 + 0.4 * noise(u * 2.1, v * 2.1, 85)
    ground = jnp.where(room.floor_kind < 0.5, plank, jnp.where(room.floor_kind < 1.5, tile, carpet))
    plaster = 0.95 + 0.1 * noise(u * 1.3, v * 1.3, 87)
    skirting = (face < 4) & (v < 0.08)
    tone = jnp.where(face == FACES.index("floor"), ground, plaster)
    rgb = [jnp.where(skirting, 0.82, paint[..., c] * tone) for c in range(3)]
    colour, glow = _decoration(room.decor[jnp.maximum(slot, 0)], u, v, footprint)
    rgb = [jnp.where(slot >= 0, new, old) for new, old in zip(colour, rgb, strict=True)]
    return rgb, jnp.where(slot >= 0, glow, 0.0)


def _decoration(rows: jax.Array, u: jax.Array, v: jax.Array, footprint: jax.Array) -> tuple[Colour, jax.Array]:
    """Colour and glow of points on decorations, each with its row of `Room.decor`."""
    _, u0, v0, u1, v1, *base, code, number = (rows[..., i] for i in range(rows.shape[-1]))
    kind = code.astype(jnp.int32)
    s, t = (u - u0) / (u1 - u0), (v - v0) / (v1 - v0)
    rim = jnp.minimum(jnp.minimum(u - u0, u1 - u), jnp.minimum(v - v0, v1 - v))
    one = jnp.ones_like(s)
    art = _cell(s * 4 + 11.0 * number, t * 5, 91)
    round_ = ((s - 0.5) ** 2 + (t - 0.45) ** 2 < 0.06) & (jnp.mod(number, 2.0) < 1)
    bars = jnp.maximum(stripes(s, 0.5, 0.06, 0.02 * one), stripes(t, 1.0, 0.03, 0.02 * one))
    frame = jnp.where(rim < 0.05, 1.0, bars)
    outside = 0.55 + 0.45 * noise(s * 3.0 + number, t * 2.0, 93)
    garden = t < 0.25 + 0.15 * noise(s * 6.0, number, 95)
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
            base[c],
            base[c],
        )
        colours.append(jnp.select([kind == k for k in range(len(KINDS))], looks))
    window = jnp.where(frame > 0.5, 0.0, 0.75)
    glow = jnp.where(kind == KINDS.index("lamp"), 1.0, jnp.where(kind == KINDS.index("window"), window, 0.0))
    return colours, glow


@jax.jit
def shade_box(room: Room, surface: Surface, footprint: jax.Array) -> Colour:
    """Furniture: books, drawers, cloth, leaves, screens or plain boards."""
    hit, axis, row = surface.hit, surface.axis, room.boxes[surface.slot]
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


def _cell(x: jax.Array, y: jax.Array, salt: int) -> jax.Array:
    """A number in [0, 1) for each cell of the unit lattice."""
    return noise(jnp.floor(x), jnp.floor(y), salt)

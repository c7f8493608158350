"""Materials of the embedded town: walls with windows, roofs, roads with markings, lawns, trees and sky.

Every function takes per-pixel arrays [V, P] and returns colours as three such arrays; periodic patterns are averaged
over the pixel's footprint, so that they fade into their mean instead of aliasing.
"""

import jax
import jax.numpy as jnp

from ovibjax.world.patterns import Colour, lattice_cell, lattice_value, noise, stripes
from ovibjax.world.town.layout import Town
from ovibjax.world.town.style import GRASS, ROAD, WALK, YARD, Look

SEMANTIC_CLASSES: tuple[str, ...] = (
    *("sky", "building", "roof", "road", "road_line", "sidewalk", "terrain", "vegetation"),
)
"""Semantic classes, in the order of their integer codes."""


def _line(distance: jax.Array, half_width: float, footprint: jax.Array) -> jax.Array:
    """Coverage of a painted line by a pixel: `distance` from its axis."""
    half = jnp.maximum(footprint / 2, 1e-3)
    overlap = jnp.minimum(distance + half, half_width) - jnp.maximum(distance - half, -half_width)
    return jnp.clip(overlap / (2 * half), 0.0, 1.0)


def _mix(a: jax.Array, b: jax.Array | float, share: jax.Array) -> jax.Array:
    return a + share * (b - a)


@jax.jit
def shade_wall(
    look: Look, hit: Colour, row: list[jax.Array], faces_x: jax.Array, ray: Colour, footprint: jax.Array
) -> tuple[Colour, jax.Array]:
    """Façade: storeys, bays, window panes that differ from each other, plinth and weathering."""
    along = jnp.where(faces_x, hit[1] - row[1], hit[0] - row[0])
    bay, storey, share, tone = row[9], row[10], row[11], row[12]
    height = hit[2] - row[2]
    window = stripes(along, bay, share, footprint) * stripes(height, storey, 0.5 + 0.3 * share, footprint)
    ix, _ = lattice_cell(along / bay)
    iy, _ = lattice_cell(height / storey)
    salt = row[14].astype(jnp.int32) * 4 + faces_x.astype(jnp.int32)
    pane = lattice_value(ix, iy, salt)
    # Panes blur into their mean once a pixel covers several of them.
    pane = _mix(pane, 0.5, jnp.clip(footprint / bay - 0.4, 0.0, 1.0))
    glass = tone * (0.55 + 0.9 * pane)
    wear = 0.86 + 0.28 * noise(along * 0.21 + row[14] * 7.3, height * 0.13, 11)
    band = 1 - 0.25 * stripes(height, storey, 0.08, footprint)
    plinth = jnp.where(height < 1.1, 0.72, 1.0)
    outward_x = jnp.where(ray[0] < 0, 1.0, -1.0)
    outward_y = jnp.where(ray[1] < 0, 1.0, -1.0)
    light = jnp.where(faces_x, outward_x * look.sun[0], outward_y * look.sun[1])
    rgb = [_mix(row[6 + c] * wear * band * plinth, glass * look.glass[c], window) for c in range(3)]
    return rgb, light


@jax.jit
def shade_roof(hit: Colour, row: list[jax.Array], footprint: jax.Array) -> Colour:
    """Flat roof with a parapet, stains and plant boxes."""
    edge = jnp.minimum(jnp.minimum(hit[0] - row[0], row[3] - hit[0]), jnp.minimum(hit[1] - row[1], row[4] - hit[1]))
    ix, fx = lattice_cell(hit[0] / 3.1)
    iy, fy = lattice_cell(hit[1] / 3.1)
    unit = (lattice_value(ix, iy, 5) > 0.82) & (jnp.abs(fx - 0.5) < 0.3) & (jnp.abs(fy - 0.5) < 0.3)
    tone = row[13] * (0.75 + 0.5 * noise(hit[0] * 0.35, hit[1] * 0.35, 3))
    tone = jnp.where(unit, 0.82, tone)
    parapet = jnp.clip((0.6 - edge) / jnp.maximum(footprint, 0.05), 0.0, 1.0)
    return [_mix(tone * warm, row[6 + c], parapet) for c, warm in enumerate((1.0, 0.96, 0.92))]


@jax.jit
def shade_tree(look: Look, hit: Colour, row: list[jax.Array], footprint: jax.Array) -> tuple[Colour, jax.Array]:
    """Leafy crown on a brown trunk."""
    normal = [(hit[a] - row[a]) / jnp.maximum(row[3], 0.1) for a in range(3)]
    on_trunk = normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2 > 1.1
    leaf = noise((hit[0] + hit[2] * 0.7) * 2.3, (hit[1] - hit[2] * 0.6) * 2.3, 21)
    leaf = _mix(leaf, 0.5, jnp.clip(footprint * 1.5, 0.0, 1.0))
    tone = 0.55 + 0.9 * leaf
    light = normal[0] * look.sun[0] + normal[1] * look.sun[1] + normal[2] * look.sun[2]
    light = jnp.where(on_trunk, 0.3, 0.35 + 0.65 * jnp.clip(light, -0.5, 1.0))
    warm = row[4]
    green = [(look.leaf[0, c] + look.leaf[1, c] * warm) * tone for c in range(3)]
    bark = (0.30, 0.22, 0.15)
    return [jnp.where(on_trunk, b, g) for g, b in zip(green, bark, strict=True)], light


@jax.jit
def shade_ground(town: Town, hit: Colour, footprint: jax.Array) -> tuple[Colour, jax.Array]:
    """Carriageway with markings and zebra crossings, pavement, and lawns or yards inside the blocks."""
    x, y = hit[0], hit[1]
    half, pavement = town.road_half_width_m, town.pavement_m
    dx, road_i, block_i = _nearest_road(x, town.road_x_m)
    dy, road_j, block_j = _nearest_road(y, town.road_y_m)
    ax, ay = jnp.abs(dx), jnp.abs(dy)
    on_x, on_y = ax < half, ay < half
    crossing = on_x & on_y
    on_road = on_x | on_y
    reach = jnp.minimum(ax, ay)
    on_pavement = ~on_road & (reach < half + pavement)
    # Along and across the road the pixel lies on.
    along = jnp.where(on_x, y, x)
    across = jnp.where(on_x, dx, dy)
    to_crossing = jnp.where(on_x, ay, ax) - half
    open_road = (to_crossing > 5.5) & ~crossing
    dashes = _line(across, 0.09, footprint) * stripes(along, 6.0, 0.5, footprint)
    sides = _line(jnp.abs(across) - (half - 0.35), 0.08, footprint)
    # Every second arm of a crossing has a zebra; which ones tells crossings apart.
    arm = jnp.where(on_x, 2 + (dy > 0).astype(jnp.int32), (dx > 0).astype(jnp.int32))
    has_zebra = lattice_value(road_i * 4 + arm, road_j, 59) > 0.5
    beside = (to_crossing > 1.2) & (to_crossing < 4.2)
    zebra = stripes(across, 1.1, 0.5, footprint) * (beside & has_zebra).astype(jnp.float32)
    stop = ((to_crossing > 4.8) & (to_crossing < 5.4) & (jnp.abs(across) < half - 0.4)).astype(jnp.float32)
    paint = jnp.where(open_road, jnp.maximum(dashes, sides), jnp.maximum(zebra, stop))
    paint = jnp.where(crossing, 0.0, paint) * (0.55 + 0.3 * noise(x * 0.9, y * 0.9, 31))
    broad = noise(x * 0.045, y * 0.045, 41)
    fine = noise(x * 0.6, y * 0.6, 43)
    fine = _mix(fine, 0.5, jnp.clip(footprint * 0.4, 0.0, 1.0))
    # Repaired patches of asphalt: rectangles of a coarse lattice.
    ix, _ = lattice_cell(x / 3.7)
    iy, _ = lattice_cell(y / 4.9)
    patch = jnp.where(lattice_value(ix, iy, 47) > 0.9, -0.05, 0.0)
    worn = jnp.where(on_x, lattice_value(road_i, road_i, 71), lattice_value(road_j, road_j, 73))
    asphalt = 0.15 + 0.12 * broad + 0.05 * fine + 0.10 * worn + patch
    slabs = 1 - 0.16 * jnp.maximum(stripes(x, 1.5, 0.06, footprint), stripes(y, 1.5, 0.06, footprint))
    walk = (0.46 + 0.10 * broad + 0.05 * fine) * slabs
    lawn = _block_value(town.lawn, block_i, block_j)
    tint = lattice_value(block_i, block_j, 53)
    warm = lattice_value(block_j, block_i, 79) - 0.5
    yard = 0.26 + 0.26 * tint + 0.10 * fine
    grass = 0.75 + 0.35 * fine + 0.3 * broad
    rgb = []
    ground = town.look.ground
    for c, warm_c in enumerate((0.45, 0.0, -0.4)):
        tinted = 1 + warm_c * warm
        inside = (
            jnp.where(lawn > 0.5, grass * (ground[GRASS, c] + 0.10 * (tint - 0.5)), yard * ground[YARD, c]) * tinted
        )
        road = _mix(asphalt * ground[ROAD, c], 0.86, paint)
        rgb.append(jnp.where(on_road, road, jnp.where(on_pavement, walk * ground[WALK, c] * tinted, inside)))
    painted = on_road & (paint > 0.35)
    ids = {name: i for i, name in enumerate(SEMANTIC_CLASSES)}
    klass = jnp.where(painted, ids["road_line"], ids["road"])
    klass = jnp.where(on_road, klass, jnp.where(on_pavement, ids["sidewalk"], ids["terrain"]))
    return rgb, klass


def _nearest_road(x: jax.Array, roads: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Signed distance to the nearest road axis, its index, and the index of the block between two axes."""
    best = x - roads[0]
    index = jnp.zeros_like(x, dtype=jnp.int32)
    block = (best > 0).astype(jnp.int32)
    for r in range(1, roads.shape[0]):
        d = x - roads[r]
        index = jnp.where(jnp.abs(d) < jnp.abs(best), r, index)
        best = jnp.where(jnp.abs(d) < jnp.abs(best), d, best)
        block = block + (d > 0).astype(jnp.int32)
    return best, index, block


def _block_value(table: jax.Array, i: jax.Array, j: jax.Array) -> jax.Array:
    return jnp.asarray(table)[i, j]


@jax.jit
def towards_sun(look: Look, direction: Colour) -> jax.Array:
    """Cosine of the angle between a ray and the sun, from 0: a stage of its own, as six colours need the same one."""
    sun = look.sun
    return jnp.clip(direction[0] * sun[0] + direction[1] * sun[1] + direction[2] * sun[2], 0.0, 1.0)


@jax.jit
def shade_sky(look: Look, direction: Colour, sun_cosine: jax.Array) -> tuple[Colour, Colour]:
    """Sky with clouds and a sun, and the haze colour far things fade into."""
    up = jnp.clip(direction[2], 0.0, 1.0)
    glow = sun_cosine**8 * 0.25
    scale = 1.0 / jnp.maximum(direction[2], 0.06)
    u, v = direction[0] * scale, direction[1] * scale
    cloud = 0.6 * noise(u * 1.1 + 3.0, v * 1.1, 61) + 0.4 * noise(u * 2.9, v * 2.9 + 5.0, 67)
    cloud = jnp.clip((cloud - look.clear) * 3.2, 0.0, 1.0) * jnp.clip(direction[2] * 6, 0.0, 1.0)
    sky, haze = [], []
    for top, horizon, sun in zip(look.sky_top, look.horizon, (1.0, 0.8, 0.5), strict=True):
        clear = _mix(jnp.full_like(up, horizon), top, jnp.sqrt(up)) + glow * sun
        sky.append(_mix(clear, 0.92, 0.8 * cloud))
        haze.append(jnp.full_like(up, horizon) + 0.6 * glow * sun)
    return sky, haze

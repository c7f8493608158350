"""A ray-caster for the embedded town: colour, depth and semantic class of any camera pose, pure and jitted.

Three steps keep it fast on a CPU: each view keeps only the nearest primitives inside its frustum (`_cull`); the
search for the first hit is one fused minimum over integers that carry the distance in their high and the primitive's
slot in their low bits (`_first_hit`); and shading is arithmetic on the winner's row, with textures filtered by the
pixel's footprint so that small images do not alias.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.world.town.layout import Town
from ovibjax.world.town.shading import (
    SEMANTIC_CLASSES,
    SUN,
    shade_ground,
    shade_roof,
    shade_sky,
    shade_tree,
    shade_wall,
)

_FAR_M = 1e6
_HAZE_M = 210.0
_SLOT_BITS = 6
_SUNLIGHT = (0.95, 0.89, 0.78)
_SKYLIGHT = (0.38, 0.44, 0.54)


@dataclass(frozen=True)
class Camera:
    """A pinhole camera rig: five views of 90 degrees, four horizontal ones pitched down by 15 degrees, one downward.

    Attributes:
        height_px: image rows.
        width_px: image columns.
        max_boxes: buildings kept per view after culling.
        max_trees: trees kept per view after culling.
    """

    height_px: int = 48
    width_px: int = 64
    max_boxes: int = 32
    max_trees: int = 12


class Views(NamedTuple):
    """Images of one pose, or of a batch with leading axes.

    Attributes:
        rgb: [M, H, W, 3] float32 in [0, 1].
        depth_m: [M, H, W] float32, distance along the optical axis; 1e6 for sky.
        semantic: [M, H, W] int32, index into `SEMANTIC_CLASSES`.
    """

    rgb: jax.Array
    depth_m: jax.Array
    semantic: jax.Array


VIEW_YAW_DEG = (0.0, 180.0, 90.0, -90.0, 0.0)
VIEW_PITCH_DEG = (-15.0, -15.0, -15.0, -15.0, -90.0)


def camera_axes(yaw_rad: jax.Array) -> jax.Array:
    """Optical, right and up axes of the five cameras at a heading.

    Args:
        yaw_rad: scalar heading, counter-clockwise from x.

    Returns:
        [5, 3, 3] float32: per view the rows forward, right, up.
    """
    yaw = yaw_rad + jnp.deg2rad(jnp.array(VIEW_YAW_DEG, jnp.float32))
    pitch = jnp.deg2rad(jnp.array(VIEW_PITCH_DEG, jnp.float32))
    forward = jnp.stack([jnp.cos(pitch) * jnp.cos(yaw), jnp.cos(pitch) * jnp.sin(yaw), jnp.sin(pitch)], -1)
    right = jnp.stack([jnp.sin(yaw), -jnp.cos(yaw), jnp.zeros_like(yaw)], -1)
    return jnp.stack([forward, right, jnp.cross(right, forward)], -2)


def render(town: Town, positions_m: jax.Array, yaw_rad: jax.Array, camera: Camera) -> Views:
    """Render the five views at each of a batch of poses.

    The stages are compiled one by one: in a single program XLA would compute each of them again inside every
    consumer of its result, 40 times slower (jax 0.10 on a CPU).

    Args:
        town: the town's arrays.
        positions_m: [N, 3] camera positions.
        yaw_rad: [N] headings.
        camera: image size and culling limits.

    Returns:
        `Views` with leading axis N and M = 5.
    """
    n = positions_m.shape[0]
    origin, ray, boxes, trees = _prepare(town, jnp.asarray(positions_m), jnp.asarray(yaw_rad), camera)
    distances = (*_hit_boxes(boxes, origin, ray), *_hit_trees(trees, origin, ray))
    surface = _surface(distances, origin, ray, boxes, trees, camera)
    materials = (
        shade_wall(surface.hit, surface.box, surface.faces_x, ray, surface.footprint),
        shade_roof(surface.hit, surface.box, surface.footprint),
        shade_tree(surface.hit, surface.tree, surface.footprint),
        shade_ground(town, surface.hit, surface.slant),
        shade_sky(surface.direction),
    )
    flat = _compose(surface, materials, _sunlit(boxes, trees, surface.hit))
    shape = (n, 5, camera.height_px, camera.width_px)
    return Views(flat.rgb.reshape(*shape, 3), flat.depth_m.reshape(shape), flat.semantic.reshape(shape))


class _Surface(NamedTuple):
    """What each pixel sees; arrays [V, P]: one long vector axis for the CPU's vector units."""

    depth_m: jax.Array
    is_box: jax.Array
    is_tree: jax.Array
    is_sky: jax.Array
    on_roof: jax.Array
    faces_x: jax.Array
    hit: list[jax.Array]
    box: list[jax.Array]
    tree: list[jax.Array]
    direction: list[jax.Array]
    footprint: jax.Array
    slant: jax.Array
    range_m: jax.Array


def _pixel_grid(camera: Camera) -> tuple[jax.Array, jax.Array]:
    """Image-plane coordinates of pixel centres at unit depth: right and up, each [H*W]."""
    u = (jnp.arange(camera.width_px, dtype=jnp.float32) + 0.5) / camera.width_px * 2 - 1
    aspect = camera.height_px / camera.width_px
    v = (1 - (jnp.arange(camera.height_px, dtype=jnp.float32) + 0.5) / camera.height_px * 2) * aspect
    right, up = jnp.meshgrid(u, v)
    return right.ravel(), up.ravel()


@partial(jax.jit, static_argnames="camera")
def _prepare(
    town: Town, positions_m: jax.Array, yaw_rad: jax.Array, camera: Camera
) -> tuple[jax.Array, list[jax.Array], jax.Array, jax.Array]:
    """Origins [V, 3], rays 3 x [V, P], and the culled buildings and trees of each view."""
    axes = jax.vmap(camera_axes)(yaw_rad).reshape(-1, 3, 3)
    origin = jnp.repeat(positions_m, 5, axis=0)
    right, up = _pixel_grid(camera)
    ray = [axes[:, 0, a, None] + axes[:, 1, a, None] * right[None] + axes[:, 2, a, None] * up[None] for a in range(3)]
    cull = jax.vmap(_cull, (None, None, 0, 0, None))
    # A sphere from the ground through the crown bounds a tree and its trunk.
    tree_spheres = town.trees[:, jnp.array([0, 1, 2, 2])] * jnp.array([1.0, 1.0, 0.5, 1.0], jnp.float32)[None]
    boxes = cull(town.boxes, _box_spheres(town.boxes), origin, axes, camera.max_boxes)
    return origin, ray, boxes, cull(town.trees, tree_spheres, origin, axes, camera.max_trees)


@jax.jit
def _hit_boxes(boxes: jax.Array, origin: jax.Array, ray: list[jax.Array]) -> tuple[jax.Array, jax.Array]:
    return _first_hit([_box_distance(boxes[:, i], origin, ray) for i in range(boxes.shape[1])])


@jax.jit
def _hit_trees(trees: jax.Array, origin: jax.Array, ray: list[jax.Array]) -> tuple[jax.Array, jax.Array]:
    return _first_hit([_tree_distance(trees[:, i], origin, ray) for i in range(trees.shape[1])])


@partial(jax.jit, static_argnames="camera")
def _surface(
    distances: tuple[jax.Array, ...],
    origin: jax.Array,
    ray: list[jax.Array],
    boxes: jax.Array,
    trees: jax.Array,
    camera: Camera,
) -> _Surface:
    """Choose between building, tree, ground and sky, and gather what shading needs."""
    t_box, slot_box, t_tree, slot_tree = distances
    down = jnp.where(ray[2] < -1e-4, ray[2], -1e-4)
    t_ground = jnp.where(ray[2] < -1e-4, -origin[:, 2, None] / down, _FAR_M)
    t_ground = jnp.where(t_ground > 900.0, _FAR_M, t_ground)
    t = jnp.minimum(jnp.minimum(t_box, t_tree), t_ground)
    is_sky = t >= _FAR_M / 2
    t_hit = jnp.where(is_sky, 900.0, t)
    hit = [origin[:, a, None] + t_hit * ray[a] for a in range(3)]
    length = jnp.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2)
    # Metres that one pixel covers on a surface facing the camera.
    footprint = t_hit * (2.0 / camera.width_px)
    box = _lookup(boxes, slot_box)
    wall_x = jnp.minimum(jnp.abs(hit[0] - box[0]), jnp.abs(hit[0] - box[3]))
    wall_y = jnp.minimum(jnp.abs(hit[1] - box[1]), jnp.abs(hit[1] - box[4]))
    return _Surface(
        depth_m=jnp.where(is_sky, _FAR_M, t),
        is_box=(t_box <= jnp.minimum(t_tree, t_ground)) & ~is_sky,
        is_tree=(t_tree < jnp.minimum(t_box, t_ground)) & ~is_sky,
        is_sky=is_sky,
        on_roof=jnp.abs(hit[2] - box[5]) < jnp.minimum(wall_x, wall_y),
        faces_x=wall_x < wall_y,
        hit=hit,
        box=box,
        tree=_lookup(trees, slot_tree),
        direction=[r / length for r in ray],
        footprint=footprint,
        slant=footprint * length / jnp.maximum(-ray[2], 0.08),
        range_m=t_hit * length,
    )


@jax.jit
def _compose(surface: _Surface, materials: tuple[Any, ...], sunlit: jax.Array) -> Views:
    """Light, haze and gamma; the winner's colour of each pixel."""
    (wall_rgb, wall_light), roof_rgb, (tree_rgb, tree_light), (ground_rgb, ground_class), (sky_rgb, haze_rgb) = (
        materials
    )
    is_box, is_tree, is_sky, on_roof = surface.is_box, surface.is_tree, surface.is_sky, surface.on_roof
    light = jnp.where(is_box, jnp.where(on_roof, SUN[2], wall_light), jnp.where(is_tree, tree_light, SUN[2]))
    lit = jnp.maximum(light, 0.0) * sunlit
    fog = 1 - jnp.exp(-surface.range_m / _HAZE_M)
    rgb = []
    for c, (sun, ambient) in enumerate(zip(_SUNLIGHT, _SKYLIGHT, strict=True)):
        albedo = jnp.where(is_tree, tree_rgb[c], ground_rgb[c])
        albedo = jnp.where(is_box, jnp.where(on_roof, roof_rgb[c], wall_rgb[c]), albedo)
        colour = albedo * (sun * lit + ambient * (0.75 + 0.25 * light))
        colour = colour + fog * (haze_rgb[c] - colour)
        rgb.append(jnp.clip(jnp.where(is_sky, sky_rgb[c], colour), 0.0, 1.0))
    box_class = jnp.where(on_roof, SEMANTIC_CLASSES.index("roof"), SEMANTIC_CLASSES.index("building"))
    klass = jnp.where(is_tree, SEMANTIC_CLASSES.index("vegetation"), ground_class)
    klass = jnp.where(is_sky, SEMANTIC_CLASSES.index("sky"), jnp.where(is_box, box_class, klass))
    # Gamma 1/2.2 is close enough to a square root, and a square root vectorises.
    return Views(jnp.sqrt(jnp.stack(rgb, -1)), surface.depth_m, klass)


def _box_spheres(boxes: jax.Array) -> jax.Array:
    """Bounding spheres [B, 4] (x, y, z, radius) of the buildings."""
    middle = (boxes[:, :3] + boxes[:, 3:6]) / 2
    radius = jnp.linalg.norm(boxes[:, 3:6] - boxes[:, :3], axis=1, keepdims=True) / 2
    return jnp.concatenate([middle, radius], axis=1)


def _cull(rows: jax.Array, spheres: jax.Array, origin: jax.Array, axes: jax.Array, keep: int) -> jax.Array:
    """Rows of the `keep` nearest primitives whose bounding sphere touches the view's frustum; [keep, A]."""
    local = (spheres[:, :3] - origin[None]) @ axes.T  # forward, right, up
    radius = spheres[:, 3]
    # Distance outside the side planes (90 degrees wide) and the top and bottom planes (4:3).
    side = (jnp.abs(local[:, 1]) - local[:, 0]) * 0.70710678
    vertical = (jnp.abs(local[:, 2]) - 0.75 * local[:, 0]) * 0.8
    outside = jnp.maximum(jnp.maximum(side, vertical), -local[:, 0]) > radius
    # Nearest first, but a tower further off hides more of the picture than one more house nearby.
    distance = (jnp.linalg.norm(local, axis=1) - radius) / radius
    order = jax.lax.top_k(-jnp.where(outside, _FAR_M, distance), keep)[1]
    # What lies outside is moved far away, so that a slot without a primitive never hits.
    return jnp.where(outside[order][:, None], _FAR_M, rows[order])


def _box_distance(box: jax.Array, origin: jax.Array, ray: list[jax.Array]) -> jax.Array:
    """First hit of the slab test; box [V, A], result [V, P], `_FAR_M` where missed."""
    near: jax.Array = jnp.full_like(ray[0], -_FAR_M)
    far: jax.Array = jnp.full_like(ray[0], _FAR_M)
    for a in range(3):
        inverse = 1.0 / jnp.where(jnp.abs(ray[a]) < 1e-7, 1e-7, ray[a])
        low = (box[:, a] - origin[:, a])[:, None] * inverse
        high = (box[:, 3 + a] - origin[:, a])[:, None] * inverse
        enter, leave = jnp.minimum(low, high), jnp.maximum(low, high)
        near = jnp.maximum(near, enter)
        far = jnp.minimum(far, leave)
    return jnp.where((near < far) & (near > 0.05), near, _FAR_M)


def _tree_distance(tree: jax.Array, origin: jax.Array, ray: list[jax.Array]) -> jax.Array:
    """First hit of crown (sphere) or trunk (vertical cylinder); tree [V, 5], result [V, P]."""
    offset = [(tree[:, a] - origin[:, a])[:, None] for a in range(3)]
    aa = ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2
    b = ray[0] * offset[0] + ray[1] * offset[1] + ray[2] * offset[2]
    c = offset[0] ** 2 + offset[1] ** 2 + offset[2] ** 2 - tree[:, 3, None] ** 2
    inside = b * b - aa * c
    crown = (b - jnp.sqrt(jnp.maximum(inside, 0.0))) / aa
    crown = jnp.where((inside > 0) & (crown > 0.05), crown, _FAR_M)
    a2 = jnp.maximum(ray[0] ** 2 + ray[1] ** 2, 1e-9)
    b2 = ray[0] * offset[0] + ray[1] * offset[1]
    inside2 = b2 * b2 - a2 * (offset[0] ** 2 + offset[1] ** 2 - 0.22**2)
    trunk = (b2 - jnp.sqrt(jnp.maximum(inside2, 0.0))) / a2
    below_crown = ray[2] * trunk < offset[2]
    trunk = jnp.where((inside2 > 0) & (trunk > 0.05) & below_crown, trunk, _FAR_M)
    return jnp.minimum(crown, trunk)


def _first_hit(distances: list[jax.Array]) -> tuple[jax.Array, jax.Array]:
    """Smallest distance and its slot, as one minimum of integers: positive floats order like their bits."""
    mask = (1 << _SLOT_BITS) - 1
    best = None
    for slot, t in enumerate(distances):
        key = (jax.lax.bitcast_convert_type(t, jnp.int32) & ~mask) | slot
        best = key if best is None else jnp.minimum(best, key)
    assert best is not None
    return jax.lax.bitcast_convert_type(best & ~mask, jnp.float32), best & mask


def _lookup(rows: jax.Array, slot: jax.Array) -> list[jax.Array]:
    """Columns of the winning row of each pixel: rows [V, S, A], slot [V, P] -> A arrays [V, P]."""
    picked = jnp.take_along_axis(rows.swapaxes(1, 2), slot[:, None, :], axis=2)
    return [picked[:, a] for a in range(rows.shape[2])]


@jax.jit
def _sunlit(boxes: jax.Array, trees: jax.Array, hit: list[jax.Array]) -> jax.Array:
    """One where the sun reaches a point, zero in the shadow of a primitive of the view; [V, P]."""
    shadow = jnp.zeros_like(hit[0], dtype=bool)
    for i in range(boxes.shape[1]):
        near, far = jnp.full_like(hit[0], 0.05), jnp.full_like(hit[0], _FAR_M)
        for a in range(3):
            low = (boxes[:, i, a, None] - hit[a]) * (1 / SUN[a])
            high = (boxes[:, i, 3 + a, None] - hit[a]) * (1 / SUN[a])
            near = jnp.maximum(near, jnp.minimum(low, high))
            far = jnp.minimum(far, jnp.maximum(low, high))
        shadow = shadow | (near + 0.02 < far)
    for i in range(trees.shape[1]):
        offset = [trees[:, i, a, None] - hit[a] for a in range(3)]
        along = offset[0] * SUN[0] + offset[1] * SUN[1] + offset[2] * SUN[2]
        away = offset[0] ** 2 + offset[1] ** 2 + offset[2] ** 2 - along**2
        shadow = shadow | ((away < trees[:, i, 3, None] ** 2) & (along > trees[:, i, 3, None] + 0.1))
    return 1.0 - 0.8 * shadow.astype(jnp.float32)

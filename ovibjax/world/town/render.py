"""A ray-caster for the embedded town: colour, depth and semantic class of any camera pose, pure and jitted.

What a ray meets is found in `hits`; shading is arithmetic on the winner's row, with textures filtered by the pixel's
footprint so that small images do not alias.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ovibjax.runtime.batches import padded_batches
from ovibjax.world.rays import VIEW_YAW_DEG, pinhole_rays
from ovibjax.world.town.hits import (
    FAR_M,
    box_spheres,
    cull,
    first_of_groups,
    groups,
    hit_boxes,
    hit_trees,
    sunlit_by_groups,
    tree_spheres,
)
from ovibjax.world.town.layout import Town
from ovibjax.world.town.pieces import PIECE_PX, cut, joined
from ovibjax.world.town.route import Route
from ovibjax.world.town.shading import (
    SEMANTIC_CLASSES,
    shade_ground,
    shade_roof,
    shade_sky,
    shade_tree,
    shade_wall,
    towards_sun,
)
from ovibjax.world.town.style import Look

_BATCH = 2  # large poses per call: more are not faster, and each takes 0.4 GB of memory


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


FRAME_CAMERA = Camera(height_px=300, width_px=400, max_boxes=64, max_trees=24)
"""Images as large as the released ones; so large that a missing building shows, hence the higher limits."""


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


VIEW_PITCH_DEG = (-15.0, -15.0, -15.0, -15.0, -90.0)
"""Elevation of each camera, in the order of `views.VIEWS`."""


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
    shape = (positions_m.shape[0], 5, camera.height_px, camera.width_px)
    prepared = _prepare(town, jnp.asarray(positions_m), jnp.asarray(yaw_rad), camera)
    if camera.height_px * camera.width_px <= PIECE_PX:
        flat = _render_rays(town, camera, *prepared)
    else:
        pieces = [_render_rays(town, camera, *piece) for piece in cut(*prepared)]
        flat = jax.tree.map(lambda *parts: joined(parts, shape), *pieces)
    return Views(flat.rgb.reshape(*shape, 3), flat.depth_m.reshape(shape), flat.semantic.reshape(shape))


def _render_rays(
    town: Town, camera: Camera, origin: jax.Array, ray: list[jax.Array], boxes: jax.Array, trees: jax.Array
) -> Views:
    """Images [V, P] of the rays of V views."""
    box_groups, tree_groups = groups(boxes, Camera.max_boxes), groups(trees, Camera.max_trees)
    t_box, box = first_of_groups(hit_boxes, box_groups, origin, ray)
    t_tree, tree = first_of_groups(hit_trees, tree_groups, origin, ray)
    surface = _surface((t_box, t_tree), origin, ray, (box, tree), camera)
    look = town.look
    materials = (
        shade_wall(look, surface.hit, surface.box, surface.faces_x, ray, surface.footprint),
        shade_roof(surface.hit, surface.box, surface.footprint),
        shade_tree(look, surface.hit, surface.tree, surface.footprint),
        shade_ground(town, surface.hit, surface.slant),
        shade_sky(look, surface.direction, towards_sun(look, surface.direction)),
    )
    return _compose(look, surface, materials, sunlit_by_groups(look, box_groups, tree_groups, surface.hit))


def render_frames(
    town: Town, route: Route, frames: NDArray[np.int64], camera: Camera | None = None
) -> Iterator[tuple[int, Views]]:
    """Views of some frames of a drive, as large as the released images.

    Args:
        town: the town.
        route: the drive.
        frames: [n] which poses of the drive.
        camera: image size and culling limits; `FRAME_CAMERA` if None.

    Yields:
        Each frame with its views, [M, H, W] NumPy arrays; rendered in batches of one size.
    """
    camera = camera or FRAME_CAMERA
    # A small town has fewer buildings than the camera keeps.
    n_boxes, n_trees = len(town.boxes), len(town.trees)
    kept = (min(n_boxes, camera.max_boxes), min(n_trees, camera.max_trees))
    camera = replace(camera, max_boxes=kept[0], max_trees=kept[1])
    for count, batch in padded_batches(frames, _BATCH):
        poses = (jnp.asarray(route.positions_m[batch]), jnp.asarray(route.yaw_rad[batch]))
        views = [np.asarray(field) for field in render(town, *poses, camera)]
        for row, frame in enumerate(batch[:count].tolist()):
            yield frame, Views(*(field[row] for field in views))


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


@partial(jax.jit, static_argnames="camera")
def _prepare(
    town: Town, positions_m: jax.Array, yaw_rad: jax.Array, camera: Camera
) -> tuple[jax.Array, list[jax.Array], jax.Array, jax.Array]:
    """Origins [V, 3], rays 3 x [V, P], and the culled buildings and trees of each view."""
    axes = jax.vmap(camera_axes)(yaw_rad).reshape(-1, 3, 3)
    origin = jnp.repeat(positions_m, 5, axis=0)
    forward, right, up = ([axes[:, row, a] for a in range(3)] for row in range(3))
    ray = pinhole_rays(forward, right, up, camera.height_px, camera.width_px)
    near = jax.vmap(cull, (None, None, 0, 0, None))
    boxes = near(town.boxes, box_spheres(town.boxes), origin, axes, camera.max_boxes)
    return origin, ray, boxes, near(town.trees, tree_spheres(town.trees), origin, axes, camera.max_trees)


@partial(jax.jit, static_argnames="camera")
def _surface(
    distances: tuple[jax.Array, jax.Array],
    origin: jax.Array,
    ray: list[jax.Array],
    winners: tuple[list[jax.Array], list[jax.Array]],
    camera: Camera,
) -> _Surface:
    """Choose between building, tree, ground and sky, and gather what shading needs."""
    (t_box, t_tree), (box, tree) = distances, winners
    down = jnp.where(ray[2] < -1e-4, ray[2], -1e-4)
    t_ground = jnp.where(ray[2] < -1e-4, -origin[:, 2, None] / down, FAR_M)
    t_ground = jnp.where(t_ground > 900.0, FAR_M, t_ground)
    t = jnp.minimum(jnp.minimum(t_box, t_tree), t_ground)
    is_sky = t >= FAR_M / 2
    t_hit = jnp.where(is_sky, 900.0, t)
    hit = [origin[:, a, None] + t_hit * ray[a] for a in range(3)]
    length = jnp.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2)
    # Metres that one pixel covers on a surface facing the camera.
    footprint = t_hit * (2.0 / camera.width_px)
    wall_x = jnp.minimum(jnp.abs(hit[0] - box[0]), jnp.abs(hit[0] - box[3]))
    wall_y = jnp.minimum(jnp.abs(hit[1] - box[1]), jnp.abs(hit[1] - box[4]))
    return _Surface(
        depth_m=jnp.where(is_sky, FAR_M, t),
        is_box=(t_box <= jnp.minimum(t_tree, t_ground)) & ~is_sky,
        is_tree=(t_tree < jnp.minimum(t_box, t_ground)) & ~is_sky,
        is_sky=is_sky,
        on_roof=jnp.abs(hit[2] - box[5]) < jnp.minimum(wall_x, wall_y),
        faces_x=wall_x < wall_y,
        hit=hit,
        box=box,
        tree=tree,
        direction=[r / length for r in ray],
        footprint=footprint,
        slant=footprint * length / jnp.maximum(-ray[2], 0.08),
        range_m=t_hit * length,
    )


@jax.jit
def _compose(look: Look, surface: _Surface, materials: tuple[Any, ...], sunlit: jax.Array) -> Views:
    """Light, haze and gamma; the winner's colour of each pixel."""
    (wall_rgb, wall_light), roof_rgb, (tree_rgb, tree_light), (ground_rgb, ground_class), (sky_rgb, haze_rgb) = (
        materials
    )
    is_box, is_tree, is_sky, on_roof = surface.is_box, surface.is_tree, surface.is_sky, surface.on_roof
    light = jnp.where(is_box, jnp.where(on_roof, look.sun[2], wall_light), jnp.where(is_tree, tree_light, look.sun[2]))
    lit = jnp.maximum(light, 0.0) * sunlit
    fog = 1 - jnp.exp(-surface.range_m / look.haze_m)
    rgb = []
    for c, (sun, ambient) in enumerate(zip(look.sunlight, look.skylight, strict=True)):
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

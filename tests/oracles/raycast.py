"""First hit of one ray with the embedded town, over all of its primitives: no culling, no packing, float64.

Written from the description of the town (boxes, crowns on trunks, a ground plane with roads and pavements) and of the
rig (five pinhole cameras, 90 degrees wide), not from the renderer.
"""

import numpy as np

TRUNK_RADIUS_M = 0.22
HORIZON_M = 900.0  # ground further off than this counts as sky
RIG_DEG = {"Front": (0, -15), "Back": (180, -15), "Left": (90, -15), "Right": (-90, -15), "Down": (0, -90)}


def pixel_ray(view, yaw_rad, row, column, height_px, width_px):
    """Direction of a pixel's centre, scaled to unit depth along the optical axis; [3]."""
    turn, pitch = np.deg2rad(RIG_DEG[view])
    right_m = (column + 0.5) / width_px * 2 - 1
    up_m = (height_px / 2 - row - 0.5) / (width_px / 2)
    # In the body frame (x forward, y left, z up) the camera looks along x; first pitch it, then turn it.
    x, y, z = 1.0, -right_m, up_m
    x, z = x * np.cos(pitch) - z * np.sin(pitch), x * np.sin(pitch) + z * np.cos(pitch)
    angle = yaw_rad + turn
    return np.array([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle), z])


def box_hits(boxes, origin, ray):
    """Depths at which the ray enters each box (slab test), and whether it enters through the roof; [B], [B]."""
    with np.errstate(divide="ignore"):
        a, b = (boxes[:, :3] - origin) / ray, (boxes[:, 3:6] - origin) / ray
    enter, leave = np.minimum(a, b), np.maximum(a, b)
    depth = enter.max(axis=1)
    hits = (depth < leave.min(axis=1)) & (depth > 0)
    return np.where(hits, depth, np.inf), enter.argmax(axis=1) == 2


def _round_hits(offset, ray, radius):
    """Depths at which a ray enters spheres (three columns) or upright cylinders (two columns); [T]."""
    a, b, c = ray @ ray, offset @ ray, (offset**2).sum(axis=1) - radius**2
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (-b - np.sqrt(b * b - a * c)) / a  # NaN where the ray passes by
    return np.where(depth > 0, depth, np.inf)


def tree_hits(trees, origin, ray):
    """Depths at which the ray enters each crown, or the trunk below the crown's middle; [T]."""
    offset = origin - trees[:, :3]
    crown = _round_hits(offset, ray, trees[:, 3])
    trunk = _round_hits(offset[:, :2], ray[:2], TRUNK_RADIUS_M)
    with np.errstate(invalid="ignore"):
        level_m = origin[2] + trunk * ray[2]
    return np.minimum(crown, np.where(level_m < trees[:, 2], trunk, np.inf))


def ground_kind(town, x, y):
    """What the ground is made of at a point: road, sidewalk or terrain."""
    to_road = min(np.abs(town.road_x_m - x).min(), np.abs(town.road_y_m - y).min())
    if to_road < town.road_half_width_m:
        return "road"
    return "sidewalk" if to_road < town.road_half_width_m + town.pavement_m else "terrain"


def first_hit(town, origin, ray):
    """Depth and kind of the nearest thing on a ray; (inf, "sky") where there is none.

    Args:
        town: the town's arrays.
        origin: [3] metres.
        ray: [3], of unit depth along the optical axis.

    Returns:
        Depth in metres and one of building, roof, vegetation, road, sidewalk, terrain, sky.
    """
    best, kind = np.inf, "sky"
    if ray[2] < 0 and -origin[2] / ray[2] <= HORIZON_M:
        best = -origin[2] / ray[2]
        kind = ground_kind(town, *(origin + best * ray)[:2])
    box_depth, on_roof = box_hits(town.boxes.astype(np.float64), origin, ray)
    tree_depth = tree_hits(town.trees.astype(np.float64), origin, ray)
    nearest_box, nearest_tree = box_depth.argmin(), tree_depth.argmin()
    if box_depth[nearest_box] < best:
        best, kind = box_depth[nearest_box], "roof" if on_roof[nearest_box] else "building"
    if tree_depth[nearest_tree] < best:
        best, kind = tree_depth[nearest_tree], "vegetation"
    return best, kind

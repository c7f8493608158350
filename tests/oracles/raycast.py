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


def box_hit(box, origin, ray):
    """Depth at which the ray enters a box (slab test), and whether it enters through the roof."""
    with np.errstate(divide="ignore"):
        a, b = (box[:3] - origin) / ray, (box[3:6] - origin) / ray
    enter, leave = np.minimum(a, b), np.maximum(a, b)
    if enter.max() >= leave.min() or enter.max() <= 0:
        return np.inf, False
    return enter.max(), enter.argmax() == 2


def crown_hit(tree, origin, ray):
    """Depth at which the ray enters the sphere of leaves."""
    offset = origin - tree[:3]
    a, b, c = ray @ ray, ray @ offset, offset @ offset - tree[3] ** 2
    if b * b < a * c:
        return np.inf
    t = (-b - np.sqrt(b * b - a * c)) / a
    return t if t > 0 else np.inf


def trunk_hit(tree, origin, ray):
    """Depth at which the ray enters the vertical cylinder below the middle of the crown."""
    offset, level = (origin - tree[:3])[:2], ray[:2]
    a, b, c = level @ level, level @ offset, offset @ offset - TRUNK_RADIUS_M**2
    if a == 0 or b * b < a * c:
        return np.inf
    t = (-b - np.sqrt(b * b - a * c)) / a
    return t if t > 0 and origin[2] + t * ray[2] < tree[2] else np.inf


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
    for box in np.asarray(town.boxes, np.float64):
        t, on_roof = box_hit(box, origin, ray)
        if t < best:
            best, kind = t, "roof" if on_roof else "building"
    for tree in np.asarray(town.trees, np.float64):
        t = min(crown_hit(tree, origin, ray), trunk_hit(tree, origin, ray))
        if t < best:
            best, kind = t, "vegetation"
    return best, kind

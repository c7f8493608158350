"""Drives through an embedded room, and the poses of the cameras at each stop.

As in the paper's captures the platform visits target poses; at each it turns through the horizontal directions one
after the other, so the views of a frame are taken from slightly different places. Headings follow the room's axes up to
a few degrees ("pose-aligned views"). References come from parallel tracks, queries from a free walk of another day.
"""

from typing import NamedTuple

import numpy as np

from ovibjax.world.rays import VIEW_YAW_DEG
from ovibjax.world.rooms.room import Room, RoomConfig

TRACK_GAP_M = 1.25
"""Distance between reference tracks; set once, before anything was localized, so that the mean distance of a query to
its nearest reference lies near the paper's 0.32 m."""

_WALL_CLEARANCE_M = 0.42
_FURNITURE_CLEARANCE_M = 0.16
_LATERAL_M = 0.05  # how far the platform is off its target
_PLACE_M = 0.025  # how far a view is off the frame's pose: views are captured one after the other
_HEADING_DEG, _TURN_DEG = 2.0, 1.5  # of a frame, and of each view in it
_STEP_M = 0.02
_QUERY_SPACING_M = 0.3
_TRIES = 100_000
_REACH_M = 0.35  # furniture this far below or above the camera is no obstacle


class Drive(NamedTuple):
    """Frames of one drive through a room.

    Attributes:
        positions_m: [N, 3] float32 pose of the frame, as motion capture reports it.
        yaw_rad: [N] float32.
        origin_m: [N, M, 3] float32 where each view was taken.
        view_yaw_rad: [N, M] float32.
        view_pitch_rad: [N, M] float32.
    """

    positions_m: np.ndarray
    yaw_rad: np.ndarray
    origin_m: np.ndarray
    view_yaw_rad: np.ndarray
    view_pitch_rad: np.ndarray


def is_free(
    room: Room, config: RoomConfig, xy_m: np.ndarray, clearance_m: float = _FURNITURE_CLEARANCE_M
) -> np.ndarray:
    """Whether a platform may stand at points: away from walls, and from furniture near the camera's height.

    Args:
        room: the room.
        config: its description.
        xy_m: [N, 2] points.
        clearance_m: from furniture.

    Returns:
        [N] bool.
    """
    half = np.asarray(config.size_m[:2]) / 2 - _WALL_CLEARANCE_M
    boxes = room.boxes[room.boxes[:, 0] < 900]
    reach = _REACH_M + 2 * config.camera_spread_m
    boxes = boxes[(boxes[:, 5] > config.camera_m - reach) & (boxes[:, 2] < config.camera_m + reach)]
    low, high = boxes[:, :2] - clearance_m, boxes[:, 3:5] + clearance_m
    inside = ((xy_m[:, None] > low) & (xy_m[:, None] < high)).all(axis=2).any(axis=1)
    return (np.abs(xy_m) <= half).all(axis=1) & ~inside


def reference_drive(room: Room, config: RoomConfig) -> Drive:
    """Tracks along the room's length, driven to and fro; stops at equal distances on what is free of furniture.

    Args:
        room: the room.
        config: its description.

    Returns:
        `config.references` frames.
    """
    half = np.asarray(config.size_m[:2]) / 2 - _WALL_CLEARANCE_M
    tracks = np.linspace(-half[1], half[1], 1 + max(1, round(2 * half[1] / TRACK_GAP_M)))
    there = np.arange(-half[0], half[0], _STEP_M)
    path = [np.column_stack([there[:: (-1) ** i], np.full(len(there), y)]) for i, y in enumerate(tracks)]
    rng = np.random.default_rng([config.seed, config.n_views, 0x201])
    return _stops(rng, room, config, np.concatenate(path), config.references)


def query_drive(room: Room, config: RoomConfig) -> Drive:
    """A walk between random free points along free straight lines.

    Args:
        room: the room.
        config: its description.

    Returns:
        `config.queries` frames.

    Raises:
        ValueError: the room leaves no space for a walk.
    """
    rng = np.random.default_rng([config.seed, config.n_views, 0x202])
    half = np.asarray(config.size_m[:2]) / 2 - _WALL_CLEARANCE_M
    at, path, driven = np.zeros(2), [], 0.0
    for _ in range(_TRIES):
        if driven >= _QUERY_SPACING_M * config.queries:
            break
        goal = rng.uniform(-half, half)
        length = float(np.linalg.norm(goal - at))
        line = at + np.linspace(0, 1, max(2, round(length / _STEP_M)))[:, None] * (goal - at)
        # The walk starts wherever it first finds a free line; from there on it never leaves what is free.
        if length > 0.6 and is_free(room, config, line).all():
            path.append(line)
            driven += length
            at = goal
        elif not path:
            at = goal
    else:
        raise ValueError(f"room {config} leaves no space for a walk of {config.queries} stops")
    return _stops(rng, room, config, np.concatenate(path), config.queries)


def _stops(rng: np.random.Generator, room: Room, config: RoomConfig, path: np.ndarray, n: int) -> Drive:
    """Poses at equal distances on the free part of a path, and where each of their views was taken."""
    path = path[is_free(room, config, path)]
    xy = path[np.linspace(0, len(path) - 1, n).round().astype(int)]
    shifted = xy + np.clip(rng.normal(0, _LATERAL_M, (n, 2)), -0.12, 0.12)
    xy = np.where(is_free(room, config, shifted)[:, None], shifted, xy)
    z = config.camera_m + config.camera_spread_m * np.clip(rng.normal(size=n), -2, 2)
    position = np.column_stack([xy, z])
    yaw = np.deg2rad(_HEADING_DEG) * rng.normal(size=n)
    m = config.n_views
    place = np.clip(rng.normal(0, _PLACE_M, (n, m, 3)), -0.08, 0.08)
    place[..., 2] *= float(config.camera_spread_m > 0)
    turn = np.deg2rad(_TURN_DEG) * rng.normal(size=(n, m))
    if m == 5:  # front and downward views were captured together
        place[:, 4], turn[:, 4] = place[:, 0], turn[:, 0]
    pitch = np.deg2rad(np.array([config.pitch_deg] * 4 + [-90.0])[:m])
    arrays = (
        position,
        yaw,
        position[:, None] + place,
        yaw[:, None] + np.deg2rad(VIEW_YAW_DEG[:m]) + turn,
        np.broadcast_to(pitch, (n, m)),
    )
    return Drive(*(np.asarray(array, np.float32) for array in arrays))

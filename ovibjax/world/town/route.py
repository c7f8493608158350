"""Drives through the town, and the context of a place read off the town's geometry."""

from typing import NamedTuple

import numpy as np

from ovibjax.features.frames import CONTEXTS
from ovibjax.world.town.layout import Town, TownConfig

_KEEP_RIGHT_M = 2.2  # beside the road's axis
_TURN_M = 9.0  # a turn begins and ends this far from the crossing


class Route(NamedTuple):
    """Camera poses along a drive.

    Attributes:
        positions_m: [N, 3] float32.
        yaw_rad: [N] float32, heading.
    """

    positions_m: np.ndarray
    yaw_rad: np.ndarray


def make_route(
    town: Town, config: TownConfig, n_frames: int, seed: int, spacing_m: float = 1.6, max_turn_rad: float = 0.08
) -> Route:
    """A drive along the roads with turns at crossings, sampled at equal times.

    Args:
        town: the town to drive in.
        config: its description (flight height).
        n_frames: poses to return.
        seed: the drive; streams of other seeds are independent.
        spacing_m: distance flown between poses on a straight road (about half a second at 3 m/s).
        max_turn_rad: rotation between poses in a turn.

    Returns:
        The route; heading follows the road up to a few degrees, the lateral offset wanders by about a metre.
    """
    rng = np.random.default_rng([config.seed, seed, 0x10])
    corners = _walk_grid(rng, town, length_m=n_frames * spacing_m + 200.0)
    path = _round_corners(corners)
    step = np.diff(path, axis=0)
    turn = np.abs(np.angle(np.exp(1j * np.diff(np.arctan2(step[:, 1], step[:, 0]), prepend=0.0))))
    turn[0] = 0.0
    # A drone slows down in turns: the clock runs with distance or with rotation, whichever is slower.
    pace = np.maximum(np.hypot(step[:, 0], step[:, 1]) / spacing_m, turn / max_turn_rad)
    clock = np.concatenate([[0.0], np.cumsum(pace)])
    frame = np.arange(n_frames, dtype=np.float64)
    xy = np.stack([np.interp(frame, clock, path[:, axis]) for axis in (0, 1)], axis=1)
    ahead = np.stack([np.interp(frame + 0.5, clock, path[:, axis]) for axis in (0, 1)], axis=1)
    behind = np.stack([np.interp(frame - 0.5, clock, path[:, axis]) for axis in (0, 1)], axis=1)
    yaw = np.arctan2(*(ahead - behind).T[::-1])
    offset = -_KEEP_RIGHT_M + 0.9 * _wander(rng, n_frames, spacing_m, correlation_m=30.0)
    xy += offset[:, None] * np.stack([-np.sin(yaw), np.cos(yaw)], axis=1)
    yaw += np.deg2rad(2.5) * _wander(rng, n_frames, spacing_m, correlation_m=12.0)
    positions = np.column_stack([xy, np.full(n_frames, config.flight_height_m)])
    return Route(positions.astype(np.float32), np.angle(np.exp(1j * yaw)).astype(np.float32))


def _walk_grid(rng: np.random.Generator, town: Town, length_m: float) -> np.ndarray:
    """Corner points of a walk that never turns back, prefers roads driven least, and mostly goes straight on."""
    last = np.array([len(town.road_x_m), len(town.road_y_m)]) - 1
    node = np.array([rng.integers(last[0] + 1), rng.integers(last[1] + 1)])
    heading = np.array([0, 0])
    visits: dict[tuple[int, ...], int] = {}
    points: list[list[float]] = []
    driven = 0.0
    while driven < length_m or len(points) < 3:
        points.append([town.road_x_m[node[0]], town.road_y_m[node[1]]])
        moves = [np.array(move) for move in ((1, 0), (-1, 0), (0, 1), (0, -1))]
        moves = [m for m in moves if np.all(node + m >= 0) and np.all(node + m <= last) and np.any(m != -heading)]
        # Opposite directions of one street are different drives: they see it from different sides.
        straight = np.array([float(np.all(m == heading)) for m in moves])
        counts = np.array([visits.get((*node, *m), 0) for m in moves]) - 0.35 * straight
        counts = counts + rng.uniform(0, 0.7, len(moves))
        heading = moves[int(np.argmin(counts))]
        key = (*node.tolist(), *heading.tolist())
        visits[key] = visits.get(key, 0) + 1
        node = node + heading
        driven += abs(float(points[-1][0] - town.road_x_m[node[0]])) + abs(
            float(points[-1][1] - town.road_y_m[node[1]])
        )
    return np.array(points, np.float64)


def _round_corners(corners: np.ndarray) -> np.ndarray:
    """Replace each corner of a polyline by a quadratic curve between points before and after it."""
    t = np.linspace(0, 1, 13)[:, None]
    pieces = [corners[:1]]
    for a, b, c in zip(corners[:-2], corners[1:-1], corners[2:], strict=True):
        enter = b + _TURN_M * (a - b) / np.linalg.norm(a - b)
        leave = b + _TURN_M * (c - b) / np.linalg.norm(c - b)
        pieces.append((1 - t) ** 2 * enter + 2 * t * (1 - t) * b + t**2 * leave)
    pieces.append(corners[-1:])
    return np.concatenate(pieces)


def _wander(rng: np.random.Generator, n: int, spacing_m: float, correlation_m: float) -> np.ndarray:
    """A unit-variance Gauss-Markov sequence with the given correlation length."""
    keep = float(np.exp(-spacing_m / correlation_m))
    noise = rng.normal(size=n) * np.sqrt(1 - keep**2)
    value, out = rng.normal(), np.empty(n)
    for i in range(n):
        value = keep * value + noise[i]
        out[i] = value
    return out


def context_labels(town: Town, positions_m: np.ndarray, radius_m: float = 38.0) -> np.ndarray:
    """Scene context of each position, from the town's geometry alone.

    A position is an *intersection* inside the mouth of a crossing of two roads; otherwise it is *repetitive* where
    most buildings around it have two or more twins of the same size and look among them; otherwise it lies in a
    *corridor*, a street between distinct fronts.

    Args:
        town: the town.
        positions_m: [N, 3] positions.
        radius_m: how far a building is still "around".

    Returns:
        [N] int32 codes, indices into `CONTEXTS`.
    """
    xy = np.asarray(positions_m)[:, :2]
    mouth = float(town.road_half_width_m) + 4.0
    on_x_road = np.abs(xy[:, :1] - town.road_x_m).min(axis=1) < mouth
    on_y_road = np.abs(xy[:, 1:] - town.road_y_m).min(axis=1) < mouth
    size = town.boxes[:, 3:6] - town.boxes[:, :3]
    look = np.round(np.concatenate([size, town.boxes[:, 6:14]], axis=1), 2)
    _, kind = np.unique(look, axis=0, return_inverse=True)
    middle = (town.boxes[:, :2] + town.boxes[:, 3:5]) / 2
    near = np.linalg.norm(middle[None] - xy[:, None], axis=2) < radius_m
    counts = near.astype(np.float32) @ np.eye(kind.max() + 1, dtype=np.float32)[kind.ravel()]
    twins = np.where(counts >= 3, counts, 0).sum(axis=1) / np.maximum(counts.sum(axis=1), 1)
    corridor, intersection, repetitive = (CONTEXTS.index(c) for c in ("corridor", "intersection", "repetitive"))
    codes = np.where(on_x_road & on_y_road, intersection, np.where(twins > 0.6, repetitive, corridor))
    return codes.astype(np.int32)

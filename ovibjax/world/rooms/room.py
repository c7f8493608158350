"""Embedded rooms for the motion-capture experiments: walls, furniture and lamps as a pure function of a seed.

Coordinates are metres, origin in the middle of the floor, x along the room's length, z up; yaw is counter-clockwise
from x. Furniture comes from a few product lines per room, so that the same cabinet stands against several walls.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ovibjax.world.rooms.furniture import (
    ACCENT,
    WOOD,
    floor_and_ceiling_pieces,
    product,
    standing_pieces,
    wall_pieces,
)

BOX_COLUMNS: tuple[str, ...] = (*("x0", "y0", "z0", "x1", "y1", "z1"), *("red", "green", "blue", "look", "scale", "id"))
"""Columns of `Room.boxes`."""

DECOR_COLUMNS: tuple[str, ...] = ("face", "u0", "v0", "u1", "v1", "red", "green", "blue", "kind", "id")
"""Columns of `Room.decor`: rectangles on a face of the room."""

FACES: tuple[str, ...] = ("+x", "-x", "+y", "-y", "floor", "ceiling")
"""Faces of the room in the order of their codes; u runs along a wall and v = z, on floor and ceiling u = x, v = y."""

MAX_BOXES, MAX_DECOR = 56, 28
"""Rooms are padded to these, so that one renderer is compiled for all of them."""

_WALL = np.array([[0.86, 0.84, 0.79], [0.80, 0.84, 0.86], [0.88, 0.82, 0.74], [0.78, 0.82, 0.76]])


@dataclass(frozen=True)
class RoomConfig:
    """What a room is made from, and the platform that is driven through it; hashable, so that it names its cache.

    Attributes:
        seed: the room and its drives.
        size_m: length, width and height.
        n_views: cameras of the platform: 5 (UAV) or 4 (UGV).
        camera_m: mean camera height.
        camera_spread_m: standard deviation of the camera height along a drive.
        pitch_deg: of the horizontal cameras.
        references: frames of the reference drive.
        queries: frames of the query drive.
    """

    seed: int = 0
    size_m: tuple[float, float, float] = (4.1, 4.0, 2.7)
    n_views: int = 5
    camera_m: float = 1.2
    camera_spread_m: float = 0.08
    pitch_deg: float = -10.0
    references: int = 76
    queries: int = 58


def platform_room(platform: str, seed: int) -> RoomConfig:
    """The paper's room of a platform (Table "Datasets": indoor UAV and indoor UGV).

    Args:
        platform: "uav" (4.1 m x 4.0 m, five views, 76 / 58 frames) or "ugv" (5.0 m x 4.0 m, four views, 78 / 72).
        seed: the room.

    Returns:
        Its description.

    Raises:
        ValueError: unknown platform.
    """
    if platform == "uav":
        return RoomConfig(seed)
    if platform != "ugv":
        raise ValueError(f"platform {platform!r} is not uav or ugv")
    return RoomConfig(seed, (5.0, 4.0, 2.7), 4, 0.3, 0.0, 0.0, 78, 72)


class Room(NamedTuple):
    """A room as arrays, ready for the renderer.

    Attributes:
        size_m: [3] length, width, height.
        boxes: [MAX_BOXES, 12] float32 furniture, columns as in `BOX_COLUMNS`; unused rows are empty boxes.
        decor: [MAX_DECOR, 10] float32, columns as in `DECOR_COLUMNS`; unused rows have face -1.
        paint: [6, 3] float32 colour of each face.
        floor_kind: scalar, 0 planks, 1 tiles, 2 carpet.
    """

    size_m: Any
    boxes: Any
    decor: Any
    paint: Any
    floor_kind: Any


def make_room(config: RoomConfig) -> Room:
    """Furnish a room from its seed.

    Args:
        config: the room's description.

    Returns:
        The room; equal configs give equal arrays.
    """
    rng = np.random.default_rng([config.seed, round(config.size_m[0] * 1000), 0x200])
    wall = _WALL[rng.integers(len(_WALL))]
    paint = np.stack([wall * rng.uniform(0.92, 1.04) for _ in range(6)])
    paint[rng.integers(4)] = 0.35 * wall + 0.65 * ACCENT[rng.integers(len(ACCENT))]
    paint[4] = [WOOD[rng.integers(3)], [0.55, 0.54, 0.52], [0.36, 0.38, 0.42]][floor_kind := int(rng.integers(3))]
    paint[5] = 0.93
    products = [product(rng) for _ in range(3)]
    order = rng.permutation(["window", "door", "board", "posters"])
    boxes, decor = [], []
    for face, theme in enumerate(order):
        wall_boxes, wall_decor = wall_pieces(rng, config.size_m, face, str(theme), products)
        boxes += wall_boxes
        decor += wall_decor
    boxes += standing_pieces(rng, config.size_m)
    decor += floor_and_ceiling_pieces(rng, config.size_m)
    box_table = np.zeros((MAX_BOXES, len(BOX_COLUMNS)))
    box_table[:, :3] = 1e3  # an empty box far away: no ray hits it
    box_table[:, 3:6] = 1e3
    box_table[: len(boxes), :11] = np.stack(boxes)
    half = np.array(config.size_m[:2]) / 2
    for columns in ([0, 1], [3, 4]):  # leaves end at the wall
        box_table[: len(boxes), columns] = np.clip(box_table[: len(boxes), columns], -half, half)
    box_table[:, 11] = np.arange(MAX_BOXES)
    decor_table = np.full((MAX_DECOR, len(DECOR_COLUMNS)), -1.0)
    decor_table[: len(decor), :9] = np.stack(decor)
    decor_table[:, 9] = np.arange(MAX_DECOR) + 10 * config.seed % 97
    arrays = (config.size_m, box_table, decor_table, np.clip(paint, 0.05, 0.97), floor_kind)
    return Room(*(np.asarray(array, np.float32) for array in arrays))

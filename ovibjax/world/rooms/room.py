"""Embedded rooms for the motion-capture experiments: walls, furniture and lamps as a pure function of a seed.

Coordinates are metres, origin in the middle of the floor, x along the room's length, z up; yaw is counter-clockwise
from x. Furniture comes from a few product lines per room, so that the same cabinet stands against several walls.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

BOX_COLUMNS: tuple[str, ...] = (*("x0", "y0", "z0", "x1", "y1", "z1"), *("red", "green", "blue", "look", "scale", "id"))
"""Columns of `Room.boxes`."""

LOOKS: tuple[str, ...] = ("plain", "books", "drawers", "fabric", "leaves", "screen")
"""What the sides of a box show, in the order of their codes."""

DECOR_COLUMNS: tuple[str, ...] = ("face", "u0", "v0", "u1", "v1", "red", "green", "blue", "kind", "id")
"""Columns of `Room.decor`: rectangles on a face of the room."""

FACES: tuple[str, ...] = ("+x", "-x", "+y", "-y", "floor", "ceiling")
"""Faces of the room in the order of their codes; u runs along a wall and v = z, on floor and ceiling u = x, v = y."""

KINDS: tuple[str, ...] = ("poster", "window", "door", "board", "curtain", "rug", "lamp", "tape")
"""Kinds of decoration, in the order of their codes."""

MAX_BOXES, MAX_DECOR = 56, 28
"""Rooms are padded to these, so that one renderer is compiled for all of them."""

_WOOD = np.array([[0.62, 0.45, 0.28], [0.80, 0.72, 0.58], [0.36, 0.25, 0.18], [0.86, 0.85, 0.83], [0.24, 0.26, 0.29]])
_ACCENT = np.array(
    [
        *([0.12, 0.32, 0.52], [0.72, 0.24, 0.18], [0.90, 0.68, 0.18], [0.16, 0.46, 0.36], [0.48, 0.28, 0.52]),
        *([0.84, 0.46, 0.22], [0.30, 0.58, 0.72], [0.78, 0.52, 0.58]),
    ]
)
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
    paint[rng.integers(4)] = 0.35 * wall + 0.65 * _ACCENT[rng.integers(len(_ACCENT))]
    paint[4] = [_WOOD[rng.integers(3)], [0.55, 0.54, 0.52], [0.36, 0.38, 0.42]][floor_kind := int(rng.integers(3))]
    paint[5] = 0.93
    products = [_product(rng) for _ in range(3)]
    order = rng.permutation(["window", "door", "board", "posters"])
    boxes, decor = [], []
    for face, theme in enumerate(order):
        wall_boxes, wall_decor = _furnish(rng, config, face, str(theme), products)
        boxes += wall_boxes
        decor += wall_decor
    boxes += _standing(rng, config)
    decor += _floor_and_ceiling(rng, config)
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


def _product(rng: np.random.Generator) -> np.ndarray:
    """One line of furniture: width, depth, height, rgb, look, scale."""
    look = LOOKS.index(str(rng.choice(["books", "drawers", "books", "plain"])))
    width = rng.uniform(0.55, 0.9)
    height = rng.uniform(1.3, 2.0) if look == LOOKS.index("books") else rng.uniform(0.6, 1.0)
    colour = _WOOD[rng.integers(len(_WOOD))] * rng.uniform(0.85, 1.1)
    depth, scale = rng.uniform(0.26, 0.38), rng.uniform(0.24, 0.36)
    return np.array([width, depth, height, *np.clip(colour, 0.05, 0.95), look, scale])


def _against(config: RoomConfig, face: int, u: tuple[float, float], depth: tuple[float, float]) -> np.ndarray:
    """Footprint x0, y0, x1, y1 of something along a wall: u along it, depth away from it."""
    half = config.size_m[face // 2] / 2
    near, far = sorted(((half - depth[0]) * (-1) ** face, (half - depth[1]) * (-1) ** face))
    return np.array([near, u[0], far, u[1]] if face < 2 else [u[0], near, u[1], far])


def _box(foot: np.ndarray, z: tuple[float, float], colour: np.ndarray, look: str = "plain", scale: float = 0.3) -> Any:
    return np.array([foot[0], foot[1], z[0], foot[2], foot[3], z[1], *colour, LOOKS.index(look), scale])


def _furnish(
    rng: np.random.Generator, config: RoomConfig, face: int, theme: str, products: list[np.ndarray]
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """One wall: what hangs on it, and what stands before it."""
    span = config.size_m[1 - face // 2] / 2
    height = config.size_m[2]
    boxes: list[np.ndarray] = []
    decor: list[np.ndarray] = []
    blocked: list[tuple[float, float]] = []  # stretches of the wall before which nothing tall may stand

    def hang(kind: str, u: float, v: float, width: float, tall: float, colour: np.ndarray) -> None:
        decor.append(np.array([face, u, v, u + width, v + tall, *colour, KINDS.index(kind)]))

    if theme == "door":
        at = float(rng.uniform(-span + 0.7, span - 1.6))
        hang("door", at, 0.0, 0.9, 2.05, _WOOD[rng.integers(len(_WOOD))])
        blocked.append((at - 0.1, at + 1.0))
    elif theme == "window":
        at, width = float(rng.uniform(-span + 0.5, -span + 1.0)), float(rng.uniform(1.5, 2.0))
        hang("window", at, 0.9, width, 1.3, np.array([0.62, 0.78, 0.95]))
        curtain = _ACCENT[rng.integers(len(_ACCENT))] * 0.6 + 0.35
        hang("curtain", at - 0.35, 0.25, 0.35, 2.1, curtain)
        hang("curtain", at + width, 0.25, 0.35, 2.1, curtain)
        blocked.append((at - 0.35, at + width + 0.35))
    elif theme == "board":
        at, width = float(rng.uniform(-span + 0.4, -0.2)), float(rng.uniform(1.2, 1.7))
        hang("board", at, 1.0, width, 0.95, np.array([0.94, 0.95, 0.95]))
        blocked.append((at, at + width))
    along = -span + rng.uniform(0.1, 0.5)
    while True:
        width, depth, tall, *colour, look, scale = products[rng.integers(3)]
        if along + width > span - 0.45:
            break
        u = (along, along + width)
        free = all(u[1] <= low or u[0] >= high for low, high in blocked)
        low_enough = theme in ("window", "board") and tall < 0.85
        if (free or low_enough) and rng.random() < 0.8 and len(boxes) < 9:
            foot = _against(config, face, u, (0.0, depth))
            boxes.append(_box(foot, (0.0, tall), np.array(colour), LOOKS[int(look)], scale))
            if tall < 1.1 and rng.random() < 0.6:
                boxes += _on_top(rng, foot, tall)
        elif free and rng.random() < 0.8:
            tint = _ACCENT[rng.integers(len(_ACCENT))]
            hang("poster", along, rng.uniform(1.05, 1.35), min(width, 0.6), rng.uniform(0.6, 0.85), tint)
        along += width + float(rng.choice([0.0, 0.08, 0.4]))
    # High up there is always room: a row of small prints above everything else.
    for _ in range(2):
        tint = _ACCENT[rng.integers(len(_ACCENT))]
        hang("poster", float(rng.uniform(-span + 0.1, span - 0.6)), height - 0.52, rng.uniform(0.3, 0.5), 0.4, tint)
    return boxes, decor


def _on_top(rng: np.random.Generator, foot: np.ndarray, z: float) -> list[np.ndarray]:
    """A screen, a plant or a parcel on a cabinet."""
    middle = np.array([foot[0] + foot[2], foot[1] + foot[3]]) / 2
    kind = rng.integers(3)
    half = np.array([[0.04, 0.2], [0.09, 0.09], [0.13, 0.1]][kind])
    half = half if foot[2] - foot[0] < foot[3] - foot[1] else half[::-1]
    spot = np.concatenate([middle - half, middle + half])
    if kind == 0:
        return [_box(spot, (z + 0.05, z + 0.34), np.array([0.1, 0.11, 0.13]), "screen")]
    if kind == 1:
        pot = _box(spot, (z, z + 0.14), _ACCENT[rng.integers(len(_ACCENT))])
        wide = spot + np.array([-0.05, -0.05, 0.05, 0.05])
        return [pot, _box(wide, (z + 0.14, z + 0.42), np.array([0.18, 0.42, 0.16]), "leaves", 0.06)]
    return [_box(spot, (z, z + rng.uniform(0.12, 0.24)), np.array([0.70, 0.55, 0.36]))]


def _standing(rng: np.random.Generator, config: RoomConfig) -> list[np.ndarray]:
    """Low things in the open, and the motion-capture cameras under the ceiling's corners."""
    length, width, height = config.size_m
    boxes = []
    for _ in range(2):
        size = rng.uniform(0.28, 0.42)
        x, y = rng.uniform(-0.25, 0.25, 2) * np.array([length, width])
        foot = np.array([x, y, x + size, y + size])
        look = str(rng.choice(["fabric", "plain"]))
        boxes.append(_box(foot, (0.0, rng.uniform(0.25, 0.45)), _ACCENT[rng.integers(len(_ACCENT))], look))
    for sx in (-1, 1):
        for sy in (-1, 1):
            x, y = sx * (length / 2 - 0.15), sy * (width / 2 - 0.15)
            foot = np.array([x - 0.06, y - 0.06, x + 0.06, y + 0.06])
            boxes.append(_box(foot, (height - 0.35, height - 0.2), np.array([0.12, 0.14, 0.2]), "screen"))
    return boxes


def _floor_and_ceiling(rng: np.random.Generator, config: RoomConfig) -> list[np.ndarray]:
    """A rug, the taped frame of the captured volume, and lamps."""
    length, width, _ = config.size_m
    rug = rng.uniform(0.4, 0.6, 2) * np.array([length, width])
    corner = rng.uniform(-0.9, 0.9, 2) * (np.array([length, width]) - rug) / 2 - rug / 2
    rows = [[4, *corner, *(corner + rug), *_ACCENT[rng.integers(len(_ACCENT))], KINDS.index("rug")]]
    frame = np.array([length, width]) / 2 - 0.42
    rows.append([4, *-frame, *frame, 0.95, 0.85, 0.2, KINDS.index("tape")])
    for x in lamp_x_m(length):
        rows.append([5, x - 0.3, -0.6, x + 0.3, 0.6, 1.0, 0.98, 0.94, KINDS.index("lamp")])
    return [np.array(row, float) for row in rows]


def lamp_x_m(length_m: float) -> tuple[float, float]:
    """Positions along the room of its two ceiling lamps, both in the middle of its width."""
    return (-length_m / 4, length_m / 4)

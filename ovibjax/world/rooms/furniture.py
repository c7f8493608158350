"""What stands, hangs and lies in an embedded room, drawn at random: cabinets, pictures, doors, rugs and lamps."""

from typing import Any

import numpy as np

LOOKS: tuple[str, ...] = ("plain", "books", "drawers", "fabric", "leaves", "screen")
"""What the sides of a box show, in the order of their codes."""

KINDS: tuple[str, ...] = ("poster", "window", "door", "board", "curtain", "rug", "lamp", "tape")
"""Kinds of decoration, in the order of their codes."""

WOOD = np.array([[0.62, 0.45, 0.28], [0.80, 0.72, 0.58], [0.36, 0.25, 0.18], [0.86, 0.85, 0.83], [0.24, 0.26, 0.29]])
"""Colours of boards."""

ACCENT = np.array(
    [
        *([0.12, 0.32, 0.52], [0.72, 0.24, 0.18], [0.90, 0.68, 0.18], [0.16, 0.46, 0.36], [0.48, 0.28, 0.52]),
        *([0.84, 0.46, 0.22], [0.30, 0.58, 0.72], [0.78, 0.52, 0.58]),
    ]
)
"""Colours of cloth, pots and pictures."""

Size = tuple[float, float, float]
"""Length, width and height of a room in metres."""


def product(rng: np.random.Generator) -> np.ndarray:
    """One line of furniture: width, depth, height, rgb, look, scale."""
    look = LOOKS.index(str(rng.choice(["books", "drawers", "books", "plain"])))
    width = rng.uniform(0.55, 0.9)
    height = rng.uniform(1.3, 2.0) if look == LOOKS.index("books") else rng.uniform(0.6, 1.0)
    colour = WOOD[rng.integers(len(WOOD))] * rng.uniform(0.85, 1.1)
    depth, scale = rng.uniform(0.26, 0.38), rng.uniform(0.24, 0.36)
    return np.array([width, depth, height, *np.clip(colour, 0.05, 0.95), look, scale])


def _against(size_m: Size, face: int, u: tuple[float, float], depth: tuple[float, float]) -> np.ndarray:
    """Footprint x0, y0, x1, y1 of something along a wall: u along it, depth away from it."""
    half = size_m[face // 2] / 2
    near, far = sorted(((half - depth[0]) * (-1) ** face, (half - depth[1]) * (-1) ** face))
    return np.array([near, u[0], far, u[1]] if face < 2 else [u[0], near, u[1], far])


def _box(foot: np.ndarray, z: tuple[float, float], colour: np.ndarray, look: str = "plain", scale: float = 0.3) -> Any:
    return np.array([foot[0], foot[1], z[0], foot[2], foot[3], z[1], *colour, LOOKS.index(look), scale])


def wall_pieces(
    rng: np.random.Generator, size_m: Size, face: int, theme: str, products: list[np.ndarray]
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """One wall: what hangs on it, and what stands before it."""
    span = size_m[1 - face // 2] / 2
    height = size_m[2]
    boxes: list[np.ndarray] = []
    decor: list[np.ndarray] = []
    blocked: list[tuple[float, float]] = []  # stretches of the wall before which nothing tall may stand

    def hang(kind: str, u: float, v: float, width: float, tall: float, colour: np.ndarray) -> None:
        decor.append(np.array([face, u, v, u + width, v + tall, *colour, KINDS.index(kind)]))

    if theme == "door":
        at = float(rng.uniform(-span + 0.7, span - 1.6))
        hang("door", at, 0.0, 0.9, 2.05, WOOD[rng.integers(len(WOOD))])
        blocked.append((at - 0.1, at + 1.0))
    elif theme == "window":
        at, width = float(rng.uniform(-span + 0.5, -span + 1.0)), float(rng.uniform(1.5, 2.0))
        hang("window", at, 0.9, width, 1.3, np.array([0.62, 0.78, 0.95]))
        curtain = ACCENT[rng.integers(len(ACCENT))] * 0.6 + 0.35
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
            foot = _against(size_m, face, u, (0.0, depth))
            boxes.append(_box(foot, (0.0, tall), np.array(colour), LOOKS[int(look)], scale))
            if tall < 1.1 and rng.random() < 0.6:
                boxes += _on_top(rng, foot, tall)
        elif free and rng.random() < 0.8:
            tint = ACCENT[rng.integers(len(ACCENT))]
            hang("poster", along, rng.uniform(1.05, 1.35), min(width, 0.6), rng.uniform(0.6, 0.85), tint)
        along += width + float(rng.choice([0.0, 0.08, 0.4]))
    # High up there is always room: a row of small prints above everything else.
    for _ in range(2):
        tint = ACCENT[rng.integers(len(ACCENT))]
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
        pot = _box(spot, (z, z + 0.14), ACCENT[rng.integers(len(ACCENT))])
        wide = spot + np.array([-0.05, -0.05, 0.05, 0.05])
        return [pot, _box(wide, (z + 0.14, z + 0.42), np.array([0.18, 0.42, 0.16]), "leaves", 0.06)]
    return [_box(spot, (z, z + rng.uniform(0.12, 0.24)), np.array([0.70, 0.55, 0.36]))]


def standing_pieces(rng: np.random.Generator, size_m: Size) -> list[np.ndarray]:
    """Low things in the open, and the motion-capture cameras under the ceiling's corners."""
    length, width, height = size_m
    boxes = []
    for _ in range(2):
        size = rng.uniform(0.28, 0.42)
        x, y = rng.uniform(-0.25, 0.25, 2) * np.array([length, width])
        foot = np.array([x, y, x + size, y + size])
        look = str(rng.choice(["fabric", "plain"]))
        boxes.append(_box(foot, (0.0, rng.uniform(0.25, 0.45)), ACCENT[rng.integers(len(ACCENT))], look))
    for sx in (-1, 1):
        for sy in (-1, 1):
            x, y = sx * (length / 2 - 0.15), sy * (width / 2 - 0.15)
            foot = np.array([x - 0.06, y - 0.06, x + 0.06, y + 0.06])
            boxes.append(_box(foot, (height - 0.35, height - 0.2), np.array([0.12, 0.14, 0.2]), "screen"))
    return boxes


def floor_and_ceiling_pieces(rng: np.random.Generator, size_m: Size) -> list[np.ndarray]:
    """A rug, the taped frame of the captured volume, and lamps."""
    length, width, _ = size_m
    rug = rng.uniform(0.4, 0.6, 2) * np.array([length, width])
    corner = rng.uniform(-0.9, 0.9, 2) * (np.array([length, width]) - rug) / 2 - rug / 2
    rows = [[4, *corner, *(corner + rug), *ACCENT[rng.integers(len(ACCENT))], KINDS.index("rug")]]
    frame = np.array([length, width]) / 2 - 0.42
    rows.append([4, *-frame, *frame, 0.95, 0.85, 0.2, KINDS.index("tape")])
    for x in lamp_x_m(length):
        rows.append([5, x - 0.3, -0.6, x + 0.3, 0.6, 1.0, 0.98, 0.94, KINDS.index("lamp")])
    return [np.array(row, float) for row in rows]


def lamp_x_m(length_m: float) -> tuple[float, float]:
    """Positions along the room of its two ceiling lamps, both in the middle of its width."""
    return (-length_m / 4, length_m / 4)

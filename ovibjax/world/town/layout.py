"""The embedded town: roads, blocks, buildings and trees as a pure function of a seed.

Coordinates are metres in a right-handed frame (x east, y north, z up); yaw is counter-clockwise from x. Districts
give the town the three kinds of place the paper's routes have: street canyons, crossings, and rows of identical
houses, whose perceptual aliasing makes front-only localization fail.
"""

import itertools
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ovibjax.world.town.style import DEFAULT_LOOK, TownStyle, make_style

# Columns of `Town.boxes`: what the renderer needs to know of one building.
BOX_COLUMNS: tuple[str, ...] = (
    *("x0", "y0", "z0", "x1", "y1", "z1"),
    *("red", "green", "blue", "bay_m", "storey_m", "glass_share", "glass_tone", "roof_tone", "id"),
)
TREE_COLUMNS: tuple[str, ...] = ("x", "y", "z", "radius", "tone")


@dataclass(frozen=True)
class TownConfig:
    """What a town is made from; hashable, so that it names its cache.

    Attributes:
        seed: the town; another seed is another town.
        size_m: distance between the outermost roads.
        block_m: mean distance between neighbouring roads.
        road_half_width_m: half the carriageway.
        pavement_m: width of the pavement.
        flight_height_m: camera height of every route.
        style: how the town looks, not negative (`style.make_style`); 0 is the look of the default town.
    """

    seed: int = 5
    size_m: float = 400.0
    block_m: float = 57.0
    road_half_width_m: float = 5.5
    pavement_m: float = 2.5
    flight_height_m: float = 20.0
    style: int = 0


class Town(NamedTuple):
    """A town as arrays, ready for the renderer; NumPy as made, JAX inside it.

    Attributes:
        boxes: [B, 15] float32 buildings, columns as in `BOX_COLUMNS`.
        trees: [T, 5] float32 tree crowns, columns as in `TREE_COLUMNS`.
        road_x_m: [R] x of the roads that run along y.
        road_y_m: [R] y of the roads that run along x.
        lawn: [R+1, R+1] float32, one where the block between roads is grass.
        road_half_width_m: scalar.
        pavement_m: scalar.
        look: colours and light, `style.Look`.
    """

    boxes: Any
    trees: Any
    road_x_m: Any
    road_y_m: Any
    lawn: Any
    road_half_width_m: Any
    pavement_m: Any
    look: Any = DEFAULT_LOOK


def make_town(config: TownConfig) -> Town:
    """Build a town from its seed.

    Args:
        config: the town's description.

    Returns:
        The town; equal configs give equal arrays.
    """
    rng, style = np.random.default_rng([config.seed, 0x70]), make_style(config.style)
    road_x, road_y = _road_lines(rng, config), _road_lines(rng, config)
    inset = config.road_half_width_m + config.pavement_m
    # One ring of blocks outside the last road, so that no street ends in nothing.
    edges_x = np.concatenate([[road_x[0] - config.block_m], road_x, [road_x[-1] + config.block_m]])
    edges_y = np.concatenate([[road_y[0] - config.block_m], road_y, [road_y[-1] + config.block_m]])
    centres = rng.uniform(-0.55, 0.55, (13, 2)) * config.size_m
    kinds = ["canyon", "terrace", "mixed", "canyon", "terrace", "park", "canyon", "terrace", "sheds", "mixed"]
    kinds += ["canyon", "mixed", "terrace"]
    # Four house types serve the whole town: the same row stands in several places.
    house_types = [_facade(rng, style, height_m=rng.uniform(6.5, 9.5), house=True) for _ in range(4)]
    boxes: list[np.ndarray] = []
    trees: list[np.ndarray] = []
    lawn = np.zeros((len(edges_x) - 1, len(edges_y) - 1), np.float32)
    for i in range(len(edges_x) - 1):
        for j in range(len(edges_y) - 1):
            lot = np.array([edges_x[i], edges_y[j], edges_x[i + 1], edges_y[j + 1]])
            lot += np.array([inset, inset, -inset, -inset])
            middle = (lot[:2] + lot[2:]) / 2
            nearest = int(np.argmin(np.linalg.norm(centres - middle, axis=1)))
            kind = kinds[nearest]
            lawn[i, j] = kind in ("park", "terrace")
            block_boxes, block_trees = _FILL[kind](rng, style, lot, house_types[nearest % len(house_types)])
            boxes += block_boxes
            trees += block_trees
    table = np.stack(boxes).astype(np.float32)
    table[:, -1] = np.arange(len(table))
    return Town(
        boxes=table,
        trees=np.stack(trees).astype(np.float32),
        road_x_m=road_x.astype(np.float32),
        road_y_m=road_y.astype(np.float32),
        lawn=lawn,
        road_half_width_m=np.asarray(config.road_half_width_m, np.float32),
        pavement_m=np.asarray(config.pavement_m, np.float32),
        look=style.look,
    )


def _road_lines(rng: np.random.Generator, config: TownConfig) -> np.ndarray:
    gaps = rng.uniform(0.75, 1.25, max(2, round(config.size_m / config.block_m)))
    lines = np.concatenate([[0.0], np.cumsum(gaps)])
    return (lines / lines[-1] - 0.5) * config.size_m


def _facade(rng: np.random.Generator, style: TownStyle, height_m: float, house: bool = False) -> np.ndarray:
    """Height and look of one building: [height, rgb, bay, storey, glass share, glass tone, roof tone]."""
    colour = style.palette[rng.integers(len(style.palette))] * rng.uniform(0.8, 1.12) + rng.normal(0, 0.02, 3)
    share = rng.uniform(0.25, 0.4) if house else rng.choice([0.35, 0.5, 0.65, 0.9])
    bay = rng.uniform(2.2, 3.2) if house else rng.uniform(2.0, 5.0)
    storey = rng.uniform(2.7, 3.8)
    look = [bay * style.bay, storey * style.storey, min(share * style.window, 0.95)]
    look += [rng.uniform(0.12, 0.5), rng.uniform(0.15, 0.75)]
    return np.array([height_m * style.height, *np.clip(colour, 0.08, 0.95), *look])


def _box(lot: np.ndarray, facade: np.ndarray, base_m: float = 0.0) -> np.ndarray:
    return np.array([lot[0], lot[1], base_m, lot[2], lot[3], base_m + facade[0], *facade[1:], 0.0])


def _tree(rng: np.random.Generator, style: TownStyle, x: float, y: float) -> np.ndarray:
    radius = rng.uniform(1.4, 3.0) * style.crown
    return np.array([x, y, radius + rng.uniform(1.6, 3.4), radius, rng.uniform(0.0, 1.0)])


Fill = tuple[list[np.ndarray], list[np.ndarray]]


def _fill_canyon(rng: np.random.Generator, style: TownStyle, lot: np.ndarray, _: np.ndarray) -> Fill:
    """Tall fronts wall to wall around a court."""
    boxes: list[np.ndarray] = []
    depth = min(14.0, (lot[2] - lot[0]) / 2 - 1, (lot[3] - lot[1]) / 2 - 1)
    for side in range(4):
        horizontal = side < 2
        start, stop = (lot[0], lot[2]) if horizontal else (lot[1] + depth, lot[3] - depth)
        at = start
        while at < stop - 4:
            width = min(rng.uniform(9, 19), stop - at)
            if stop - at - width < 6:
                width = stop - at
            near = [lot[1], lot[3] - depth, lot[0], lot[2] - depth][side]
            parts = [at, near, at + width, near + depth] if horizontal else [near, at, near + depth, at + width]
            plot = np.array(parts)
            facade = _facade(rng, style, height_m=rng.uniform(13, 34))
            boxes.append(_box(plot, facade))
            if rng.random() < 0.3 and width > 8:
                crown = _facade(rng, style, height_m=rng.uniform(4, 12))
                crown[1:4] = facade[1:4]
                boxes.append(_box(plot + np.array([2.5, 2.5, -2.5, -2.5]), crown, base_m=facade[0]))
            at += width
    trees = _street_trees(rng, style, lot, 0, 4)
    return boxes, trees


def _fill_terrace(rng: np.random.Generator, style: TownStyle, lot: np.ndarray, house: np.ndarray) -> Fill:
    """Rows of one and the same house, front gardens between them and the road."""
    boxes = []
    for row, (y0, y1) in enumerate([(lot[1] + 3, lot[1] + 13), (lot[3] - 13, lot[3] - 3)]):
        for x in np.arange(lot[0] + 2, lot[2] - 10, 12.0):
            boxes.append(_box(np.array([x, y0, x + 9.0, y1]), house))
            if row == 0 and lot[3] - lot[1] > 44:
                boxes.append(_box(np.array([x, (lot[1] + lot[3]) / 2 - 5, x + 9.0, (lot[1] + lot[3]) / 2 + 5]), house))
    trees = _street_trees(rng, style, lot, 1, 4)
    return boxes, trees


def _fill_mixed(rng: np.random.Generator, style: TownStyle, lot: np.ndarray, _: np.ndarray) -> Fill:
    """Free-standing buildings of every size on a grid of plots."""
    boxes = []
    nx, ny = max(1, int((lot[2] - lot[0]) // 17)), max(1, int((lot[3] - lot[1]) // 17))
    step = np.array([(lot[2] - lot[0]) / nx, (lot[3] - lot[1]) / ny])
    trees = _street_trees(rng, style, lot, 2, 6)
    for i in range(nx):
        for j in range(ny):
            corner = lot[:2] + step * np.array([i, j])
            if rng.random() < 0.16:
                trees += [_tree(rng, style, *(corner + step * rng.uniform(0.2, 0.8, 2))) for _ in range(2)]
                continue
            margin = rng.uniform(0.5, 3.5, 4)
            plot = np.concatenate([corner + margin[:2], corner + step - margin[2:]])
            height_m = rng.choice([5, 8, 12, 18, 26]) * rng.uniform(0.8, 1.2)
            boxes.append(_box(plot, _facade(rng, style, height_m)))
    return boxes, trees


def _fill_park(rng: np.random.Generator, style: TownStyle, lot: np.ndarray, house: np.ndarray) -> Fill:
    """Lawn, trees and a pavilion."""
    size = rng.uniform(6, 11, 2)
    corner = rng.uniform(lot[:2] + 4, lot[2:] - size - 4)
    pavilion = _facade(rng, style, height_m=rng.uniform(3.5, 6), house=True)
    count = round(rng.integers(9, 16) * style.trees)
    trees = [_tree(rng, style, *rng.uniform(lot[:2] + 1, lot[2:] - 1)) for _ in range(count)]
    return [_box(np.concatenate([corner, corner + size]), pavilion)], trees


def _fill_sheds(rng: np.random.Generator, style: TownStyle, lot: np.ndarray, _: np.ndarray) -> Fill:
    """Two or three wide, low halls."""
    boxes = []
    cuts = np.linspace(lot[0], lot[2], rng.integers(3, 5))
    for x0, x1 in itertools.pairwise(cuts):
        facade = _facade(rng, style, height_m=rng.uniform(6, 11))
        facade[6] = rng.uniform(0.05, 0.2)
        boxes.append(_box(np.array([x0 + 1, lot[1] + rng.uniform(1, 6), x1 - 1, lot[3] - rng.uniform(1, 6)]), facade))
    return boxes, _street_trees(rng, style, lot, 0, 3)


_FILL = {
    "canyon": _fill_canyon,
    "terrace": _fill_terrace,
    "mixed": _fill_mixed,
    "park": _fill_park,
    "sheds": _fill_sheds,
}


def _street_trees(rng: np.random.Generator, style: TownStyle, lot: np.ndarray, low: int, high: int) -> list[np.ndarray]:
    """From `low` to one less than `high` trees, times what the style has of them."""
    return [_street_tree(rng, style, lot) for _ in range(round(rng.integers(low, high) * style.trees))]


def _street_tree(rng: np.random.Generator, style: TownStyle, lot: np.ndarray) -> np.ndarray:
    """A tree on the pavement strip along one side of a block."""
    along = rng.uniform(0.05, 0.95)
    x, y = lot[0] + along * (lot[2] - lot[0]), lot[1] + along * (lot[3] - lot[1])
    side = [(x, lot[1] - 1.2), (x, lot[3] + 1.2), (lot[0] - 1.2, y), (lot[2] + 1.2, y)][rng.integers(4)]
    tree = _tree(rng, style, *side)
    tree[3] = min(tree[3], 2.0)
    return tree

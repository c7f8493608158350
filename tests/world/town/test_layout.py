"""Towns, drives and context labels: what the renderer and the paper's contexts rely on."""

import jax
import numpy as np
import pytest

from ovibjax.features.frames import CONTEXTS
from ovibjax.world.town.layout import BOX_COLUMNS, TREE_COLUMNS, Town, TownConfig, make_town
from ovibjax.world.town.route import context_labels, make_route

TOWNS = [
    TownConfig(),
    TownConfig(seed=0),
    TownConfig(seed=6),
    TownConfig(seed=3, size_m=800.0),
    TownConfig(seed=1, size_m=130.0),
    TownConfig(seed=2, size_m=300.0, block_m=80.0),
    TownConfig(seed=4, size_m=220.0, style=3),
]


def clearance_m(low, high, lines):
    """Gap between intervals and the nearest road axis, negative where an axis lies inside; [rows]."""
    return np.maximum(low[:, None] - lines, lines - high[:, None]).min(axis=1)


def off_road_m(town, xy):
    """Distance of points from the nearest road axis; [N]."""
    to_x, to_y = (np.abs(xy[:, a, None] - lines).min(axis=1) for a, lines in enumerate((town.road_x_m, town.road_y_m)))
    return np.minimum(to_x, to_y)


def turns_rad(yaw_rad):
    return np.angle(np.exp(1j * np.diff(yaw_rad.astype(np.float64))))


def test_equal_configs_give_equal_towns_and_drives():
    town, again = make_town(TownConfig()), make_town(TownConfig())
    for a, b in zip(jax.tree.leaves(town), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(a, b, strict=True)
    drives = [make_route(town, TownConfig(), 200, seed=4) for _ in range(2)]
    for a, b in zip(*drives, strict=True):
        np.testing.assert_array_equal(a, b, strict=True)


def test_other_seeds_give_other_towns_and_drives():
    config = TownConfig()
    town, other = make_town(config), make_town(TownConfig(seed=config.seed + 1))
    assert town.boxes.shape != other.boxes.shape or not np.array_equal(town.boxes, other.boxes)
    assert not np.array_equal(town.road_x_m, other.road_x_m)
    drives = [make_route(town, config, 200, seed).positions_m for seed in (0, 1)]
    assert np.linalg.norm(drives[0] - drives[1], axis=1).mean() > 10


@pytest.mark.parametrize("config", TOWNS, ids=str)
def test_a_town_is_well_formed(config):
    town = make_town(config)
    for array in jax.tree.leaves(town):
        assert array.dtype == np.float32 and np.isfinite(array).all()
    assert town.boxes.shape[1] == len(BOX_COLUMNS) and town.trees.shape[1] == len(TREE_COLUMNS)
    assert (town.boxes[:, :3] < town.boxes[:, 3:6]).all() and (town.boxes[:, 2] >= 0).all()
    assert (town.boxes[:, 6:9] >= 0).all() and (town.boxes[:, 6:9] <= 1).all()
    np.testing.assert_array_equal(town.boxes[:, -1], np.arange(len(town.boxes)))
    assert (town.trees[:, 3] > 0).all() and (town.trees[:, 2] > town.trees[:, 3]).all()  # crowns above the ground
    for lines in (town.road_x_m, town.road_y_m):
        assert (np.diff(lines) > 0).all()
        assert lines[[0, -1]] == pytest.approx([-config.size_m / 2, config.size_m / 2], rel=1e-5)
        assert town.lawn.shape == (len(town.road_x_m) + 1, len(town.road_y_m) + 1)


@pytest.mark.parametrize("config", TOWNS, ids=str)
def test_nothing_stands_on_a_carriageway(config):
    town = make_town(config)
    for axis, lines in enumerate((town.road_x_m, town.road_y_m)):
        gap = clearance_m(town.boxes[:, axis], town.boxes[:, 3 + axis], lines)
        assert gap.min() >= config.road_half_width_m + config.pavement_m - 1e-3
    assert off_road_m(town, town.trees[:, :2]).min() > config.road_half_width_m


@pytest.mark.parametrize("config", TOWNS, ids=str)
@pytest.mark.parametrize("seed", [0, 1])
def test_a_drive_follows_the_roads(config, seed):
    town = make_town(config)
    route = make_route(town, config, 1500, seed)
    positions_m, yaw_rad = route
    assert positions_m.dtype == yaw_rad.dtype == np.float32
    assert positions_m.shape == (1500, 3) and yaw_rad.shape == (1500,)
    np.testing.assert_array_equal(positions_m[:, 2], np.float32(config.flight_height_m))
    # The offset from the lane wanders like a Gaussian of 0.9 m: hardly ever onto the pavement, never beyond it.
    away = off_road_m(town, positions_m[:, :2])
    assert away.max() < config.road_half_width_m + config.pavement_m
    assert (away < config.road_half_width_m).mean() >= 0.99
    assert np.abs(positions_m[:, :2]).max() < config.size_m / 2 + config.road_half_width_m + config.pavement_m


def test_a_drive_is_smooth_and_turns():
    config = TownConfig()
    town = make_town(config)
    for seed in range(4):
        route = make_route(town, config, 3000, seed, spacing_m=1.6, max_turn_rad=0.08)
        step = np.diff(route.positions_m[:, :2].astype(np.float64), axis=0)
        length = np.linalg.norm(step, axis=1)
        # Beside the advance of 1.6 m the offset from the lane wanders by 0.3 m per frame (one sigma).
        assert length.max() < 2.5
        assert np.median(length) == pytest.approx(1.6, abs=0.1)
        turn = turns_rad(route.yaw_rad)
        # Beside the turn of 0.08 rad the heading wanders by 0.02 rad per frame (one sigma).
        assert np.abs(turn).max() < 0.25
        # Crossings are turned at, to both sides: 20 frames add up to a right angle.
        quarter = np.convolve(turn, np.ones(22), mode="valid")
        assert quarter.max() > 1.3 and quarter.min() < -1.3
        # The camera looks where it flies, give or take the wandering.
        along = np.stack([np.cos(route.yaw_rad[:-1]), np.sin(route.yaw_rad[:-1])], axis=1)
        cosine = (step * along).sum(axis=1) / length
        assert np.median(cosine) > 0.97 and cosine[length > 1.2].min() > 0.5


def row(x, y, size_m, height_m, look):
    """A building with its corner at x, y; `look` is its bay width and so tells it from others."""
    return [x, y, 0.0, x + size_m, y + size_m, height_m, 0.5, 0.5, 0.5, look, 3.0, 0.4, 0.3, 0.5, 0.0]


def test_contexts_of_a_hand_made_town():
    """One crossing at the origin; twelve twins along the road to the east, twelve different fronts to the west."""
    twins = [row(60 + 12 * i, side, 9.0, 7.0, 2.5) for i in range(6) for side in (12, -21)]
    fronts = [row(-72 - 12 * i, side, 9.0, 10.0 + i, 2.0 + 0.1 * (i + side)) for i in range(6) for side in (12, -21)]
    town = Town(
        boxes=np.array(twins + fronts, np.float32),
        trees=np.zeros((0, 5), np.float32),
        road_x_m=np.array([0.0], np.float32),
        road_y_m=np.array([0.0], np.float32),
        lawn=np.zeros((2, 2), np.float32),
        road_half_width_m=np.float32(5.5),
        pavement_m=np.float32(2.5),
    )
    places = {
        "intersection": [(0, 0), (5, -4), (-8, 8)],
        "repetitive": [(90, 0), (100, -3)],
        "corridor": [(-90, 0), (-100, 2), (0, 100), (14, 0), (0, -20)],
    }
    for name, points in places.items():
        positions_m = np.array([(*point, 20.0) for point in points], np.float32)
        assert [CONTEXTS[code] for code in context_labels(town, positions_m)] == [name] * len(points)


def test_every_context_has_its_share_of_the_default_drive():
    town = make_town(TownConfig())
    for seed in range(3):
        codes = context_labels(town, make_route(town, TownConfig(), 4994, seed).positions_m)
        assert codes.dtype == np.int32
        share = np.bincount(codes, minlength=len(CONTEXTS)) / len(codes)
        assert len(share) == len(CONTEXTS) and share.min() >= 0.10, dict(zip(CONTEXTS, share, strict=True))

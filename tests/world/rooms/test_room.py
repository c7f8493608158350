"""Rooms: equal seeds, cameras in free space, walls around every ray, the renderer against a plain ray-caster."""

import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.world.rooms import feature_set as cached
from ovibjax.world.rooms.drive import query_drive, reference_drive
from ovibjax.world.rooms.interior import render_interior
from ovibjax.world.rooms.room import BOX_COLUMNS, DECOR_COLUMNS, FACES, MAX_BOXES, MAX_DECOR, make_room, platform_room

CONFIGS = [platform_room(name, seed) for name in ("uav", "ugv") for seed in range(12)]
H, W = 12, 16


def furniture(room):
    return room.boxes[room.boxes[:, 0] < 900]


def drives(config):
    room = make_room(config)
    return room, reference_drive(room, config), query_drive(room, config)


def test_the_papers_rooms():
    uav, ugv = platform_room("uav", 3), platform_room("ugv", 3)
    assert uav.size_m[:2] == (4.1, 4.0) and (uav.n_views, uav.references, uav.queries) == (5, 76, 58)
    assert ugv.size_m[:2] == (5.0, 4.0) and (ugv.n_views, ugv.references, ugv.queries) == (4, 78, 72)
    with pytest.raises(ValueError, match="boat"):
        platform_room("boat", 0)


def test_a_room_is_a_function_of_its_seed():
    for name in ("uav", "ugv"):
        one, same, other = (drives(platform_room(name, seed)) for seed in (4, 4, 5))
        for a, b in zip(one, same, strict=True):
            for x, y in zip(a, b, strict=True):
                np.testing.assert_array_equal(x, y, strict=True)
        assert not np.array_equal(one[0].boxes, other[0].boxes)
        assert not np.array_equal(one[2].positions_m, other[2].positions_m)
        assert not np.array_equal(one[1].positions_m[:50], one[2].positions_m[:50])


@pytest.mark.parametrize("config", CONFIGS, ids=lambda c: f"{c.n_views}-{c.seed}")
def test_a_room_is_well_formed(config):
    room = make_room(config)
    assert room.boxes.shape == (MAX_BOXES, len(BOX_COLUMNS)) and room.decor.shape == (MAX_DECOR, len(DECOR_COLUMNS))
    for array in room:
        assert array.dtype == np.float32 and np.isfinite(array).all()
    boxes = furniture(room)
    assert 8 <= len(boxes) < MAX_BOXES
    assert (boxes[:, :3] < boxes[:, 3:6]).all() and (boxes[:, 2] >= 0).all() and (boxes[:, 5] <= room.size_m[2]).all()
    assert (np.abs(boxes[:, [0, 1, 3, 4]]) <= np.tile(room.size_m[:2] / 2, 2) + 1e-5).all()
    decor = room.decor[room.decor[:, 0] >= 0]
    assert 8 <= len(decor) < MAX_DECOR and set(decor[:, 0]) <= set(range(len(FACES)))
    # Used rows come first: the renderer stops at the first unused one.
    assert (room.decor[len(decor) :, 0] < 0).all() and (room.boxes[len(boxes) :, 0] > 900).all()


@pytest.mark.parametrize("config", CONFIGS, ids=lambda c: f"{c.n_views}-{c.seed}")
def test_cameras_stay_in_the_room_and_out_of_the_furniture(config):
    room, *both = drives(config)
    boxes = furniture(room)
    for drive, n in zip(both, (config.references, config.queries), strict=True):
        assert drive.positions_m.shape == (n, 3) and drive.origin_m.shape == (n, config.n_views, 3)
        points = np.concatenate([drive.positions_m, drive.origin_m.reshape(-1, 3)])
        assert (np.abs(points[:, :2]) < room.size_m[:2] / 2 - 0.2).all()
        assert (points[:, 2] > 0.1).all() and (points[:, 2] < room.size_m[2] - 0.3).all()
        inside = ((points[:, None] > boxes[:, :3] - 0.01) & (points[:, None] < boxes[:, 3:6] + 0.01)).all(axis=2)
        assert not inside.any()
        assert np.linalg.norm(drive.origin_m - drive.positions_m[:, None], axis=2).max() < 0.15
    # The view from the side is up to a few degrees a right angle from the front view.
    turn = np.rad2deg(both[0].view_yaw_rad - both[0].yaw_rad[:, None])
    assert np.abs(turn[:, :4] - np.array([0, 180, 90, -90])).max() < 10
    if config.n_views == 5:
        np.testing.assert_array_equal(both[0].origin_m[:, 4], both[0].origin_m[:, 0])


def test_references_cover_the_room_about_as_densely_as_the_papers():
    for name in ("uav", "ugv"):
        floors = []
        for seed in range(12):
            _, references, queries = drives(platform_room(name, seed))
            gap = np.linalg.norm(references.positions_m[:, None] - queries.positions_m[None], axis=2)
            floors.append(gap.min(axis=0).mean())
        assert 0.25 < np.mean(floors) < 0.36


def oracle_depth(room, origin, ray):
    """Depth of the nearest thing on a ray: the room's own faces from inside, boxes from outside."""
    low, high = np.array([*(-room.size_m[:2] / 2), 0.0]), np.array([*(room.size_m[:2] / 2), room.size_m[2]])
    best = min((h if r > 0 else lo) / r for lo, h, r in zip(low - origin, high - origin, ray, strict=True) if r != 0)
    for box in furniture(room).astype(np.float64):
        a, b = (box[:3] - origin) / ray, (box[3:6] - origin) / ray
        enter, leave = np.minimum(a, b).max(), np.maximum(a, b).min()
        if 0 < enter < leave:
            best = min(best, enter)
    return best


@pytest.fixture(scope="module")
def shots():
    """Twelve views in each of two rooms."""
    out = []
    for config in (platform_room("uav", 1), platform_room("ugv", 2)):
        room, references, _ = drives(config)
        pick = [
            field.reshape(-1, *field.shape[2:])[::26][:12]
            for field in (references.origin_m, references.view_yaw_rad, references.view_pitch_rad)
        ]
        rgb, depth = render_interior(room, *pick, H, W)
        out.append((room, *pick, np.asarray(rgb), np.asarray(depth)))
    return out


def test_depth_equals_a_plain_ray_caster(shots):
    for room, origin, yaw, pitch, _, depth in shots:
        rng = np.random.default_rng(0)
        agree = []
        for view, row, column in rng.integers((12, H, W), size=(80, 3)):
            found = []
            for i, j in ((0.25, 0.25), (0.25, 0.75), (0.75, 0.25), (0.75, 0.75)):
                right, up = (column + j) / W * 2 - 1, (1 - (row + i) / H * 2) * H / W
                c, s = np.cos(pitch[view]), np.sin(pitch[view])
                forward, high = c - s * up, s + c * up
                cy, sy = np.cos(yaw[view]), np.sin(yaw[view])
                ray = np.array([forward * cy + right * sy, forward * sy - right * cy, high])
                found.append(oracle_depth(room, origin[view].astype(np.float64), ray))
            agree.append(abs(np.mean(found) - depth[view, row, column]) < 5e-3 * np.mean(found))
        assert np.mean(agree) > 0.97


def test_walls_end_every_ray_and_pictures_show_something(shots):
    for room, _, _, _, rgb, depth in shots:
        assert np.isfinite(depth).all() and depth.min() > 0.02
        # The farthest corner of an image is at 1 / cos of its axis.
        assert depth.max() <= np.linalg.norm(room.size_m) + 1e-3
        assert rgb.shape == (12, H, W, 3) and np.isfinite(rgb).all() and rgb.min() >= 0 and rgb.max() <= 1
        assert (rgb.std(axis=(1, 2, 3)) > 0.01).all()


def test_features_come_from_the_cache_the_second_time(tmp_path, monkeypatch):
    monkeypatch.setenv("OVIBJAX_CACHE", str(tmp_path))
    calls = []

    def fake(room, both):
        calls.append(1)
        rng = np.random.default_rng(0)
        return [rng.normal(size=(*drive.view_yaw_rad.shape, 8)) for drive in both]

    monkeypatch.setattr(cached, "_embed", fake)
    config, other = platform_room("ugv", 0), platform_room("ugv", 1)
    seen = []
    first = cached.rooms_features([config, other], on_rooms=lambda *count: seen.append(count))
    again = cached.room_features(config)
    assert len(calls) == 2 and seen == [(1, 2), (2, 2)]
    for a, b in zip(first[0], again, strict=True):
        np.testing.assert_array_equal(a.features, b.features)
        np.testing.assert_array_equal(a.positions_m, b.positions_m)
    next(tmp_path.glob("*queries.npz")).write_bytes(b"damaged")
    for room in (config, other):
        assert len(cached.room_features(room)[1].features) == 72
    monkeypatch.setenv("OVIBJAX_CACHE", str(tmp_path / "file" / "inside"))
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="OVIBJAX_CACHE"):
        cached.room_features(config)

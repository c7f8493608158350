"""The description of a feature set, on drives whose numbers are known."""

import numpy as np
import pytest

from ovibjax.features.description import describe
from ovibjax.features.frames import make_feature_set
from ovibjax.features.splits import Split


def drives():
    """Scene 0: 30 frames along x, 2 m apart; scene 7: two drives of 10 frames along y, 2 m apart, 100 m between."""
    first = np.array([(2.0 * i, 5.0, 1.0) for i in range(30)])
    second = np.array([(0.0, 2.0 * i + (i >= 10) * 100.0, 3.0 + i % 2 * 0.0) for i in range(20)])
    context = np.array([0] * 15 + [1] * 15 + [2] * 10 + [-1] * 10)
    scene = np.array([0] * 30 + [7] * 20)
    return make_feature_set(np.ones((50, 4, 6)), np.concatenate([first, second]), context=context, scene_id=scene)


# Every fifth frame is test, every fifth validation: each test frame has a training frame 2 m away.
SPLIT = Split(*(np.flatnonzero(np.isin(np.arange(50) % 5, part)) for part in ([0, 1, 2], [3], [4])))


def test_whole_set():
    found = describe(drives(), SPLIT)
    assert (found.frames, found.parts, found.views, found.dim) == (50, (30, 10, 10), 4, 6)
    # 29 steps in scene 0; 9 + 9 in scene 7; the jump between scenes is no step at all.
    assert found.route_m == pytest.approx(2.0 * (29 + 18)) and found.breaks == 1
    assert found.spacing_m == pytest.approx(2.0) and found.nearest_m == pytest.approx(2.0)
    assert found.extent_m == pytest.approx((58.0, 138.0, 0.0))
    assert found.context_share == pytest.approx((0.3, 0.3, 0.2, 0.2))


def test_one_scene():
    found = describe(drives(), SPLIT, scene=7)
    assert (found.frames, found.parts) == (20, (12, 4, 4))
    assert found.route_m == pytest.approx(36.0) and found.breaks == 1
    assert found.extent_m == pytest.approx((0.0, 138.0, 0.0))
    assert found.context_share == pytest.approx((0.0, 0.0, 0.5, 0.5))


def test_scene_without_steps_or_training_frames():
    data = drives()
    data = data._replace(scene_id=np.array([0] * 49 + [3], np.int32))
    found = describe(data, SPLIT, scene=3)
    assert (found.frames, found.route_m, found.breaks, found.spacing_m) == (1, 0.0, 0, 0.0)
    assert np.isnan(found.nearest_m)
    # A drone that hovers: no movement, no break.
    still = data._replace(positions_m=np.zeros((50, 3), np.float32))
    assert (describe(still, SPLIT).route_m, describe(still, SPLIT).breaks) == (0.0, 0)

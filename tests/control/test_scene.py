"""A scene made of a few synthetic frames."""

import numpy as np
import pytest

from ovibjax.control.actions import ACTIONS, actions_for
from ovibjax.control.environment import rates_from_paper
from ovibjax.control.scene import make_scene
from tests.control.cases import TINY, drive


@pytest.fixture(
    scope="module", params=[pytest.param(5, id="aerial"), pytest.param(4, id="ground", marks=pytest.mark.long)]
)
def made(request):
    sets = [drive(seed, views=request.param, known=0.8) for seed in (1, 2)]
    return sets, make_scene(sets, 1, TINY)


def test_scene_of_synthetic_frames(made):
    sets, scene = made
    views = sets[0].features.shape[1]
    actions = scene.actions
    assert actions == actions_for(views, ACTIONS) and len(actions) == {5: 8, 4: 6}[views]
    assert scene.contexts == ("corridor", "intersection", "repetitive", "unknown")
    assert len(scene.training) == len(scene.held_out) == 1
    route = scene.training[0]
    assert route.residual_m.shape == (120, len(actions), 2) and np.isfinite(route.residual_m).all()
    for part, frames in ((route, sets[0]), (scene.held_out[0], sets[1])):
        context = np.where(frames.context < 0, 3, frames.context)
        np.testing.assert_array_equal(part.context, context)
        np.testing.assert_array_equal(part.yaw_rad, frames.yaw_rad)
        np.testing.assert_array_equal(part.predicted_m, scene.predictor_m[context])
    # The predictor has seen the training route alone.
    length = np.linalg.norm(route.residual_m, axis=-1)
    for c in range(4):
        here = route.context == c
        np.testing.assert_allclose(scene.predictor_m[c], np.median(length[here], axis=0), rtol=1e-6)
    np.testing.assert_allclose(scene.context_share, np.bincount(route.context, minlength=4) / 120)
    assert rates_from_paper(scene.context_share).shape == (4,)

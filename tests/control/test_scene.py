"""A scene made of a few synthetic frames."""

import jax
import numpy as np
import pytest

from ovibjax.control.actions import ACTIONS, actions_for
from ovibjax.control.drives import join_drives
from ovibjax.control.environment import rates_from_paper
from ovibjax.control.scene import Reading, cut_scene, make_scene
from ovibjax.encoder.checkpoint import train_checkpoint
from ovibjax.errors import InputError
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


def test_the_risk_that_comes_with_an_answer_is_calibrated_on_training_routes():
    sets = [drive(seed) for seed in (1, 2, 3)]
    frames = join_drives(sets, 2)
    trained = train_checkpoint(jax.random.key(0), frames.first_frames, TINY)
    scene, coded, ours = (
        cut_scene(frames, trained, r) for r in (Reading(), Reading(recode=True), Reading(prior="calibrated"))
    )
    length, risk = (
        np.concatenate([part(route) for route in scene.training])
        for part in (lambda route: np.linalg.norm(route.residual_m, axis=-1), lambda route: route.risk_m)
    )
    for a in range(length.shape[1]):
        assert np.mean(risk[:, a] ** 2) == pytest.approx(np.mean(length[:, a] ** 2), rel=0.05)
        for claimed in np.unique(risk[:, a]):  # and at every risk that is ever claimed
            told = risk[:, a] == claimed
            assert np.mean(length[told, a] ** 2) == pytest.approx(claimed**2, rel=0.05)
    assert len(np.unique(risk[:, 0])) > 3
    # Held-out routes are claimed nothing else than what training routes showed.
    for a in range(length.shape[1]):
        assert np.isin(scene.held_out[0].risk_m[:, a], risk[:, a]).all()
    assert not np.array_equal(coded.held_out[0].residual_m, scene.held_out[0].residual_m)
    np.testing.assert_array_equal(ours.training[0].risk_m, scene.training[0].risk_m)
    context = np.concatenate([route.context for route in scene.training])
    for c in range(3):
        np.testing.assert_allclose(ours.predictor_m[c], risk[context == c].mean(axis=0), rtol=1e-5)


def test_too_few_training_frames_are_refused():
    with pytest.raises(InputError, match="10 frames on training routes"):
        join_drives([drive(1, n=10), drive(2)], 1)

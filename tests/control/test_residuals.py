"""Residuals, the median predictor, and a scene made of a few synthetic frames."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.control import residuals
from ovibjax.control.actions import ACTIONS
from ovibjax.control.environment import drift_from_paper
from ovibjax.control.residuals import CheckpointConfig
from ovibjax.control.scene import make_scene
from ovibjax.encoder.model import decode, encode
from ovibjax.features.basis import project
from ovibjax.features.frames import FeatureSet
from ovibjax.views import MODES
from tests.oracles import control as oracle

TINY = CheckpointConfig(rank=8, steps=20, batch=32, mixed=64, hidden=32, last_hidden=16)


def drive(seed, n=120, views=5, d=24, known=1.0):
    """A drive along a curve; features are smooth functions of the position."""
    rng = np.random.default_rng(seed)
    yaw = np.cumsum(rng.normal(scale=0.05, size=n)).astype(np.float32)
    steps = 1.6 * np.stack([np.cos(yaw), np.sin(yaw), np.zeros(n)], -1)
    place = np.cumsum(steps, axis=0).astype(np.float32)
    waves = np.random.default_rng(0)
    features = np.cos(0.05 * place[:, :2] @ waves.normal(size=(2, views * d)) + waves.uniform(0, 6, views * d))
    features = features.reshape(n, views, d)
    features = (features / np.linalg.norm(features, axis=-1, keepdims=True)).astype(np.float32)
    context = np.where(rng.random(n) < known, rng.integers(0, 3, n), -1).astype(np.int32)
    ids = np.array([f"{i:06d}" for i in range(n)])
    return FeatureSet(features, place, yaw, context, np.zeros(n, np.int32), ids)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 1000), st.sampled_from([0.0, 0.5, 3.0, 1e9]))
def test_survey(seed, spacing):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 60))
    position = np.cumsum(rng.exponential(size=(n, 3)), axis=0)
    drives = np.sort(rng.integers(0, 3, n))
    kept = residuals.survey(position, drives, spacing)
    np.testing.assert_array_equal(kept, oracle.survey(position, drives, spacing))
    assert set(kept[np.r_[True, np.diff(drives[kept]) > 0]]) == {int(np.argmax(drives == d)) for d in set(drives)}
    assert spacing > 0 or len(kept) == n


def test_predictor_is_the_median_by_context_and_action():
    rng = np.random.default_rng(0)
    residual, context = rng.exponential(size=(50, 8)), rng.integers(0, 3, 50)
    context[context == 1] = 2  # context 1 is never met
    found = residuals.fit_predictor(residual, context, 4)
    assert found.shape == (4, 8) and found.dtype == np.float32
    for c in range(4):
        for a in range(8):
            seen = sorted(residual[i, a] for i in range(50) if context[i] == c or c in (1, 3))
            middle = (seen[(len(seen) - 1) // 2] + seen[len(seen) // 2]) / 2
            assert found[c, a] == pytest.approx(middle, rel=1e-6)


def test_an_outlier_does_not_move_the_predictor():
    residual = np.array([[1.0], [2.0], [3.0], [4.0], [1000.0]])
    assert residuals.fit_predictor(residual, np.zeros(5, int), 1)[0, 0] == 3.0


def test_mixed_frames():
    x = jax.random.normal(jax.random.key(0), (6, 2, 3))
    assert residuals.mix_frames(jax.random.key(1), x, 0) is x
    mixed = residuals.mix_frames(jax.random.key(1), x, 40)
    assert mixed.shape == (46, 2, 3)
    np.testing.assert_array_equal(mixed[:6], x)
    rows = np.asarray(x, np.float64).reshape(6, -1)
    for new in np.asarray(mixed[6:], np.float64).reshape(40, -1):
        # Some triple and one weight in [0, 1] give it.
        gaps = []
        for i in range(6):
            for j in range(6):
                for k in range(6):
                    way = rows[j] - rows[k]
                    weight = 0.0 if j == k else np.clip((new - rows[i]) @ way / (way @ way), 0, 1)
                    gaps.append(np.abs(rows[i] + weight * way - new).max())
        assert min(gaps) < 1e-5


def test_drift_of_unknown_contexts_is_the_mean():
    share = np.array([0.3, 0.2, 0.1, 0.4])
    rates = np.asarray(drift_from_paper(share), np.float64)
    assert rates @ share * 593 * 0.5 == pytest.approx(22 * 27, rel=1e-5)
    assert rates[3] == pytest.approx(22 * 27 / (593 * 0.5), rel=1e-5)
    only_unknown = drift_from_paper(np.array([0.0, 0.0, 0.0, 1.0]))
    assert np.all(np.isfinite(only_unknown)) and only_unknown[3] == pytest.approx(rates[3])


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
    assert actions == residuals.actions_for(views, ACTIONS) and len(actions) == {5: 8, 4: 6}[views]
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
        np.testing.assert_allclose(scene.predictor_m[c], np.median(length[route.context == c], axis=0), rtol=1e-6)
    np.testing.assert_allclose(scene.context_share, np.bincount(route.context, minlength=4) / 120)
    assert drift_from_paper(scene.context_share).shape == (4,)


def test_residuals_are_those_of_leave_one_out_retrieval():
    frames = drive(3)
    checkpoint = residuals.train_checkpoint(jax.random.key(0), frames.features, TINY)
    assert checkpoint.arch.latent == 128 and checkpoint.arch.view_dim == 8
    references = residuals.survey(frames.positions_m, np.zeros(120), 5.0)
    found = residuals.residuals_m(checkpoint, frames.features, frames.positions_m, references, ACTIONS)
    x = project(checkpoint.basis, frames.features)
    same = 0
    for a, (mode, k, _) in enumerate(oracle.action_list()):
        mask = np.zeros((5, 1), np.float32)
        mask[list(MODES[mode])] = 1
        shown = jnp.asarray((x * mask).reshape(120, -1))
        mu, _ = encode(checkpoint.params, shown, checkpoint.arch)
        mu = np.asarray(mu).copy()
        mu[:, k:] = 0
        decoded = np.asarray(decode(checkpoint.params, jnp.asarray(mu), checkpoint.arch))
        decoded = (decoded.reshape(120, 5, -1) * mask).reshape(120, -1)
        own = [list(references).index(i) if i in references else -1 for i in range(120)]
        rows = references[oracle.most_similar_other(decoded, decoded[references], own)]
        want = frames.positions_m[rows, :2] - frames.positions_m[:, :2]
        same += np.isclose(found[:, a], want, atol=1e-4).all(axis=1).mean()
        assert np.all(np.linalg.norm(found[references, a], axis=-1) > 1.0)  # never itself
    assert same / 8 > 0.98  # near ties may fall either way in float32


def test_training_is_a_function_of_its_key():
    frames = drive(4)
    one, two = (residuals.train_checkpoint(jax.random.key(5), frames.features, TINY) for _ in range(2))
    jax.tree.map(np.testing.assert_array_equal, one.params, two.params)

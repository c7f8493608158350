"""The motion-capture protocol: what it computes, and that queries teach it nothing."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.edge import indoor
from ovibjax.edge.indoor import DIMS, Protocol
from ovibjax.edge.indoor_data import scene_data
from ovibjax.edge.localize import ETAS
from ovibjax.edge.view_fusion import kept_weights
from ovibjax.encoder import model
from ovibjax.encoder.model import Architecture
from ovibjax.encoder.train import TrainConfig
from ovibjax.views import MODES, mode_mask
from tests.edge.cases import some_frames
from tests.runtime.cases import QUICK

quick = functools.partial(jax.jit, compiler_options=QUICK)
ARCH = Architecture(n_views=4, view_dim=6, latent=8, hidden=16, last_hidden=12, head=8)
PROTOCOL = Protocol(TrainConfig(ARCH, prefixes=(2, 8), steps=24, warmup=4), prefixes=(2, 8), checkpoints=3, lr=1e-2)


encode, decode, locate = (quick(f, static_argnames="arch") for f in (model.encode, model.decode, model.locate))


@functools.cache
def scene():
    return scene_data(some_frames(31, 1), some_frames(12, 2), rank=6)


@quick
def whole(key, pair):
    """The whole protocol as one program: what it learnt on the way, and its outputs."""
    kept = []
    with pytest.MonkeyPatch.context() as patch:  # as it is traced
        patch.setattr(indoor, "learn", lambda *inputs, learn=indoor.learn: kept.append(learn(*inputs)) or kept[0])
        answers = PROTOCOL(key, {}, pair)
    return kept[0], answers


@pytest.fixture(scope="module")
def outcome():
    """What was learnt, and the outputs."""
    return jax.device_get(whole(jax.random.key(3), scene()))


def test_the_references_are_split_by_place_and_the_basis_sees_training_rows_only():
    references, queries = scene()
    rows = np.concatenate([references.train, references.val])
    np.testing.assert_array_equal(np.sort(rows), np.arange(31))
    assert np.all(np.asarray(references.folds)[references.val] == 0) and len(references.val) in (6, 7)
    x = np.asarray(references.x)[references.train]
    np.testing.assert_allclose(x.mean(axis=0), 0, atol=1e-5)
    assert references.x.shape[1:] == queries.x.shape[1:] == (4, 6)
    wide = scene_data(some_frames(31, 1), some_frames(12, 2), rank=64)[0]
    assert wide.x.shape[2] == 10  # never more than there are; half the training frames otherwise
    assert scene_data(some_frames(20, 1), some_frames(12, 2), rank=64)[0].x.shape[2] == 8


def estimates(learned, x, rows, mode, k):
    """Regression and retrieval of frames, one at a time."""
    references, params = scene()[0], learned.params
    wide = np.repeat(np.asarray(mode_mask(mode, 4)), 6)
    flat = np.asarray(x).reshape(len(x), -1) * wide
    z, kept = encode(params, jnp.asarray(flat), ARCH)[0], jnp.asarray(np.arange(8) < k, jnp.float32)
    descriptor = np.asarray(decode(params, z, kept, ARCH)) * wide
    y = np.asarray(locate(params, jnp.asarray(descriptor), ARCH))
    reg = y * float(references.standardizer.scale_m) + np.asarray(references.standardizer.mean_m)
    database = np.asarray(references.x)[rows].reshape(len(rows), -1) * wide
    database = database / np.linalg.norm(database, axis=1, keepdims=True)
    ret = np.asarray(references.positions_m)[rows][[int(np.argmax(database @ row)) for row in descriptor]]
    return reg, ret


def distance_m(a, b):
    return np.linalg.norm(np.asarray(a, np.float64) - np.asarray(b, np.float64), axis=-1)


@pytest.mark.parametrize("mode", ["F", "H4"])
def test_errors_follow_from_what_was_learnt(outcome, mode):
    learned, answers = outcome
    references, queries = scene()
    m = list(PROTOCOL.modes).index(mode)
    for i, k in enumerate((2, 8)):
        rows = np.asarray(references.train)
        reg, ret = estimates(learned, references.x[references.val], rows, mode, k)
        truth = np.asarray(references.positions_m)[references.val]
        means = [distance_m(eta * reg + (1 - eta) * ret, truth).mean() for eta in ETAS]
        eta = float(learned.eta[m, i])
        assert eta == pytest.approx(ETAS[int(np.argmin(means))], abs=1e-6) or min(means) == pytest.approx(
            means[round(eta * 20)], abs=1e-4
        )
        np.testing.assert_allclose(learned.val_m[m, i], min(means), atol=1e-4)
        reg, ret = estimates(learned, queries.x, np.arange(31), mode, k)
        np.testing.assert_allclose(answers["regression_m"][m, i], distance_m(reg, queries.positions_m), atol=1e-4)
        mixed = distance_m(eta * reg + (1 - eta) * ret, queries.positions_m)
        np.testing.assert_allclose(answers["ovib_m"][m, i], mixed, atol=1e-4)


def test_raw_retrieval_uses_the_calibrated_weights_of_the_kept_views(outcome):
    learned, answers = outcome
    references, queries = scene()
    position = np.asarray(references.positions_m)
    for m, mode in enumerate(PROTOCOL.modes):
        weights = np.asarray(kept_weights(jnp.asarray(learned.weights), mode_mask(mode, 4)))
        assert weights[[v for v in range(4) if v not in MODES[mode]]].sum() == 0
        fused = np.einsum("m,qmd,nmd->qn", weights, queries.features, references.features)
        expected = distance_m(position[fused.argmax(axis=1)], queries.positions_m)
        np.testing.assert_allclose(answers["raw_m"][m], expected, atol=1e-5)
    gap = distance_m(np.asarray(queries.positions_m)[:, None], position[None])
    np.testing.assert_allclose(answers["floor_m"], gap.min(axis=1), atol=1e-5)


def test_queries_change_nothing_that_is_learnt():
    """By their types `learn` cannot see them; here through the whole function, on shuffled and shifted queries."""
    references, queries = some_frames(31, 1), some_frames(12, 2)
    strange = queries._replace(features=queries.features[::-1, ::-1], positions_m=queries.positions_m + 50)
    one, other = (whole(jax.random.key(3), scene_data(references, asked, 6))[1] for asked in (queries, strange))
    for name in ("eta", "val_m", "weights", "fold_m", "fold_uniform_m", "score", "best"):
        np.testing.assert_array_equal(one[name], other[name])
    assert not np.allclose(one["ovib_m"], other["ovib_m"])
    assert set(DIMS) <= set(one)
    for name, dims in DIMS.items():
        assert one[name].ndim == len(dims)
    assert one["ovib_m"].shape == (3, 2, 12) and one["score"].shape == (3,)


def test_a_reference_as_query_is_found_exactly(outcome):
    learned, _ = outcome
    references, _ = scene()
    known = indoor.Queries(references.features[:12], references.x[:12], references.positions_m[:12])
    answers = quick(indoor.answer, static_argnums=3)(learned, references, known, PROTOCOL)
    np.testing.assert_allclose(answers["raw_m"], 0.0, atol=1e-6)
    np.testing.assert_allclose(answers["floor_m"], 0.0, atol=1e-6)

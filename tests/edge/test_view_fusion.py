"""Calibration of view-fusion weights: objective against plain NumPy, simplex, folds, compiled and mapped."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.edge import view_fusion as fusion
from ovibjax.edge.localize import errors
from ovibjax.edge.retrieval import brute_force
from ovibjax.edge.view_fusion import (
    fold_error_m,
    fold_similarity,
    fused_descriptor,
    kept_weights,
    spatial_folds,
    surrogate_m,
)
from ovibjax.views import mode_mask
from tests.oracles import edge as oracle
from tests.runtime.cases import QUICK

quick = functools.partial(jax.jit, compiler_options=QUICK)
calibrate = quick(fusion.calibrate)


@functools.cache
def room(seed=0, noisy=(1, 3), n=40, n_views=5, d=12):
    """References whose views are smooth in the position, two of them drowned in noise."""
    rng = np.random.default_rng(seed)
    position = np.column_stack([rng.uniform(-2, 2, (n, 2)), np.full(n, 1.2)]).astype(np.float32)
    features = np.sin(np.einsum("nk,kmd->nmd", position, 1.5 * rng.normal(size=(3, n_views, d))))
    for view in noisy:
        features[:, view] = rng.normal(size=(n, d))
    features /= np.linalg.norm(features, axis=2, keepdims=True)
    return features.astype(np.float32), position, spatial_folds(position)


def parts(features, position, folds):
    similarity, allowed = fold_similarity(jnp.asarray(features), jnp.asarray(folds))
    return similarity, allowed, errors(jnp.asarray(position)[:, None], jnp.asarray(position)[None])


UNIFORM = jnp.full(5, 0.2, jnp.float32)


@pytest.mark.parametrize("temperature", [0.02, 0.2])
def test_objectives_equal_the_oracle(temperature):
    features, position, folds = room()
    weights = np.array([0.4, 0.0, 0.3, 0.1, 0.2], np.float32)
    similarity, allowed, distance_m = parts(*room())
    smooth = surrogate_m(jnp.asarray(weights), similarity, allowed, distance_m, jnp.float32(temperature))
    expected = oracle.surrogate(weights, features, position, folds, temperature)
    np.testing.assert_allclose(smooth, expected, rtol=1e-4)
    hard = fold_error_m(jnp.asarray(weights), similarity, allowed, distance_m)
    np.testing.assert_allclose(hard, oracle.fold_error(weights, features, position, folds), rtol=1e-5)


def test_noisy_views_lose_their_weight_and_the_folds_error_falls():
    features, position, folds = room()
    weights = np.asarray(calibrate(features, position, folds))
    assert weights.dtype == np.float32
    assert weights[[1, 3]].max() < 0.1
    clean = oracle.fold_error(np.asarray(UNIFORM), features, position, folds)
    assert oracle.fold_error(weights, features, position, folds) < 0.8 * clean


@pytest.mark.parametrize("seed", range(6))
def test_weights_lie_on_the_simplex_and_are_no_worse_on_the_folds(seed):
    everything_noise = (0, 1, 2, 3, 4)
    data = room(seed, everything_noise if seed % 2 else (2,))
    weights = calibrate(*data)
    assert np.all(np.asarray(weights) >= 0)
    np.testing.assert_allclose(np.sum(weights), 1.0, atol=1e-6)
    loss = [float(fold_error_m(w, *parts(*data))) for w in (weights, UNIFORM)]
    assert loss[0] <= loss[1] + 1e-6


def test_identical_views_keep_equal_weights():
    features, position, folds = room(noisy=())
    same = np.repeat(features[:, :1], 5, axis=1)
    np.testing.assert_allclose(calibrate(same, position, folds), UNIFORM, atol=1e-5)


def test_mapped_equals_one_by_one():
    rooms = [room(seed) for seed in (0, 1)]
    stacked = [jnp.stack([jnp.asarray(r[i]) for r in rooms]) for i in range(3)]
    mapped = quick(jax.vmap(fusion.calibrate))(*stacked)
    for one, data in zip(mapped, rooms, strict=True):
        np.testing.assert_allclose(one, calibrate(*data), atol=2e-3)


def test_weights_of_a_mode_are_those_of_its_views_scaled_to_one():
    weights = jnp.array([0.1, 0.2, 0.0, 0.3, 0.4], jnp.float32)
    np.testing.assert_allclose(kept_weights(weights, mode_mask("FS")), [0.25, 0, 0, 0.75, 0], atol=1e-6)
    np.testing.assert_allclose(kept_weights(weights, mode_mask("A5")), weights, atol=1e-6)
    blind = jnp.array([0.0, 0.5, 0.0, 0.0, 0.5], jnp.float32)
    np.testing.assert_allclose(kept_weights(blind, mode_mask("FS")), [1 / 3, 0, 1 / 3, 1 / 3, 0], atol=1e-6)


def test_the_fused_descriptor_retrieves_by_the_fused_similarity():
    features, _, _ = room()
    weights = jnp.array([0.4, 0.0, 0.3, 0.1, 0.2], jnp.float32)
    query, db = features[:10], features[10:]
    found = brute_force(fused_descriptor(jnp.asarray(query), weights), fused_descriptor(jnp.asarray(db), weights))
    fused = np.einsum("m,qmd,nmd->qn", weights, query, db)
    np.testing.assert_array_equal(found, fused.argmax(axis=1))


@settings(max_examples=50, deadline=None)
@given(n=st.integers(5, 120), folds=st.integers(2, 5), seed=st.integers(0, 99), grid=st.booleans())
def test_folds_are_balanced_deterministic_and_complete(n, folds, seed, grid):
    rng = np.random.default_rng(seed)
    position = rng.integers(0, 4, (n, 3)).astype(float) if grid else rng.normal(size=(n, 3))
    dealt = spatial_folds(position, folds)
    assert dealt.dtype == np.int32
    np.testing.assert_array_equal(dealt, spatial_folds(position, folds))
    counts = np.bincount(dealt, minlength=folds)
    assert counts.min() >= 1 and len(counts) == folds
    assert counts.max() - counts.min() <= max(1, round(n / (4 * folds)))  # one per block


def test_folds_are_compact_blocks_with_other_folds_close_by():
    position = np.random.default_rng(0).uniform(0, 4, (80, 3))
    dealt = spatial_folds(position)
    distance = np.linalg.norm(position[:, None, :2] - position[None, :, :2], axis=2)
    np.fill_diagonal(distance, np.inf)
    nearest_same = np.where(dealt[:, None] == dealt, distance, np.inf).min(axis=1)
    nearest_other = np.where(dealt[:, None] != dealt, distance, np.inf).min(axis=1)
    random = np.random.default_rng(1).permutation(dealt)
    nearest_if_random = np.where(random[:, None] == random, distance, np.inf).min(axis=1)
    assert nearest_same.mean() < 0.6 * nearest_if_random.mean()
    assert nearest_other.mean() < 0.6


def test_fewer_positions_than_folds_are_refused():
    with pytest.raises(ValueError, match="3 positions"):
        spatial_folds(np.zeros((3, 3)), 5)

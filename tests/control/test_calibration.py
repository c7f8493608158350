"""Calibration of an answer's risk against an isotonic regression of SciPy on the same levels."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import isotonic_regression

from ovibjax.control.calibration import LEVELS, calibrated_risk_m, fit_calibration, not_rising

fit = jax.jit(fit_calibration)


def frames(n, seed, others=20):
    """Margins, squared residuals and which frames are known; what is not known is far off."""
    rng = np.random.default_rng(seed)
    distinctness = rng.normal(size=(n + others, 3)).astype(np.float32)
    found = rng.random(distinctness.shape) < 1 / (1 + np.exp(-3 * distinctness))
    squared = np.where(found, 4.0, 9000.0) * rng.exponential(size=distinctness.shape)
    known = np.zeros(n + others, bool)
    known[rng.permutation(n + others)[:n]] = True
    squared[~known] *= 1e6
    return distinctness, squared.astype(np.float32), known


@pytest.mark.parametrize("n", [LEVELS, LEVELS + 1, 60, 1779])
def test_levels_are_an_isotonic_regression_of_training_frames(n):
    distinctness, squared, known = frames(n, n)
    found = fit(distinctness, squared, known)
    risk = np.asarray(calibrated_risk_m(found, distinctness))
    for a in range(3):
        order = np.argsort(distinctness[known, a])
        level, values = np.arange(n) * LEVELS // n, squared[known, a][order].astype(np.float64)
        means = [values[level == b].mean() for b in range(LEVELS)]
        want = isotonic_regression(means, weights=np.bincount(level), increasing=False).x
        np.testing.assert_allclose(found.mean_square_m2[a], want, rtol=1e-5)
        np.testing.assert_allclose(risk[known, a][order], np.sqrt(want[level]), rtol=1e-5)
        assert np.mean(risk[known, a] ** 2) == pytest.approx(values.mean(), rel=1e-4)


def test_two_populations_are_told_apart_on_frames_that_were_not_fitted():
    distinctness, squared, known = frames(1779, 7, others=1779)
    squared[~known] /= 1e6
    risk = np.asarray(calibrated_risk_m(fit(distinctness, squared, known), distinctness))[~known]
    held_out = squared[~known]
    assert risk.min() < 20 < 60 < risk.max()
    for part in (risk < 50, risk >= 50, risk >= 0):
        assert np.sqrt(held_out[part].mean()) == pytest.approx(np.sqrt((risk[part] ** 2).mean()), rel=0.15)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.floats(0, 1e5, width=32), st.integers(1, 200)), min_size=LEVELS, max_size=LEVELS))
def test_the_regression_never_rises_and_keeps_the_mean(pairs):
    values, weights = np.float32(pairs).T
    found = np.asarray(jax.jit(not_rising)(values, weights))
    np.testing.assert_allclose(
        found, isotonic_regression(values, weights=weights, increasing=False).x, rtol=1e-4, atol=1e-3
    )
    assert np.all(np.diff(found) <= 1e-4 * np.abs(found[1:]) + 1e-6)


def test_a_larger_distinctness_never_claims_a_larger_risk():
    distinctness, squared, known = frames(300, 3)
    found = fit(distinctness, squared, known)
    grid = np.repeat(np.linspace(-5, 5, 201, dtype=np.float32)[:, None], 3, axis=1)
    assert np.all(np.diff(calibrated_risk_m(found, grid), axis=0) <= 0)

"""The median predictor."""

import jax
import numpy as np
import pytest

from ovibjax.control.predictor import fit_predictor, predictor_of_known


def test_predictor_is_the_median_by_context_and_action():
    rng = np.random.default_rng(0)
    residual, context = rng.exponential(size=(50, 8)), rng.integers(0, 3, 50)
    context[context == 1] = 2  # context 1 is never met
    found = fit_predictor(residual, context, 4)
    assert found.shape == (4, 8) and found.dtype == np.float32
    for c in range(4):
        for a in range(8):
            seen = sorted(residual[i, a] for i in range(50) if context[i] == c or c in (1, 3))
            middle = (seen[(len(seen) - 1) // 2] + seen[len(seen) // 2]) / 2
            assert found[c, a] == pytest.approx(middle, rel=1e-6)
    # Inside a program the training frames are a mask; others must not matter.
    padded = np.concatenate([residual, 1e3 * residual[:7]]).astype(np.float32)
    known = np.arange(57) < 50
    fitted = jax.jit(predictor_of_known, static_argnums=3)(padded, np.concatenate([context, context[:7]]), known, 4)
    np.testing.assert_allclose(fitted, found, rtol=1e-5)


def test_an_outlier_does_not_move_the_predictor():
    residual = np.array([[1.0], [2.0], [3.0], [4.0], [1000.0]])
    assert fit_predictor(residual, np.zeros(5, int), 1)[0, 0] == 3.0

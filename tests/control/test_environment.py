"""The drift rates that the paper's budget implies."""

import numpy as np
import pytest

from ovibjax.control.environment import rates_from_paper


def test_drift_of_unknown_contexts_is_the_mean():
    share = np.array([0.3, 0.2, 0.1, 0.4])
    rates = np.asarray(rates_from_paper(share), np.float64)
    assert rates @ share * 593 * 0.5 == pytest.approx(22 * 27**0.5, rel=1e-5)
    assert rates[3] == pytest.approx(22 * 27**0.5 / (593 * 0.5), rel=1e-5)
    only_unknown = rates_from_paper(np.array([0.0, 0.0, 0.0, 1.0]))
    assert np.all(np.isfinite(only_unknown)) and only_unknown[3] == pytest.approx(rates[3])

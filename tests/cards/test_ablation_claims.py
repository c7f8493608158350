"""Verdicts of the ablation that turn on a premise or on an absence: each can hold, fail, and say nothing."""

import numpy as np
import pytest

from ovibjax.cards.ablation_claims import _gamma, _proposition
from ovibjax.encoder.orthogonality import SingularValues
from ovibjax.report.claims import HELD, NOT_HELD, ON_AVERAGE, SILENT

BASE_M = np.array([4.0, 4.4, 3.8, 4.1])


class Found:
    """An ablation whose validation error at every larger weight is the paper's times a factor."""

    def __init__(self, factor):
        self.factor = factor

    def at(self, variant, k, metric):
        assert (k, metric) == (35, "val_mean_m")
        return BASE_M * (1.0 if variant == "full" else self.factor)

    def selected_gamma(self, k):
        return 10.0


@pytest.mark.parametrize(
    ("factor", "verdict"),
    [
        (np.array([1.00, 0.99, 1.01, 0.98]), HELD),  # better on average, and no gain that the paper would call one
        (np.array([1.00, 0.85, 1.10, 0.95]), ON_AVERAGE),
        (np.array([0.91, 0.90, 0.92, 0.90]), NOT_HELD),
        (np.array([1.30, 1.20, 1.40, 1.30]), HELD),
    ],
)
def test_no_improvement_is_judged_by_what_is_excluded(factor, verdict):
    assert _gamma((0.1, 1.0, 10.0), Found(factor)).verdict == verdict


def spectrum(epsilon, values):
    epsilon = np.full(2, epsilon)
    lower, upper = np.sqrt(np.maximum(1 - epsilon, 0)), np.sqrt(1 + epsilon)
    return SingularValues(np.tile(np.array(values), (2, 1)), epsilon, lower, upper)


def test_the_proposition_is_judged_where_its_premise_is_met():
    inside, outside, vacuous = spectrum(0.5, [0.8, 1.2]), spectrum(0.5, [0.2, 1.2]), spectrum(1.2, [0.0, 1.4])
    assert _proposition({0.1: inside}).verdict == HELD == _proposition({0.0: vacuous, 0.1: inside}).verdict
    assert _proposition({0.1: inside, 1.0: outside}).verdict == NOT_HELD
    silent = _proposition({0.0: vacuous})
    assert silent.verdict == SILENT and "nothing is promised" in silent.ours

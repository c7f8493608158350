"""Verdicts on adaptation from results made up by hand."""

import numpy as np

from ovibjax.cards.adaptation_arms import ARMS, Arms
from ovibjax.cards.adaptation_claims import judge_claims, less_percent
from ovibjax.cards.adaptation_study import WORLDS, AdaptationStudy
from ovibjax.control.predictor import PRIORS

SEEDS, SLOTS = 8, 30


def study(reported=0.8, unchanged=1.01, repetitive_differs=True):
    """Errors of 10 m with the prior of training; of the adapted one in changed worlds and in the unchanged one."""
    rng = np.random.default_rng(0)
    static = 10.0 + rng.normal(size=(SEEDS, 1)) + np.zeros((len(WORLDS), SEEDS, SLOTS))
    share = np.where(np.arange(len(WORLDS)) == WORLDS.index("unchanged"), unchanged, reported)[:, None, None]
    jitter = rng.normal(scale=0.01, size=(SEEDS, 1))
    errors = np.stack([static * (1.0 if arm == "static" else share + jitter) for arm in ARMS])
    kb = np.stack([np.full((len(WORLDS), SEEDS), 5.0 if arm == "reported" else 6.0) for arm in ARMS])
    truth = np.arange(len(WORLDS), dtype=float)[:, None, None] + np.zeros((1, SLOTS, 8))
    if not repetitive_differs:
        truth[WORLDS.index("repetitive")] = truth[WORLDS.index("unchanged")]
    arms = Arms(errors, kb, (10 * kb).astype(int), None)
    both = dict.fromkeys(PRIORS, truth)
    return AdaptationStudy(
        None, np.zeros(SLOTS, int), 10, 12.6, {}, {}, both, dict.fromkeys(PRIORS, arms), list(range(SEEDS))
    )


def verdicts(found, start):
    return [claim.verdict for claim in judge_claims(found) if start in claim.statement]


def test_what_adaptation_takes_off_is_judged_on_pairs():
    found = study()
    assert verdicts(found, "leads to a lower route error") == ["held"] * 8
    assert verdicts(found, "costs less than 3 %") == ["held"] * 2
    assert verdicts(found, "probes find it") == ["held"]
    assert abs(less_percent(found, "reported", "front").mean - 20.0) < 2.0
    assert all(claim.own for claim in judge_claims(found))


def test_a_loss_is_not_held():
    found = study(reported=1.2, unchanged=1.05)
    assert set(verdicts(found, "leads to a lower route error")) == {"not held"}
    assert set(verdicts(found, "costs less than 3 %")) == {"not held"}


def test_a_drive_without_repetitive_blocks_says_nothing():
    found = verdicts(
        study(repetitive_differs=False), "Where repetitive blocks are answered as corridors, a prior that adapts leads"
    )
    assert found == ["says nothing here"] * 2

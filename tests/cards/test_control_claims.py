"""What the paper says of request control: every rule can hold, and every rule can fail."""

from types import SimpleNamespace

import numpy as np
import pytest

from ovibjax.cards import control_claims, view_rate_claims
from ovibjax.cards.catalog import cards_folder, load_card
from ovibjax.cards.control_drawing import PAPER_MEAN_M, PAPER_P95_M
from ovibjax.control.actions import ACTIONS
from ovibjax.features.frames import CONTEXTS
from ovibjax.report.claims import HELD, NOT_HELD, REPORTED, SILENT

SEEDS, SLOTS = 12, 120
timing = load_card(cards_folder() / "voi_timing.py")


class Study(SimpleNamespace):
    """What claims read off a study; errors by policy, the same at every setting."""

    points = ()

    def of(self, policy, metric, point=None):
        noise = np.random.default_rng(len(policy)).normal(size=SEEDS)
        if metric in ("mean_m", "p95_m"):
            errors = self.mean_m if metric == "mean_m" else self.p95_m
            return errors.get(policy, 5.0) + 0.01 * noise
        return np.full(SEEDS, 22 if policy == "voi" or self.equal else 21)

    def free_kb(self, point=None):
        return np.full(SEEDS, self.kb)


def study(modes=("A5", "FS", "FS"), low=(0.01, 0.1, 0.3), prior=None, prefix=16, **other):
    """A route whose first half is corridor; requests with these modes in such shares of the slots of a context."""
    rng = np.random.default_rng(1)
    context = np.repeat([0, 1, 2], [SLOTS // 2, SLOTS // 4, SLOTS // 4])
    sent = np.zeros((SEEDS, SLOTS), bool)
    for c, share in enumerate(low):
        (here,) = np.flatnonzero(context == c).reshape(1, -1)
        for seed in range(SEEDS):
            sent[seed, rng.choice(here, max(1, round(share * len(here))), replace=False)] = True
    action = np.array([ACTIONS.index(mode, prefix) for mode in modes])[context] * np.ones((SEEDS, 1), int)
    risk = np.where(sent, 7.5, 4.0) + 0.1 * rng.normal(size=sent.shape)
    quick, slow = 0.02 + 0.001 * rng.random(sent.shape), 0.04 + 0.001 * rng.random(sent.shape)

    def run(sent, risk_before_m, delay_s, rate_bps):
        after = 3.0 + 0.1 * rng.normal(size=sent.shape)
        names = {"sent": sent, "action": action, "risk_before_m": risk_before_m, "risk_m": after}
        return SimpleNamespace(**names, delay_s=delay_s, rate_bps=rate_bps)

    even = np.roll(sent, 7, axis=1)
    compact = np.array([[9.0, 3.0, 2.9, 2.8]] * 3) if prior is None else np.array([prior] * 3)
    return Study(
        **{"mean_m": PAPER_MEAN_M, "p95_m": PAPER_P95_M, "equal": True, "kb": 2.07} | other,
        runs={"voi": run(sent, risk, quick, 9e4 - quick), "budgeted_periodic": run(even, risk, slow, 6e4 - slow)},
        route=SimpleNamespace(context=context),
        scene=SimpleNamespace(contexts=CONTEXTS, actions=ACTIONS, predictor_m=np.repeat(compact, 2, axis=1)),
    )


def verdicts(claims):
    return {claim.statement: claim.verdict for claim in claims}


def test_the_papers_own_errors_hold_and_the_opposite_fails():
    # What an action is expected to leave, and other drift, are reported and not judged.
    claims = control_claims.judge_claims(study())
    papers = [claim for claim in claims if not claim.own]
    assert {claim.verdict for claim in papers} == {HELD} and len(papers) == 10
    assert {claim.verdict for claim in claims if claim.own} == {HELD, REPORTED}
    turned = {name: 10.0 - value for name, value in PAPER_MEAN_M.items()}
    tails = {name: 20.0 - value for name, value in PAPER_P95_M.items()}
    claims = control_claims.judge_claims(study(mean_m=turned, p95_m=tails, prefix=32, kb=2.2, equal=False))
    assert {claim.verdict for claim in claims} == {NOT_HELD, REPORTED}


def test_modes_by_context():
    name = "Most requests use all five views in corridors, front plus sides in intersections and repetitive blocks"
    assert verdicts(view_rate_claims.judge_claims(study()))[name] == HELD
    # What came of it here: front plus sides in corridors, all five in repetitive blocks.
    assert verdicts(view_rate_claims.judge_claims(study(modes=("FS", "FS", "A5"))))[name] == NOT_HELD


def test_every_claim_on_views_can_hold_and_can_fail():
    assert set(verdicts(view_rate_claims.judge_claims(study())).values()) == {HELD}
    found = study(modes=("FS", "FS", "A5"), low=(0.3, 0.1, 0.03), prior=(3.0, 3.1, 2.0, 2.1))
    found.runs["voi"].risk_before_m[:] = 18.0
    assert set(verdicts(view_rate_claims.judge_claims(found)).values()) == {NOT_HELD}


def test_a_route_without_known_contexts_says_nothing():
    found = study()
    found.route.context[:] = len(CONTEXTS)
    judged = view_rate_claims.judge_claims(found)
    assert [claim.verdict for claim in judged[:4]] == [SILENT] * 4


@pytest.mark.parametrize("turned", [False, True])
def test_timing_follows_risk_queue_and_link(turned):
    found = study()
    if turned:
        found.runs = {"voi": found.runs["budgeted_periodic"], "budgeted_periodic": found.runs["voi"]}
    judged = timing.judge_claims(found)
    assert len(judged) == 3 and {claim.verdict for claim in judged} == {NOT_HELD if turned else HELD}
    assert "KB/s" in judged[2].ours and "ms" in judged[1].ours

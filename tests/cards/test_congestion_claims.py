"""What the paper says of schedulers under congestion: every rule can hold, and every rule can fail."""

import numpy as np
import pytest

from ovibjax.cards.catalog import cards_folder, load_card
from ovibjax.cards.congestion_claims import ORDER, judge_claims
from ovibjax.cards.congestion_drawing import PAPER_ALL_EDGE_MS, PAPER_TOP
from ovibjax.cards.congestion_study import Congestion
from ovibjax.report.claims import HELD, NOT_HELD, REPORTED, interval
from ovibjax.scheduling.congestion import LEVELS
from ovibjax.scheduling.replay_metrics import GroupMetrics, ReplayMetrics
from ovibjax.scheduling.rules import POLICIES
from ovibjax.scheduling.ties import TIES

SEEDS = 8


def levels_of(top, every):
    """Metrics by rule: the paper's at high congestion, nearer together at lower ones; seeds differ alike."""
    noise = 1.0 + 0.02 * np.random.default_rng(0).normal(size=(1, SEEDS, 1))
    share = np.array([0.2, 0.5, 1.0])[:, None, None] * np.ones((1, 1, len(TIES)))

    def group(values):
        return GroupMetrics(*(value * share * noise for value in values))

    return {rule: ReplayMetrics(group(top[rule]), group([every[rule]] * 5)) for rule in POLICIES}


def papers_top(sign=1.0):
    """The paper's top decile, or one in which all that is good is bad."""
    rows = {}
    for rule in POLICIES:
        edge, e2e, cost, stale = (
            of.get(rule, 1.1 * max(of.values())) if sign > 0 else 1.0 / of.get(rule, 1.1 * max(of.values()))
            for of in (PAPER_TOP[name] for name in ("edge_p95_ms", "e2e_p95_ms", "cost", "stale_m"))
        )
        rows[rule] = (edge, e2e, stale, cost, cost)
    return rows


def verdicts(top, every):
    levels = levels_of(top, every)
    found = Congestion(levels, levels, levels, {}, 13)
    return {claim.statement: claim for claim in judge_claims(found)}


def test_the_papers_own_numbers_hold():
    claims = verdicts(papers_top(), PAPER_ALL_EDGE_MS)
    assert {claim.verdict for claim in claims.values()} == {HELD, REPORTED}
    assert sum(claim.statement.startswith("All requests at high congestion: ") for claim in claims.values()) == 8
    assert len(ORDER) == len(set(ORDER)) == 8
    own = [statement for statement, claim in claims.items() if claim.own]
    assert len(own) == 3 and all(claims[name].paper != "76.2 %" for name in own)


def test_the_opposite_fails():
    # One over each: the order is reversed, Base-DPP is the faster one, and more so where congestion is high.
    claims = verdicts(papers_top(-1.0), {rule: 1e4 / value for rule, value in PAPER_ALL_EDGE_MS.items()})
    judged = {name: claim.verdict for name, claim in claims.items() if claim.verdict != REPORTED}
    assert {name for name, verdict in judged.items() if verdict != NOT_HELD} == {
        "Top decile at high congestion: Base-DPP, MaxWeight and FIFO differ"
    }


def test_rules_that_are_one_do_not_differ():
    claims = verdicts(papers_top(), dict.fromkeys(POLICIES, 100.0))
    assert {claim.verdict for name, claim in claims.items() if name.startswith("All requests")} == {NOT_HELD}


@pytest.mark.parametrize(("cut", "verdict"), [(76.2, HELD), (21.6, NOT_HELD)])
def test_a_cut_is_judged_by_its_size(cut, verdict):
    top = papers_top()
    top["voi_lyapunov"] = ((1.0 - cut / 100.0) * top["base_dpp"][0], *top["voi_lyapunov"][1:])
    claims = verdicts(top, PAPER_ALL_EDGE_MS)
    statement = "Top decile at high congestion: VOI-Lyapunov cuts the edge p95 of Base-DPP"
    assert claims[f"{statement} by at least 60 %"].verdict == verdict and claims[statement].verdict == HELD
    assert list(LEVELS) == ["low", "medium", "high"]


def test_the_caption_says_what_fifo_comes_to_and_how_many_seeds_are_behind_a_panel():
    levels = levels_of(papers_top(), PAPER_ALL_EDGE_MS)
    found = Congestion(levels, levels, levels, levels, 13)
    text = load_card(cards_folder() / "multi_client.py").caption(found, [1, 2])
    fifo = interval(found.at("fifo", "all", "edge_p95_ms")).text("ms", 0)
    assert f"here it is {fifo})" in text and f"{SEEDS} seeds. " in text and "; 2 seeds perturb" in text

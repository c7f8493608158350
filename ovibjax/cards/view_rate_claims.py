"""What the paper says of VOI-Control's uploads by context and view mode, judged on held-out seeds."""

import numpy as np

from ovibjax.cards.control_results import PAIRED
from ovibjax.cards.control_study import ControlStudy
from ovibjax.report.claims import Claim, Interval, interval

PAPER_SHARE = {"corridor": 0.5, "intersection": 5.7, "repetitive": 14.0}
"""Per cent of slots with an upload (paper, Section "View-Rate Selection")."""

PAPER_MODE = {"corridor": "A5", "intersection": "FS", "repetitive": "FS"}
"""Views of VOI-Control's requests: "rare all-five compact requests in corridor scenes and front-plus-sides compact
requests in intersection and repetitive scenes" (same section)."""

MUCH_LARGER, CLOSE = 2.0, 1.25
"""Times the best compact prior: at least so much is "much larger", at most so much "close to the best"; ours."""


def upload_percent(found: ControlStudy, context: int, mode: str | None = None) -> np.ndarray:
    """[seeds] per cent of a context's slots with an upload (of one mode); NaN where the route has no such slot."""
    run, here = found.runs["voi"], found.route.context == context
    sent = run.sent & here
    if mode is not None:
        names = np.array(found.scene.actions.modes)
        sent = sent & (names[run.action // len(found.scene.actions.prefixes)] == mode)
    slots = here.sum()
    return np.where(slots > 0, 100.0 * sent.sum(axis=1) / max(slots, 1), np.nan)


def at_requests(found: ControlStudy, context: int, field: str) -> np.ndarray:
    """[seeds] median of a field over VOI-Control's requests in a context; seeds without one are left out."""
    run = found.runs["voi"]
    chosen = run.sent & (found.route.context == context)
    values = getattr(run, field)
    return np.array([np.median(values[i][chosen[i]]) for i in range(len(values)) if chosen[i].any()], np.float64)


def span_of(values: np.ndarray) -> Interval:
    """Interval over the seeds that have a number."""
    return interval(values[np.isfinite(values)])


def judge_claims(found: ControlStudy) -> list[Claim]:
    """What the paper says of modes and contexts."""
    contexts = found.scene.contexts
    compact = found.scene.predictor_m[:, :: len(found.scene.actions.prefixes)]
    ratio = compact / compact.min(axis=1, keepdims=True)
    front = ratio[:, 0]
    return [
        _more_uploads(found, 1, 0),
        _more_uploads(found, 2, 1),
        _modes(found),
        _risk(found),
        Claim.true(
            "The front-only compact prior is much larger than the best compact prior",
            "much larger residuals",
            f"{', '.join(f'{r:.2f}' for r in front)} times the best ({', '.join(contexts)})",
            bool((front >= MUCH_LARGER).all()),
            "at least twice in every context (the paper gives no number)",
        ),
        *_close(found, ratio),
    ]


def _close(found: ControlStudy, ratio: np.ndarray) -> list[Claim]:
    """Front plus sides and all five against the best, where a platform has all five."""
    contexts, modes = found.scene.contexts, found.scene.actions.modes
    if "A5" not in modes:
        return []
    wide = ratio[:, [modes.index(mode) for mode in ("FS", "A5")]]
    texts = [f"{fs:.2f} / {a5:.2f}" for fs, a5 in wide]
    return [
        Claim.true(
            "The compact priors of front plus sides and of all five views are close to the best compact prior",
            "close to the best compact residual",
            f"{', '.join(texts)} times the best ({', '.join(contexts)})",
            bool((wide <= CLOSE).all()),
            f"at most {CLOSE:g} times in every context (the paper gives no number)",
        )
    ]


def mode_percent(found: ControlStudy, context: int, mode: str) -> np.ndarray:
    """[seeds] per cent of VOI-Control's requests in a context that use a mode; seeds without one are left out."""
    part, every = upload_percent(found, context, mode), upload_percent(found, context)
    some = every > 0  # NaN, of a route without such slots, is not
    return 100.0 * part[some] / every[some]


def _modes(found: ControlStudy) -> Claim:
    statement = "Most requests use all five views in corridors, front plus sides in intersections and repetitive blocks"
    paper = " / ".join(PAPER_MODE.values())
    if not np.isin(found.route.context, range(len(PAPER_MODE))).any():
        return Claim.silent(statement, paper, "the contexts of the route are unknown", "nothing to compare")
    shares = [mode_percent(found, c, mode) for c, mode in enumerate(PAPER_MODE.values())]
    texts = [
        f"{interval(share).text('%', 0)} of those in {name}" for share, name in zip(shares, PAPER_MODE, strict=True)
    ]
    rule = "whole 95 % interval of the share of every context at or above a half"
    return Claim.at_least(statement, paper, f"{', '.join(texts)} use them", 50.0, *shares, rule=rule)


def _risk(found: ControlStudy) -> Claim:
    statement = "Requests bring the local risk from 6 to 9 m down to 2 to 4 m in every context"
    paper = "6 to 9 m, 2 to 4 m"
    named = range(len(PAPER_SHARE))
    if not np.isin(found.route.context, named).any():
        return Claim.silent(statement, paper, "the contexts of the route are unknown", "nothing to compare")
    before, after = ([span_of(at_requests(found, c, f)) for c in named] for f in ("risk_before_m", "risk_m"))
    # A context without requests has no interval and is not inside.
    inside = [low <= s.low and s.high <= high for part, low, high in ((before, 6, 9), (after, 2, 4)) for s in part]
    return Claim.true(
        statement,
        paper,
        f"before {', '.join(s.text('m', 1) for s in before)}; after {', '.join(s.text('m', 1) for s in after)} "
        f"({', '.join(found.scene.contexts[:3])})",
        all(inside),
        "whole 95 % interval of the median of every context within the paper's ranges",
    )


def _more_uploads(found: ControlStudy, more: int, less: int) -> Claim:
    shares = [upload_percent(found, c) for c in range(len(PAPER_SHARE))]
    both = np.isfinite(shares).all(axis=0)
    difference = (shares[more] - shares[less])[both]
    texts = " / ".join(span_of(shares[c]).text("%", 1) for c in (more, less))
    a, b = (found.scene.contexts[c] for c in (more, less))
    statement = f"VOI-Control uploads in a larger share of {a} than of {b} slots"
    paper = f"{PAPER_SHARE[a]} % / {PAPER_SHARE[b]} %"
    if not len(difference):
        return Claim.silent(statement, paper, "the route has no slots of the one or the other", "nothing to compare")
    return Claim.above_zero(
        statement,
        paper,
        f"{texts}, difference {span_of(difference).text('%', 1)}",
        difference,
        rule=PAIRED,
    )

"""Fig. "View-mode behavior under the budget": where uploads go, what they change, and the prior behind the choice."""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ovibjax.cards.control_drawing import MODE_COLOURS
from ovibjax.cards.control_results import PAIRED, study
from ovibjax.cards.control_study import ControlStudy
from ovibjax.cards.job import Job
from ovibjax.report import figures as fig
from ovibjax.report import panels
from ovibjax.report.claims import Claim, Interval, interval, write_claims
from ovibjax.report.rows import write_rows

TITLE = "View-rate selection by context"
PAPER_SHARE = {"corridor": 0.5, "intersection": 5.7, "repetitive": 14.0}


def run(job: Job) -> None:
    """Run the card: study, table, claims, figure."""
    started = time.perf_counter()
    found = study(job)
    write_rows(job.out / "table.csv", table_rows(found))
    write_claims(job.out / "claims.json", judge_claims(found))
    with job.stage("draw"):
        panels.draw_panels(job.out / "figure.png", found, PANELS, 3, height_in=2.3)
    job.record(TITLE, caption(found), found.seeds, started)


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


def _span(values: np.ndarray) -> Interval:
    return interval(values[np.isfinite(values)])


def table_rows(found: ControlStudy) -> list[dict[str, Any]]:
    """One row per context and mode: upload share; risk before and after, residual; prior of the compact action."""
    rows = []
    for c, context in enumerate(found.scene.contexts):
        before, after, residual = (_span(at_requests(found, c, f)) for f in ("risk_before_m", "risk_m", "residual_m"))
        for m, mode in enumerate(found.scene.actions.modes):
            share = _span(upload_percent(found, c, mode))
            rows.append(
                {
                    "context": context,
                    "mode": mode,
                    "upload_percent": share.mean,
                    "upload_half": share.half,
                    "risk_before_m": before.mean,
                    "risk_after_m": after.mean,
                    "residual_m": residual.mean,
                    "prior_compact_m": float(found.scene.predictor_m[c, m * len(found.scene.actions.prefixes)]),
                }
            )
    return rows


def judge_claims(found: ControlStudy) -> list[Claim]:
    """What the paper says of modes and contexts."""
    contexts = found.scene.contexts
    compact = found.scene.predictor_m[:, :: len(found.scene.actions.prefixes)]
    ratio = compact[:, 0] / compact.min(axis=1)
    return [
        _more_uploads(found, 1, 0),
        _more_uploads(found, 2, 1),
        _risk(found),
        Claim.true(
            "The front-only compact prior is much larger than the best compact prior",
            "much larger residuals",
            f"{', '.join(f'{r:.2f}' for r in ratio)} times the best ({', '.join(contexts)})",
            bool((ratio >= 2).all()),
            "at least twice in every context (the paper gives no number)",
        ),
    ]


def _risk(found: ControlStudy) -> Claim:
    statement = "Requests bring the local risk from 6 to 9 m down to 2 to 4 m in every context"
    paper = "6 to 9 m, 2 to 4 m"
    named = range(len(PAPER_SHARE))
    if not np.isin(found.route.context, named).any():
        return Claim.silent(statement, paper, "the contexts of the route are unknown", "nothing to compare")
    before, after = ([_span(at_requests(found, c, f)) for c in named] for f in ("risk_before_m", "risk_m"))
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
    texts = " / ".join(_span(shares[c]).text("%", 1) for c in (more, less))
    a, b = (found.scene.contexts[c] for c in (more, less))
    statement = f"VOI-Control uploads in a larger share of {a} than of {b} slots"
    paper = f"{PAPER_SHARE[a]} % / {PAPER_SHARE[b]} %"
    if not len(difference):
        return Claim.silent(statement, paper, "the route has no slots of the one or the other", "nothing to compare")
    return Claim.above_zero(
        statement,
        paper,
        f"{texts}, difference {_span(difference).text('%', 1)}",
        difference,
        rule=PAIRED,
    )


def caption(found: ControlStudy) -> str:
    """What the reader of the figure needs to know."""
    return (
        f"VOI-Control on {len(found.seeds)} held-out seeds, 95 % intervals. (a) Share of slots with an upload "
        "by context and view mode; black ticks: the paper's totals, to which the drift rates of the contexts are "
        "proportional, so that their order is partly put in. (b) Medians: local risk before a request and after "
        "its correction, as the client holds it, and the realised residual of the position that the edge returned. "
        "(c) Train-only median residual of the compact actions."
    )


def _small_names(ax: Axes, contexts: Sequence[str]) -> None:
    """Names of contexts side by side, smaller where `unknown` is a fourth."""
    if len(contexts) > len(PAPER_SHARE):
        ax.tick_params(axis="x", labelsize=5.5)


def _draw_share(ax: Axes, found: ControlStudy) -> None:
    contexts = found.scene.contexts
    x = range(len(contexts))
    bottom = np.zeros(len(x))
    for mode in found.scene.actions.modes:
        share = np.array([np.nan_to_num(_span(upload_percent(found, c, mode)).mean) for c in x])
        if share.any():
            ax.bar(x, share, 0.6, bottom=bottom, color=MODE_COLOURS[mode], label=mode)
        bottom += share
    caps = [_span(upload_percent(found, c)).cap for c in x]
    ax.errorbar(x, bottom, yerr=caps, fmt="none", color="black", lw=1, capsize=2)
    paper = [PAPER_SHARE.get(name, np.nan) for name in contexts]
    ax.plot(x, paper, "_", ms=13, mew=1.6, color="black", label="paper, total")
    ax.set_xticks(x, contexts)
    _small_names(ax, contexts)
    ax.grid(visible=False, axis="x")
    ax.set(ylabel="slots with an upload (%)")
    ax.legend(loc="upper left")


def _draw_risk(ax: Axes, found: ControlStudy) -> None:
    fields = (("risk_before_m", "risk before", fig.GREY), ("risk_m", "risk after", fig.BLUE))
    series = []
    for field, label, colour in (*fields, ("residual_m", "residual", fig.ORANGE)):
        spans = [_span(at_requests(found, c, field)) for c in range(len(found.scene.contexts))]
        series.append((label, colour, [Interval(float(np.nan_to_num(span.mean)), span.half) for span in spans]))
    panels.columns(ax, found.scene.contexts, series)
    _small_names(ax, found.scene.contexts)
    top = max(span.mean + span.cap for _, _, spans in series for span in spans)
    ax.set(ylabel="median (m)", ylim=(0, 1.3 * max(1.0, top)))
    ax.legend(loc="upper center", ncols=3, columnspacing=0.8, handlelength=1.0)


def _draw_prior(ax: Axes, found: ControlStudy) -> None:
    compact = found.scene.predictor_m[:, :: len(found.scene.actions.prefixes)]
    modes = found.scene.actions.modes
    series = [(mode, MODE_COLOURS[mode], [Interval(m, 0.0) for m in compact[:, i]]) for i, mode in enumerate(modes)]
    panels.columns(ax, found.scene.contexts, series)
    _small_names(ax, found.scene.contexts)
    ax.set(ylabel="median residual (m)", ylim=(0, 1.3 * float(found.scene.predictor_m.max())))
    ax.legend(loc="upper center", ncols=4, columnspacing=0.8, handlelength=1.0)


PANELS = {
    "uploads by context and mode": _draw_share,
    "what a request changes": _draw_risk,
    "compact prior": _draw_prior,
}

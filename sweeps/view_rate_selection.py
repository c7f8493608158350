"""Fig. "View-mode behavior under the budget": where uploads go, what they change, and the prior behind the choice."""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ovibjax.cards.control_drawing import MODE_COLOURS
from ovibjax.cards.control_results import study
from ovibjax.cards.control_study import ControlStudy
from ovibjax.cards.job import Job
from ovibjax.cards.view_rate_claims import PAPER_SHARE, at_requests, judge_claims, span_of, upload_percent
from ovibjax.report import figures as fig
from ovibjax.report import panels
from ovibjax.report.claims import Interval, write_claims
from ovibjax.report.rows import write_rows

TITLE = "View-rate selection by context"


def run(job: Job) -> None:
    """Run the card: study, table, claims, figure."""
    started = time.perf_counter()
    found = study(job)
    write_rows(job.out / "table.csv", table_rows(found))
    write_claims(job.out / "claims.json", judge_claims(found))
    with job.stage("draw"):
        panels.draw_panels(job.out / "figure.png", found, PANELS, 3, height_in=2.3)
    job.record(TITLE, caption(found), found.seeds, started)


def table_rows(found: ControlStudy) -> list[dict[str, Any]]:
    """One row per context and mode: upload share; risk before and after, residual; prior of the compact action."""
    rows = []
    for c, context in enumerate(found.scene.contexts):
        before, after, residual = (span_of(at_requests(found, c, f)) for f in ("risk_before_m", "risk_m", "residual_m"))
        for m, mode in enumerate(found.scene.actions.modes):
            share = span_of(upload_percent(found, c, mode))
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
        share = np.array([np.nan_to_num(span_of(upload_percent(found, c, mode)).mean) for c in x])
        if share.any():
            ax.bar(x, share, 0.6, bottom=bottom, color=MODE_COLOURS[mode], label=mode)
        bottom += share
    caps = [span_of(upload_percent(found, c)).cap for c in x]
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
        spans = [span_of(at_requests(found, c, field)) for c in range(len(found.scene.contexts))]
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

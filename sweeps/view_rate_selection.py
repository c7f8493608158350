"""Fig. "View-mode behavior under the budget": where uploads go, what they change, and the prior behind the choice."""

import time
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from ovibjax.cards.control_drawing import MODE_COLOURS, study
from ovibjax.cards.control_study import ControlStudy
from ovibjax.cards.job import Job
from ovibjax.report import figures as fig
from ovibjax.report.claims import HELD, NOT_HELD, Claim, Interval, interval, positive, write_claims
from ovibjax.report.rows import write_rows

TITLE = "View-rate selection by context"
PAPER_SHARE = {"corridor": 0.5, "intersection": 5.7, "repetitive": 14.0}


def run(job: Job) -> None:
    """Run the card: study, table, claims, figure."""
    started = time.perf_counter()
    found = study(job)
    write_rows(job.out / "table.csv", table_rows(found))
    write_claims(job.out / "claims.json", judge_claims(found))
    draw(job.out / "figure.png", found)
    job.record(TITLE, caption(found), found.seeds, started)


def upload_percent(found: ControlStudy, context: int, mode: str | None = None) -> np.ndarray:
    """[seeds] per cent of a context's slots with an upload (of one mode); NaN where the route has no such slot."""
    run, here = found.runs["voi"], found.routes.context == context
    sent = run.sent & here
    if mode is not None:
        names = np.array(found.scene.actions.modes)
        sent = sent & (names[run.action // len(found.scene.actions.prefixes)] == mode)
    slots = here.sum(axis=1)
    return np.where(slots > 0, 100.0 * sent.sum(axis=1) / np.maximum(slots, 1), np.nan)


def at_requests(found: ControlStudy, context: int, field: str) -> np.ndarray:
    """[seeds] median of a field over VOI-Control's requests in a context; seeds without one are left out."""
    run = found.runs["voi"]
    chosen = run.sent & (found.routes.context == context)
    values = getattr(run, field)
    return np.array([np.median(values[i][chosen[i]]) for i in range(len(values)) if chosen[i].any()], np.float64)


def _span(values: np.ndarray) -> Interval:
    values = values[np.isfinite(values)]
    return interval(values) if len(values) else Interval(float("nan"), float("inf"))


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
    shares = [upload_percent(found, c) for c in range(len(PAPER_SHARE))]
    both = np.isfinite(shares[0]) & np.isfinite(shares[1]) & np.isfinite(shares[2])
    claims = []
    for low, high in ((0, 1), (1, 2)):
        a, b = found.scene.contexts[low], found.scene.contexts[high]
        span = _span((shares[high] - shares[low])[both])
        claims.append(
            Claim(
                f"VOI-Control uploads in a larger share of {b} than of {a} slots",
                f"{PAPER_SHARE[b]} % / {PAPER_SHARE[a]} %",
                " / ".join(_span(shares[c]).text("%", 1) for c in (high, low)) + f", difference {span.text('%', 1)}",
                positive(span) if np.isfinite(span.mean) else NOT_HELD,
                "whole 95 % interval of the paired difference above zero",
            )
        )
    spans = {f: [_span(at_requests(found, c, f)) for c in range(len(PAPER_SHARE))] for f in ("risk_before_m", "risk_m")}
    before, after = spans["risk_before_m"], spans["risk_m"]
    # A context without requests has no interval and is not inside.
    inside = [low <= s.low and s.high <= high for part, low, high in ((before, 6, 9), (after, 2, 4)) for s in part]
    claims.append(
        Claim(
            "Requests bring the local risk from 6 to 9 m down to 2 to 4 m in every context",
            "6 to 9 m, 2 to 4 m",
            f"before {', '.join(s.text('m', 1) for s in before)}; after {', '.join(s.text('m', 1) for s in after)} "
            f"({', '.join(found.scene.contexts[:3])})",
            HELD if all(inside) else NOT_HELD,
            "whole 95 % interval of the median of every context within the paper's ranges",
        )
    )
    step = len(found.scene.actions.prefixes)
    compact = found.scene.predictor_m[:, ::step]
    ratio = compact[:, 0] / compact.min(axis=1)
    claims.append(
        Claim(
            "The front-only compact prior is much larger than the best compact prior",
            "much larger residuals",
            f"{', '.join(f'{r:.2f}' for r in ratio)} times the best ({', '.join(found.scene.contexts)})",
            HELD if (ratio >= 2).all() else NOT_HELD,
            "at least twice in every context (the paper gives no number)",
        )
    )
    return claims


def caption(found: ControlStudy) -> str:
    """What the reader of the figure needs to know."""
    return (
        f"VOI-Control on {len(found.seeds)} held-out seeds, 95 % intervals. (a) Share of slots with an upload "
        "by context and view mode; black ticks: the paper's totals. (b) Medians: local risk before a request and after "
        "its correction, and the realised residual of the position that the edge returned. (c) Train-only "
        "median residual of the compact actions."
    )


def draw(path: Path, found: ControlStudy) -> None:
    """The three panels."""
    with mpl.rc_context(fig.style()):
        figure, axes = fig.panels(3, 1, height_in=2.3)
        contexts = list(found.scene.contexts)
        x = np.arange(len(contexts))
        _draw_share(axes[0], found, x)
        _draw_risk(axes[1], found, x)
        modes = found.scene.actions.modes
        step = len(found.scene.actions.prefixes)
        for m, mode in enumerate(modes):
            offset = (m - (len(modes) - 1) / 2) * 0.2
            axes[2].bar(x + offset, found.scene.predictor_m[:, m * step], 0.18, color=MODE_COLOURS[mode], label=mode)
        axes[2].set(ylabel="median residual (m)")
        axes[2].set_ylim(0, 1.3 * float(found.scene.predictor_m.max()))
        axes[2].legend(loc="upper center", ncols=4, columnspacing=0.8, handlelength=1.0)
        fig.title(axes[2], "c", "compact prior")
        for ax in axes:
            ax.set_xticks(x, contexts)
            ax.grid(visible=False, axis="x")
        fig.save_figure(figure, path)


def _draw_share(ax: Axes, found: ControlStudy, x: np.ndarray) -> None:
    bottom = np.zeros(len(x))
    for mode in found.scene.actions.modes:
        share = np.array([np.nan_to_num(_span(upload_percent(found, c, mode)).mean) for c in range(len(x))])
        if share.any():
            ax.bar(x, share, 0.6, bottom=bottom, color=MODE_COLOURS[mode], label=mode)
        bottom += share
    spans = [_span(upload_percent(found, c)) for c in range(len(x))]
    half = [s.half if np.isfinite(s.half) else 0.0 for s in spans]
    ax.errorbar(x, bottom, yerr=half, fmt="none", color="black", lw=1, capsize=2)
    paper = [PAPER_SHARE.get(name, np.nan) for name in found.scene.contexts]
    ax.plot(x, paper, "_", ms=13, mew=1.6, color="black", label="paper, total")
    ax.set(ylabel="slots with an upload (%)")
    ax.legend(loc="upper left")
    fig.title(ax, "a", "uploads by context and mode")


def _draw_risk(ax: Axes, found: ControlStudy, x: np.ndarray) -> None:
    fields = {"risk_before_m": ("risk before", fig.GREY), "risk_m": ("risk after", fig.BLUE)}
    fields["residual_m"] = ("residual", fig.ORANGE)
    top = 1.0
    for i, (field, (label, colour)) in enumerate(fields.items()):
        spans = [_span(at_requests(found, c, field)) for c in range(len(x))]
        half = [s.half if np.isfinite(s.half) else 0.0 for s in spans]
        heights = np.nan_to_num([s.mean for s in spans])
        top = max(top, float((heights + half).max()))
        ax.bar(
            x + (i - 1) * 0.26, heights, 0.24, yerr=half, color=colour, label=label, error_kw={"lw": 1, "capsize": 2}
        )
    ax.set(ylabel="median (m)", ylim=(0, 1.3 * top))
    ax.legend(loc="upper center", ncols=3, columnspacing=0.8, handlelength=1.0)
    fig.title(ax, "b", "what a request changes")

"""How request policies are written and drawn: names, colours, the paper's errors, and panels of errors by policy."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ovibjax.cards.control_results import reductions
from ovibjax.cards.control_study import FACTORS, FUSED, PAPER, ControlStudy, Point
from ovibjax.control.controller import PAPER_BUDGET_KB
from ovibjax.report import figures as fig
from ovibjax.report import panels
from ovibjax.report.claims import interval

NAMES = {
    "oracle_action": "Oracle action",
    "voi": "VOI-Control",
    "voi_gap": "VOI with gap (ours)",
    "uncertainty": "Uncertainty",
    "budgeted_periodic": "Budgeted periodic",
    "periodic": "Periodic",
    "fixed_front": "Fixed-front",
    "random": "Random",
}
"""Policies as the paper writes them, and a variant of ours."""

MODEL_NAMES = {"rate": "rate", "integrated": "integrated", "random_walk": "random walk"}
MODEL_COLOURS = {"rate": fig.BLUE, "integrated": fig.GREEN, "random_walk": fig.ORANGE}
"""Drift models, see `control.drift`."""

COLOURS = {
    "voi": fig.BLUE,
    "voi_gap": fig.SKY,
    "oracle_action": fig.GREY,
    "uncertainty": fig.GREEN,
    "budgeted_periodic": fig.ORANGE,
    "periodic": fig.YELLOW,
    "fixed_front": fig.PURPLE,
    "random": fig.RED,
}

PAPER_MEAN_M = {
    "voi": 4.13,
    "uncertainty": 4.21,
    "budgeted_periodic": 5.49,
    "fixed_front": 5.64,
    "random": 6.43,
    "oracle_action": 3.82,
}
PAPER_P95_M = {"voi": 6.71, "uncertainty": 7.01, "budgeted_periodic": 9.73, "fixed_front": 8.41, "random": 13.43}
"""The paper's route errors, on its own route."""

MODE_COLOURS = {"F": fig.PURPLE, "FS": fig.BLUE, "H4": fig.GREEN, "A5": fig.ORANGE}


def by_mean_error(found: ControlStudy, point: Point = PAPER) -> list[str]:
    """Policies, the one with the lowest mean error first."""
    return sorted(NAMES, key=lambda policy: float(found.of(policy, "mean_m", point).mean()))


def draw_error(ax: Axes, found: ControlStudy, metric: str, paper_m: Mapping[str, float]) -> None:
    """Bars of one error metric by policy, with 95 % intervals and the paper's values; diamonds: corrections fused.

    Args:
        ax: the panel.
        found: the study.
        metric: `mean_m` or `p95_m`.
        paper_m: the paper's values, metres.
    """
    policies = by_mean_error(found, FUSED)
    rows = []
    for policy in policies:
        span = interval(found.of(policy, metric))
        rows.append(panels.Bar(f"{NAMES[policy]}  {span.mean:.1f}", span, COLOURS[policy], paper_m.get(policy)))
    panels.bars(ax, rows)
    fused = [interval(found.of(policy, metric, FUSED)) for policy in policies]
    mean, cap = [span.mean for span in fused], [span.cap for span in fused]
    look: dict[str, Any] = {"fmt": "D", "ms": 3.5, "mfc": "white", "mec": "black", "ecolor": "black", "lw": 0.8}
    ax.errorbar(mean, range(len(policies)), xerr=cap, label="corrections fused (ours)", zorder=5, **look)
    # A bar may go on beyond the panel; its value stands beside its name.
    ax.set(xlabel="route error (m)", xlim=(0, 1.6 * max(*mean, *paper_m.values())))
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2)


def draw_mean_and_p95(ax: Axes, found: ControlStudy, point: Point) -> None:
    """Mean errors as bars and 95th percentiles as diamonds by policy at a setting, with 95 % intervals and the paper's
    values.
    """
    rows = []
    for row, policy in enumerate(by_mean_error(found, point)):
        colour = COLOURS[policy] if policy in ("voi", "oracle_action") else fig.ORANGE
        mean, p95 = interval(found.of(policy, "mean_m", point)), interval(found.of(policy, "p95_m", point))
        rows.append(panels.Bar(f"{NAMES[policy]}  {mean.mean:.1f}", mean, colour, PAPER_MEAN_M.get(policy)))
        ax.plot([0, p95.mean], [row, row], color=colour, lw=1, alpha=0.7)
        ax.errorbar(p95.mean, row, xerr=p95.cap, fmt="d", ms=3, color=colour, capsize=2, lw=0.8)
        if policy in PAPER_P95_M:
            panels.paper_tick(ax, PAPER_P95_M[policy], row)
    panels.bars(ax, rows, height=0.6)
    ax.set(xlabel="route error (m): bar mean, diamond p95", xlim=(0, None))
    ax.legend(ax.get_legend_handles_labels()[0], ["paper (mean, p95)"], loc="upper center", bbox_to_anchor=(0.5, -0.2))


def draw_ratios(ax: Axes, found: ControlStudy, metric: str, paper_percent: float, base: Point = PAPER) -> None:
    """An error relative to budgeted periodic's by drift model, as rates or budget are scaled.

    Args:
        ax: the panel.
        found: the study.
        metric: `mean_m` or `p95_m`.
        paper_percent: the paper's reduction, on its own route.
        base: the setting that is varied.
    """
    for shift, (model, colour) in enumerate(MODEL_COLOURS.items()):
        for style, scaled in (("-", "drift"), (":", "budget")):
            points = [
                base._replace(model=model, drift_scale=factor)
                if scaled == "drift"
                else base._replace(model=model, budget_kb=factor * PAPER_BUDGET_KB)
                for factor in FACTORS
            ]
            spans = [reductions(found, metric, "budgeted_periodic", p)[1] for p in points if p in found.points]
            x = np.array([f for f, p in zip(FACTORS, points, strict=True) if p in found.points])
            mean = np.array([1.0 - span.mean / 100.0 for span in spans])
            cap = np.array([span.cap / 100.0 for span in spans])
            # On a logarithmic axis an interval that reaches zero would swallow the panel.
            cap = np.stack([np.minimum(cap, 0.7 * mean), cap])
            look: dict[str, Any] = {"color": colour, "ls": style, "marker": "o", "ms": 2.5, "capsize": 1.5, "lw": 1.1}
            ax.errorbar(x * 1.03 ** (shift - 1), mean, yerr=cap, label=f"{MODEL_NAMES[model]}, {scaled}", **look)
    ratio = 1.0 - paper_percent / 100.0
    ax.axhline(1.0, color="black", lw=0.6)
    ax.axhline(ratio, color="black", lw=1.0, ls="--")
    ax.annotate(
        "paper", (1.0, ratio), (2, 0), xycoords=("axes fraction", "data"), textcoords="offset points", va="center"
    )
    ax.set_yscale("log")
    fig.plain_log_ticks(ax.yaxis)
    ax.set_xscale("log", base=2)
    ax.set_xticks(FACTORS, [f"{factor:g}x" for factor in FACTORS])
    ax.set(xlabel="drift rates, or budget", ylabel="VOI-Control / periodic")

"""How request policies are written and drawn: names, colours, the paper's errors, and panels of errors by policy."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes

from ovibjax.cards.control_results import reductions
from ovibjax.cards.control_study import BUDGETS_KB, DRIFT_SCALES, ControlStudy
from ovibjax.report import figures as fig
from ovibjax.report import panels
from ovibjax.report.claims import Interval, interval

NAMES = {
    "oracle_action": "Oracle action",
    "voi": "VOI-Control",
    "uncertainty": "Uncertainty",
    "budgeted_periodic": "Budgeted periodic",
    "periodic": "Periodic",
    "fixed_front": "Fixed-front",
    "random": "Random",
}
"""Policies as the paper writes them."""

COLOURS = {
    "voi": fig.BLUE,
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


def by_mean_error(found: ControlStudy) -> list[str]:
    """Policies, the one with the lowest mean error first."""
    return sorted(NAMES, key=lambda policy: float(found.of(policy, "mean_m").mean()))


def draw_error(ax: Axes, found: ControlStudy, metric: str, paper_m: Mapping[str, float]) -> None:
    """Bars of one error metric by policy, with 95 % intervals and the paper's values.

    Args:
        ax: the panel.
        found: the study.
        metric: `mean_m` or `p95_m`.
        paper_m: the paper's values, metres.
    """
    rows = []
    for policy in by_mean_error(found):
        span = interval(found.of(policy, metric))
        rows.append(panels.Bar(NAMES[policy], span, COLOURS[policy], paper_m.get(policy), f"{span.mean:.2f}"))
    panels.bars(ax, rows, inside=True)
    ax.set(xlabel="route error (m)")
    ax.legend(loc="upper right")


def draw_mean_and_p95(ax: Axes, found: ControlStudy) -> None:
    """Mean errors as bars and 95th percentiles as diamonds by policy, with 95 % intervals and the paper's values."""
    rows = []
    for row, policy in enumerate(by_mean_error(found)):
        colour = COLOURS[policy] if policy in ("voi", "oracle_action") else fig.ORANGE
        mean, p95 = interval(found.of(policy, "mean_m")), interval(found.of(policy, "p95_m"))
        rows.append(panels.Bar(NAMES[policy], mean, colour, PAPER_MEAN_M.get(policy), f"{mean.mean:.2f}"))
        ax.plot([0, p95.mean], [row, row], color=colour, lw=1, alpha=0.7)
        ax.errorbar(p95.mean, row, xerr=p95.cap, fmt="d", ms=3, color=colour, capsize=2, lw=0.8)
        if policy in PAPER_P95_M:
            panels.paper_tick(ax, PAPER_P95_M[policy], row)
    panels.bars(ax, rows, inside=True, height=0.6)
    ax.set(xlabel="route error (m): bar mean, diamond p95", xlim=(0, None))
    ax.legend(ax.get_legend_handles_labels()[0], ["paper (mean, p95)"], loc="upper right")


def draw_reductions(ax: Axes, found: ControlStudy) -> None:
    """Reductions of the mean error by drift and budget: shaded and on top against budgeted periodic, below it against
    the fixed uncertainty rule; in brackets where the interval reaches zero.
    """
    table = np.full((len(DRIFT_SCALES), len(BUDGETS_KB)), np.nan)
    texts = [[""] * len(BUDGETS_KB) for _ in DRIFT_SCALES]
    for i, (scale, budget) in enumerate(zip(found.settings.drift_scale, found.settings.budget_kb, strict=True)):
        row, column = _nearest(DRIFT_SCALES, scale), _nearest(BUDGETS_KB, budget)
        spans = [reductions(found, "mean_m", rival, i)[1] for rival in ("budgeted_periodic", "uncertainty")]
        table[row, column] = spans[0].mean
        texts[row][column] = "\n".join(_signed(span) for span in spans)
    limit = max(10.0, float(np.nanmax(np.abs(table))))
    panels.heat(ax, table, texts, "PuOr", (-limit, limit))
    ax.set_xticks(range(len(BUDGETS_KB)), [f"{budget:g}" for budget in BUDGETS_KB])
    ax.set_yticks(range(len(DRIFT_SCALES)), [f"{scale:g}x" for scale in DRIFT_SCALES])
    ax.set(xlabel="budget per route (KB)", ylabel="drift rate")


def _nearest(values: tuple[float, ...], value: float) -> int:
    return int(np.argmin(np.abs(np.array(values) - value)))


def _signed(span: Interval) -> str:
    text = f"{span.mean:+.0f}"
    return text if span.low > 0 or span.high < 0 else f"({text})"

"""The theorem of the slotted scheduler as pictures: gap and backlog over V, growth over load."""

import numpy as np
from matplotlib.axes import Axes

from ovibjax.cards.theorem_study import PENDING_BUSY, PENDING_LIGHT, PROOF_BUSY, SHIFTED_LIGHT, TheoremRuns
from ovibjax.report import figures as fig

_LOOKS = (
    (PROOF_BUSY, fig.BLUE, "-", "o", "proof's setting, load 0.9"),
    (PENDING_BUSY, fig.SKY, "--", "s", "pending requests only, load 0.9"),
    (PENDING_LIGHT, fig.RED, "-", "^", "pending requests only, load 0.5"),
    (SHIFTED_LIGHT, fig.GREEN, "-.", "v", "the same, with ν less its maximum"),
)


def draw_gap(ax: Axes, found: TheoremRuns) -> None:
    """Utility gap over V; its lines are explained below the figure."""
    _draw_over_v(ax, found, "gap", (0.05, 0.2), "left")
    ax.set_ylabel("utility below the best (m per slot)")
    ax.text(0.97, 0.87, "no V helps", transform=ax.transAxes, ha="right", color=fig.RED, fontsize=6.5)
    ax.figure.legend(*ax.get_legend_handles_labels(), loc="outside lower left", ncols=3)


def draw_backlog(ax: Axes, found: TheoremRuns) -> None:
    """Backlog over V."""
    _draw_over_v(ax, found, "backlog", (0.99, 0.45), "right")
    ax.set_ylabel("average backlog (requests)")


def _draw_over_v(ax: Axes, found: TheoremRuns, metric: str, place: tuple[float, float], side: str) -> None:
    """A metric in four settings and the bound of the proof; at a place of the panel, the slope in its setting."""
    v = found.runs.V.values
    for setting, colour, style, marker, label in _LOOKS:
        fig.band(ax, v, found.at(setting, metric), colour, label, style, marker)
    bound = found.at(PROOF_BUSY, f"{metric}_bound").mean(axis=0)
    ax.plot(v, bound, "--", color="black", lw=1, label="the proof's bound, load 0.9")
    slope = f"slope {found.slope(PROOF_BUSY, metric).text()}".replace("-", "−")
    ax.text(*place, slope, transform=ax.transAxes, ha=side, color=fig.BLUE, fontsize=6.5)
    ax.set(xscale="log", yscale="log", xlabel="V")
    for axis in (ax.xaxis, ax.yaxis):
        fig.plain_log_ticks(axis, subs=(1.0,))


def draw_growth(ax: Axes, found: TheoremRuns) -> None:
    """Backlog divided by the slots so far over load, and the least that any policy can have."""
    load = found.growth["load"].values
    for slots, colour, marker in zip(found.growth.slots.values, (fig.GREY, fig.ORANGE, fig.PURPLE), "os^", strict=True):
        curves = found.growth.measured.sel(slots=slots).transpose("seed", "load").values
        fig.band(ax, load, curves, colour, f"{slots:,} slots", "-", marker)
    least = found.growth.least.mean("seed").values
    bend = int((load < 1).sum())
    ax.plot(np.insert(load, bend, 1.0), np.insert(least, bend, 0.0), "--", color="black", lw=1, label="least possible")
    ax.axvline(1.0, color=fig.GREY, lw=0.8)
    ax.set(xlabel="load (share of capacity)", ylabel="backlog / slots (requests)")
    ax.legend(loc="upper left")

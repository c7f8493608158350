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
_LABELS = {"gap": "utility below the best (m per slot)", "backlog": "average backlog (requests)"}


def draw_over_v(ax: Axes, found: TheoremRuns, metric: str) -> None:
    """A metric over V in four settings, the bound of the proof, and the slope in the proof's setting.

    Args:
        ax: the panel.
        found: the runs.
        metric: `gap` or `backlog`.
    """
    v = found.runs.V.values
    for setting, colour, style, marker, label in _LOOKS:
        fig.band(ax, v, found.at(setting, metric), colour, label, style, marker)
    bound = found.at(PROOF_BUSY, f"{metric}_bound").mean(axis=0)
    ax.plot(v, bound, "--", color="black", lw=1, label="the proof's bound, load 0.9")
    slope = f"slope {found.slope(PROOF_BUSY, metric).text()}".replace("-", "−")
    place, side = ((0.05, 0.2), "left") if metric == "gap" else ((0.99, 0.45), "right")
    ax.text(*place, slope, transform=ax.transAxes, ha=side, color=fig.BLUE, fontsize=6.5)
    ax.set(xscale="log", yscale="log", xlabel="V", ylabel=_LABELS[metric])
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

"""The whole system's grid as pictures: error and latency over the prefix, the Pareto front, what moves what."""

import numpy as np
import xarray
from matplotlib.axes import Axes

from ovibjax.cards.scheduling_drawing import COLOURS, NAMES
from ovibjax.control.controller import PAPER_BUDGET_KB
from ovibjax.report import figures as fig
from ovibjax.report import panels
from ovibjax.report.shares import variance_shares

METRICS = {
    "mean_route_m": "route error",
    "kb": "KB per route",
    "top_edge_p95_ms": "top edge p95",
    "top_cost": "top cost",
}
"""Metrics of the grid that are compared, in words."""

_PALETTE = (fig.BLUE, fig.ORANGE, fig.GREEN, fig.PURPLE, fig.RED, fig.SKY, fig.YELLOW)
_PARTS = {
    "beta": ("β", fig.BLUE),
    "gamma": ("γ", fig.SKY),
    "k": ("k", fig.ORANGE),
    "V": ("V", fig.GREEN),
    "scheduler": ("rule", fig.PURPLE),
    "seed": ("seed", fig.GREY),
    "pairs": ("two-way interactions", fig.YELLOW),
    "rest": ("rest", "#cccccc"),
}
"""Shares of variance: label and colour."""


def _prefix_axis(ax: Axes, found: xarray.Dataset) -> None:
    ks = found.k.values
    ax.set_xscale("log", base=2)
    ax.set_xticks(ks, [str(k) for k in ks])
    ax.minorticks_off()
    ax.set_xlabel("prefix length k (floats)")


def draw_error(ax: Axes, found: xarray.Dataset) -> None:
    """Route error over the prefix, a line per weight of the rate term."""
    for beta, colour in zip(found.beta.values, _PALETTE, strict=False):
        curves = found.mean_route_m.sel(beta=beta).mean("gamma").transpose("seed", "k").values
        fig.band(ax, found.k.values, curves, colour, f"β = {beta:g}", marker="o")
    _prefix_axis(ax, found)
    ax.set(ylabel="mean route error (m)", ylim=(0, None))
    ax.legend(loc="lower right")


def draw_edge(ax: Axes, found: xarray.Dataset) -> None:
    """Edge p95 of the top decile over the prefix, a line per rule."""
    tail = found.top_edge_p95_ms.mean(["beta", "gamma"]).sel(V=8.0, method="nearest")
    for rule in ("edf", "fifo", "base_dpp", "voi_lyapunov"):
        curves = tail.sel(scheduler=rule).transpose("seed", "k").values
        style = "--" if rule == "base_dpp" else "-"
        fig.band(ax, found.k.values, curves, COLOURS[rule], NAMES[rule], style, marker="o")
    _prefix_axis(ax, found)
    ax.set(ylabel="edge p95, top decile (ms)", ylim=(0, None))
    ax.legend(loc="upper right", ncols=2)


def pareto(points: np.ndarray) -> np.ndarray:
    """[P] bool, points [P, D] that no other point beats or equals in every coordinate and beats in one."""
    no_worse = np.all(points[None] <= points[:, None], axis=2)
    better = np.any(points[None] < points[:, None], axis=2)
    return np.logical_not(np.any(no_worse & better, axis=1))


def draw_front(ax: Axes, found: xarray.Dataset) -> None:
    """Every point by payload and route error, shaded by edge p95; outlined where no other is better in all three."""
    names = ("kb", "mean_route_m", "top_edge_p95_ms")
    mean = xarray.broadcast(*(found[name].mean("seed") for name in names))
    points = np.stack([part.transpose(*mean[2].dims).values.ravel() for part in mean], axis=1)
    front = pareto(points)
    slowest_first = points[np.argsort(-points[:, 2])]
    x, y, tail_ms = slowest_first.T
    shown = ax.scatter(x, y, c=tail_ms, s=9, cmap="cividis", lw=0)
    ax.scatter(points[front, 0], points[front, 1], s=26, facecolors="none", edgecolors=fig.RED, lw=1.0, label="front")
    for k in found.k.values:
        place = float(found.kb.sel(k=k).mean()), float(found.mean_route_m.mean("seed").sel(k=k).max())
        ax.annotate(f"k = {k}", place, xytext=(0, 5), textcoords="offset points", ha="center", fontsize=6.5)
    ax.margins(y=0.12)
    bar = ax.figure.colorbar(shown, ax=ax, pad=0.01)
    bar.set_label("edge p95, top decile (ms)")
    ax.axvline(PAPER_BUDGET_KB, color="black", lw=0.8, ls=":")
    ax.text(PAPER_BUDGET_KB, ax.get_ylim()[1], "budget ", ha="right", va="top", fontsize=6.5)
    ax.set(xlabel="payload per route (KB)", ylabel="mean route error (m)")
    ax.legend(loc="center left")


def draw_shares(ax: Axes, found: xarray.Dataset) -> None:
    """Variance of each metric over the grid as stacked bars: the axes alone, interactions, the rest."""
    parts = {name: variance_shares(found[name]) for name in METRICS}
    left = np.zeros(len(METRICS))
    for key, (label, colour) in _PARTS.items():
        share = [
            sum(v for name, v in part.items() if " x " in name) if key == "pairs" else part.get(key, 0.0)
            for part in parts.values()
        ]
        width = 100 * np.array(share)
        ax.barh(range(len(METRICS)), width, left=left, height=0.62, color=colour, label=label)
        left += width
    panels.category_axis(ax, list(METRICS.values()))
    ax.set(xlabel="share of variance over the grid (%)", xlim=(0, 100))
    ax.legend(loc="upper center", bbox_to_anchor=(0.45, -0.22), ncols=4, columnspacing=0.9, handlelength=1.0)

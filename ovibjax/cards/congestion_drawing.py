"""Scheduling rules under congestion as pictures, beside the paper's numbers."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ovibjax.cards.congestion_study import LOADS, SPREADS_S, Congestion
from ovibjax.cards.scheduling_drawing import COLOURS, NAMES
from ovibjax.report import figures as fig
from ovibjax.report import panels
from ovibjax.report.claims import interval
from ovibjax.scheduling.clients import PHASE_SPREAD_S
from ovibjax.scheduling.congestion import LEVELS
from ovibjax.scheduling.ties import TIES

PAPER_TOP = {
    "edge_p95_ms": {"voi_lyapunov": 32.8, "base_dpp": 137.7, "maxweight": 142.4},
    "e2e_p95_ms": {"voi_lyapunov": 88.5, "base_dpp": 193.0, "maxweight": 198.0},
    "cost": {"voi_lyapunov": 1.12, "base_dpp": 1.82, "maxweight": 1.87},
    "stale_m": {"voi_lyapunov": 0.012, "base_dpp": 0.022, "maxweight": 0.022},
}
"""The paper's top decile at high congestion, by metric and rule."""

PAPER_ALL_EDGE_MS = {"voi_lyapunov": 185.7, "base_dpp": 232.5, "maxweight": 217.8, "fifo": 93.2, "edf": 106.7}
"""The paper's edge p95 of all requests at high congestion."""

TIES_NAMES = {"arrival": ("earliest arrival", "o"), "client": ("lowest client", "s"), "last": ("latest arrival", "^")}
"""Who goes first of requests with equal priority: words and marker."""


def draw_cost(ax: Axes, found: Congestion) -> None:
    """Weighted cost of the top decile by rule, at high congestion."""
    rows = []
    for rule, name in NAMES.items():
        span = interval(found.at(rule, "top10", "cost"))
        rows.append(panels.Bar(name, span, COLOURS[rule], PAPER_TOP["cost"].get(rule), f"{span.mean:.2f}"))
    panels.bars(ax, rows, inside=True)
    ax.set(xlabel="weighted cost, top decile")
    # Inside the panel its tick would look like one more value.
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2))


def draw_edge(ax: Axes, found: Congestion) -> None:
    """Edge p95 by rule at high congestion, of the top decile and of all requests."""
    for row, rule in enumerate(NAMES):
        for scope, place, alpha, paper in (
            ("top10", row - 0.19, 1.0, PAPER_TOP["edge_p95_ms"]),
            ("all", row + 0.19, 0.45, PAPER_ALL_EDGE_MS),
        ):
            span = interval(found.at(rule, scope, "edge_p95_ms"))
            look: dict[str, Any] = {"color": COLOURS[rule], "alpha": alpha, "error_kw": {"lw": 1, "capsize": 2}}
            ax.barh(place, span.mean, xerr=span.cap, height=0.36, **look)
            end = span.mean + span.cap
            if rule in paper:
                panels.paper_tick(ax, paper[rule], place, 7)
                end = paper[rule] if 0.0 < paper[rule] - end < 25.0 else end  # the number would lie under the tick
            ax.text(end, place, f" {span.mean:.0f}", va="center", fontsize=6)
    panels.category_axis(ax, list(NAMES.values()))
    ax.set(xlabel="edge p95 (ms): solid top decile, pale all requests")


def draw_ties_top(ax: Axes, found: Congestion) -> None:
    """Edge p95 of the top decile at high congestion, by rule and by how ties are broken."""
    _draw_ties(ax, found, "top10", PAPER_TOP["edge_p95_ms"])
    ax.set(xlabel="edge p95, top decile (ms)")


def draw_ties_all(ax: Axes, found: Congestion) -> None:
    """Edge p95 of all requests at high congestion, by rule and by how ties are broken."""
    _draw_ties(ax, found, "all", PAPER_ALL_EDGE_MS)
    ax.set(xlabel="edge p95, all requests (ms)")


def _draw_ties(ax: Axes, found: Congestion, scope: str, paper: dict[str, float]) -> None:
    for row, rule in enumerate(NAMES):
        for place, ties in zip((-0.25, 0.0, 0.25), TIES, strict=True):
            span = interval(found.at(rule, scope, "edge_p95_ms", ties=ties))
            look: dict[str, Any] = {"color": COLOURS[rule], "marker": TIES_NAMES[ties][1], "ms": 3.5, "capsize": 2}
            ax.errorbar(span.mean, row + place, xerr=span.cap, lw=1, **look)
        if rule in paper:
            panels.paper_tick(ax, paper[rule], row, 14)
    panels.category_axis(ax, list(NAMES.values()))
    ax.set_xlim(left=0)
    for words, marker in TIES_NAMES.values():
        ax.plot([], [], marker, ms=3.5, color=fig.GREY, label=words)
    ax.plot([], [], "|", ms=8, mew=1.6, color="black", label="paper")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=4, columnspacing=0.8, handletextpad=0.1)


def draw_levels(ax: Axes, found: Congestion) -> None:
    """Edge p95 of the top decile by congestion level, a line per rule."""
    x = np.arange(len(LEVELS))
    for rule in NAMES:
        spans = [interval(found.at(rule, "top10", "edge_p95_ms", level)) for level in LEVELS]
        means, caps = [s.mean for s in spans], [s.cap for s in spans]
        look: dict[str, Any] = {"color": COLOURS[rule], "label": NAMES[rule], "lw": 1.4, "elinewidth": 1}
        ax.errorbar(x, means, caps, fmt="o-", ms=3.5, capsize=2, **look)
    ax.set_xticks(x, [f"{name}\nN = {n}, {rate:g} KB/s" for name, (n, rate) in LEVELS.items()])
    ax.set(ylabel="edge p95, top decile (ms)")
    ax.set_ylim(bottom=0)
    ax.legend(loc="upper left")


def draw_sensitivity(ax: Axes, found: Congestion) -> None:
    """Reduction of Base-DPP's edge p95 of the top decile by VOI-Lyapunov, over phase spread and number of clients."""
    voi, base = (np.asarray(found.varied[p].top.edge_p95_ms, np.float64)[..., 0] for p in ("voi_lyapunov", "base_dpp"))
    reduction = (100.0 * (base - voi) / base).reshape(len(SPREADS_S), len(LOADS), -1)
    for i, load in enumerate(LOADS):
        curve = reduction[:, i].T
        colour = (fig.SKY, fig.GREEN, fig.BLUE, fig.RED)[i]
        mean, half = fig.mean_and_half(curve)
        ax.fill_between(SPREADS_S, mean - half, mean + half, color=colour, alpha=0.18, lw=0)
        ax.plot(SPREADS_S, mean, "o-", ms=3, color=colour, label=f"N = {load}")
    ax.axhline(0, color="black", lw=0.8)
    ax.axvline(PHASE_SPREAD_S, color="black", lw=0.8, ls=":")
    ax.set(xlabel="phase spread (s)", ylabel="reduction of edge p95 (%)", xscale="log")
    fig.plain_log_ticks(ax.xaxis)
    ax.legend(loc="upper right", ncols=2)

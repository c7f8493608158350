"""The panels of the conference version's figure: what the ARD prior prunes, errors over two weights, cost."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from ovibjax.cards.fixed_rate_study import FixedRateStudy, K
from ovibjax.link.latency import JETSON, compute_ms_at
from ovibjax.report import figures as fig
from ovibjax.report.claims import Interval
from ovibjax.report.panels import Bar, bars, sheet, star

Points = Sequence[tuple[float, float]]
"""Weights (beta, gamma)."""


def draw(path: Path, found: FixedRateStudy, over_beta: Points, over_gamma: Points) -> None:
    """Draw the four panels.

    Args:
        path: the PNG.
        found: the study.
        over_beta: the points that differ in beta.
        over_gamma: the points that differ in gamma.
    """
    betas, gammas = [beta for beta, _ in over_beta], [gamma for _, gamma in over_gamma]
    with sheet(path, 2, 2, height_in=2.2) as axes:
        _draw_pruning(axes[0], found, over_beta, betas)
        _draw_sweep(axes[1], found, over_beta, betas, "rate weight β")
        _draw_sweep(axes[2], found, over_gamma, gammas, "orthogonality weight γ")
        fig.title(axes[1], "b", "fixed k = 16 over β")
        fig.title(axes[2], "c", "fixed k = 16 over γ")
        _draw_cost(axes[3], found)


def _draw_pruning(ax: Axes, found: FixedRateStudy, points: Points, betas: Sequence[float]) -> None:
    x = np.arange(len(betas))
    dims = np.stack([found.at(*point, "active_dims") for point in points], axis=1).astype(float)
    errors = np.stack([found.at(*point) for point in points], axis=1)
    right = ax.twinx()
    fig.band(ax, x, dims, fig.BLUE, "active dimensions", "-", "o")
    fig.band(right, x, errors, fig.RED, "error", "--", "s")
    ax.set_xticks(x, [f"{beta:g}" for beta in betas])
    ax.set(xlabel="ARD weight β", ylim=(0, K + 1))
    ax.set_ylabel("active dimensions of 16", color=fig.BLUE)
    right.set(yscale="log")
    right.set_ylabel("mean error (m)", color=fig.RED)
    right.spines["right"].set_visible(True)
    right.grid(visible=False)
    fig.plain_log_ticks(right.yaxis)
    fig.title(ax, "a", "ARD prunes, and pruning costs")


def _draw_sweep(ax: Axes, found: FixedRateStudy, points: Points, values: Sequence[float], label: str) -> None:
    x = np.arange(len(points))
    curves = np.stack([found.at(*point) for point in points], axis=1)
    fig.band(ax, x, curves, fig.BLUE, f"O-VIB, k = {K}", "-", "o")
    for of_seed in curves:
        ax.plot(x, of_seed, ".", ms=2.5, color="#888888", zorder=1)
    chosen = int(np.argmin([found.at(*point, "val_mean_m").mean() for point in points]))
    best_m = curves[:, chosen].mean()
    star(ax, chosen, best_m, f"selected: {best_m:.1f} m")
    fusion_m = float(found.fusion.test_mean_m.mean())
    ax.axhline(fusion_m, color=fig.ORANGE, ls="--", lw=1.2, label=f"attention fusion: {fusion_m:.1f} m")
    ax.set_xticks(x, [f"{value:g}" for value in values])
    ax.set(xlabel=label, ylabel="mean error (m)", yscale="log")
    fig.plain_log_ticks(ax.yaxis)
    low, high = ax.get_ylim()
    ax.set_ylim(low, high * (high / low) ** 0.5)  # room for the legend
    ax.legend(loc="upper left")


def _draw_cost(ax: Axes, found: FixedRateStudy) -> None:
    jetson = {f"Jetson: O-VIB, K = {k}": float(compute_ms_at(JETSON, k)) for k in (16, 32, 128)}
    here = {f"here: {name}": ms for name, ms in found.host_ms.items()}
    rows = []
    for times, colour in ((jetson, fig.ORANGE), (here, fig.BLUE)):
        for name, ms in times.items():
            text = f"{ms:.1f} ms" if ms >= 1 else f"{ms:.2f} ms"
            rows.append(Bar(name, Interval(ms, 0.0), colour, text=text))
    bars(ax, rows)
    ax.set(xlabel="encoding one frame (ms)", xscale="log", xlim=(0.03, 300))
    fig.plain_log_ticks(ax.xaxis, subs=(1.0,))
    fig.title(ax, "d", "compute cost")

"""The panels of the ablation figure: orthogonality weight, order, components, differences, weight of localization."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ovibjax.cards.ablation_study import Ablation, named
from ovibjax.cards.alpha_study import PREFIXES, AlphaEffects, alpha_text
from ovibjax.cards.recipe_study import RECIPE_VARIANTS
from ovibjax.encoder.loss import GAMMA
from ovibjax.report import figures as fig
from ovibjax.report.claims import interval
from ovibjax.report.panels import Bar, bars, category_axis, paper_tick, sheet, star

NAMES = {
    "full": "Full",
    "no_rate": "no rate (β = 0)",
    "no_orthogonality": "no orthogonality (γ = 0)",
    "no_nesting": "no nesting",
    "no_linear_start": "no linear start",
    "no_completion": "no completion",
    "gelu": "GELU for the sine",
    "paper_prefixes": "prefixes drawn evenly",
    "paper_recipe": "paper's recipe",
    "pca_completed": "PCA, our decoder",
    "pca": "PCA",
}
COLOURS = {
    "full": fig.BLUE,
    "no_rate": fig.SKY,
    "no_orthogonality": fig.GREEN,
    "no_nesting": fig.ORANGE,
    "pca": fig.RED,
    "pca_completed": fig.DARK_RED,
}


SHORT_K = 16
"""A short prefix, marked beside the bars: there our recipe tells."""


def draw(
    path: Path, found: Ablation, effects: AlphaEffects, gammas: Sequence[float], k: int, paper_m: Mapping[str, float]
) -> None:
    """Draw the six panels.

    Args:
        path: the PNG.
        found: the ablation.
        effects: what the terms are worth by weight of localization.
        gammas: positive orthogonality weights.
        k: prefix at which variants are compared.
        paper_m: the paper's mean errors at that prefix, metres, by variant.
    """
    with sheet(path, 2, 3, height_in=2.5) as (weight, order, components, zoom, rate, orthogonality):
        _draw_gamma(weight, found, (0.0, *gammas), k)
        _draw_orders(order, found)
        _draw_components(components, found, k, paper_m)
        _draw_differences(zoom, found, (0.0, *gammas), k, paper_m)
        _draw_effect(rate, effects, "no_rate", COLOURS["no_rate"])
        _draw_effect(orthogonality, effects, "no_orthogonality", COLOURS["no_orthogonality"])
        fig.title(rate, "e", "what the rate term is worth by α")
        fig.title(orthogonality, "f", "what orthogonality is worth by α")


def _draw_gamma(ax: Axes, found: Ablation, gammas: Sequence[float], k: int) -> None:
    x = np.arange(len(gammas))
    for metric, label, colour, style in (
        ("test_mean_m", "test", fig.BLUE, "-"),
        ("val_mean_m", "validation", fig.GREY, "--"),
    ):
        curves = np.stack([found.at(named(gamma), k, metric) for gamma in gammas], axis=1)
        fig.band(ax, x, curves, colour, label, style, "o")
    chosen = found.selected_gamma(k)
    at = min(range(len(gammas)), key=lambda i: abs(gammas[i] - chosen))
    error_m = found.at(named(gammas[at]), k).mean()
    star(ax, at, error_m, f"selected γ = {chosen:g}: {error_m:.1f} m")
    ax.set_xticks(x, [f"{gamma:g}" for gamma in gammas])
    ax.set(xlabel="orthogonality weight γ", ylabel=f"mean error at k = {k} (m)")
    ax.set_ylim(bottom=0)
    ax.legend(loc="lower left")
    fig.title(ax, "a", "orthogonality weight")


def _draw_orders(ax: Axes, found: Ablation) -> None:
    k = np.array(found.ks)
    looks = {"learned": (COLOURS["full"], "-"), "random": (fig.GREEN, "--"), "tail_first": (fig.ORANGE, "-.")}
    for order, (colour, style) in looks.items():
        curves = found.order_m(order)
        fig.band(ax, k, curves, colour, order.replace("_", " "), style)
        mean, half = curves.mean(axis=0), found.half_over_frames_m(order)
        ax.fill_between(k, np.maximum(mean - half, 0.3 * mean), mean + half, color=colour, alpha=0.4, lw=0)
    some = slice(None, None, max(1, len(k) // 7))
    mean, deviation = found.order_m("random").mean(axis=0), found.deviation_of_permutations_m()
    look: dict[str, Any] = {"fmt": "none", "ecolor": "black", "elinewidth": 0.7, "capsize": 1.5, "zorder": 4}
    ax.errorbar(k[some], mean[some], yerr=deviation[some], label="sd, 8 permutations", **look)
    ax.set(xlabel="coordinates kept k", ylabel="mean error (m)", yscale="log", xlim=(0, 129))
    fig.plain_log_ticks(ax.yaxis)
    ax.legend(loc="center", bbox_to_anchor=(0.37, 0.55), handlelength=1.6)
    fig.title(ax, "b", "the order is learned")


def _draw_components(ax: Axes, found: Ablation, k: int, paper_m: Mapping[str, float]) -> None:
    trained = [str(name) for name in found.recipe.variant.values]
    names = [name for name in NAMES if name not in RECIPE_VARIANTS or name in trained]
    spans = {name: interval(found.at(name, k)) for name in names}
    rows = [
        Bar(NAMES[name], span, COLOURS.get(name, fig.PURPLE), paper_m.get(name), f"{span.mean:.1f} m")
        for name, span in spans.items()
    ]
    short = [interval(found.at(name, SHORT_K)) for name in names]
    half = [[span.cap for span in short]]
    at = np.arange(len(names)) + 0.34
    look: dict[str, Any] = {"color": "black", "mfc": "white", "ms": 3, "mew": 0.8, "elinewidth": 0.7, "zorder": 4}
    ax.errorbar([span.mean for span in short], at, xerr=half * 2, fmt="o", label=f"k = {SHORT_K}", **look)
    bars(ax, rows, height=0.5)
    ax.set(xlabel=f"mean error at k = {k} (m)", xscale="log", xlim=(1, 500))
    ax.legend(loc="lower right")
    fig.plain_log_ticks(ax.xaxis, subs=(1.0, 3.0))
    fig.title(ax, "c", "components of the paper and of our recipe")


def _draw_differences(ax: Axes, found: Ablation, gammas: Sequence[float], k: int, paper_m: Mapping[str, float]) -> None:
    """Errors minus those of Full, paired over seeds: interval, a dot per seed, the paper's difference as a tick."""
    names = ["no_rate", *(named(gamma) for gamma in gammas if gamma != GAMMA)]
    for row, name in enumerate(names):
        differences = found.at(name, k) - found.at("full", k)
        span = interval(differences)
        colour = COLOURS.get(name, fig.PURPLE)
        ax.errorbar(span.mean, row, xerr=span.cap, fmt="o", ms=4, color=colour, capsize=2, lw=1.2)
        ax.plot(differences, np.full(len(differences), row + 0.28), ".", ms=3, color="#888888")
        if name in paper_m:
            paper_tick(ax, paper_m[name] - paper_m["full"], row, 13.0)
    ax.axvline(0, color=fig.BLUE, lw=1)
    category_axis(ax, [NAMES.get(name, "γ = " + name.removeprefix("gamma_")) for name in names])
    ax.set(xlabel=f"error minus error of Full at k = {k} (m)")
    _explain_differences(ax)
    fig.title(ax, "d", "zoom: paired differences to Full")


def _explain_differences(ax: Axes) -> None:
    """A legend below the rows of differences: mean and interval, seeds, and the paper's value."""
    ax.errorbar([], [], xerr=[], fmt="o", ms=4, color=fig.GREY, capsize=2, lw=1.2, label="mean, 95 %")
    ax.plot([], [], ".", ms=3, color="#888888", label="a seed")
    ax.plot([], [], "|", ms=8, mew=1.6, color="black", label="paper")
    ax.set_ylim(bottom=ax.get_ylim()[0] + 0.9, top=-0.5)
    look: dict[str, Any] = {"frameon": True, "framealpha": 1.0, "edgecolor": "none"}  # zero runs through it
    ax.legend(loc="lower center", ncols=3, columnspacing=1.0, handletextpad=0.4, **look)


def _draw_effect(ax: Axes, effects: AlphaEffects, arm: str, colour: str) -> None:
    """Error without a term minus error with it at every alpha, paired over seeds: interval, and a dot per seed."""
    x = np.arange(len(effects.by_alpha))
    for k, shift, marker in zip(PREFIXES, (-0.12, 0.12), ("o", "s"), strict=True):
        gains = [effects.gain_m(arm, alpha, k) for alpha in effects.by_alpha]
        spans = [interval(gain) for gain in gains]
        caps = [span.cap for span in spans]
        look: dict[str, Any] = {"fmt": marker, "ms": 4, "capsize": 2, "lw": 1.2, "color": colour, "mec": "black"}
        ax.errorbar(x + shift, [span.mean for span in spans], yerr=caps, label=f"k = {k}", mew=0.6, **look)
        for at, gain in zip(x + shift, gains, strict=True):
            ax.plot(np.full(len(gain), at + 0.07), gain, ".", ms=3, color="#888888")
    ax.axhline(0, color=fig.BLUE, lw=1)
    ax.set_xticks(x, [alpha_text(alpha) for alpha in effects.by_alpha])
    ax.set(xlabel="weight α of localization (last: square metres)", ylabel="error without minus with (m)")
    ax.set_xlim(-0.5, len(x) - 0.5)
    ax.legend(loc="upper right", ncols=2)

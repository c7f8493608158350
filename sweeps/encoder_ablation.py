"""Fig. "Scalable encoder ablations": orthogonality weight, coordinate orderings, components; Lemmas and Proposition."""

import time
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from scipy.stats import ttest_rel

from ovibjax.cards.ablation_study import GAMMA, Ablation, ablate, named, table_rows
from ovibjax.cards.job import Job
from ovibjax.encoder.bound_margins import check_bounds
from ovibjax.encoder.data_split import member_data
from ovibjax.encoder.model import Architecture
from ovibjax.encoder.train import TrainConfig
from ovibjax.report import figures as fig
from ovibjax.report.claims import HELD, NOT_HELD, Claim, above, interval, weakest, write_claims
from ovibjax.report.rows import write_rows

TITLE = "Scalable encoder ablations"
K = 35
PAPER_M = {"full": 8.75, "no_rate": 9.44, "no_orthogonality": 9.30, "no_nesting": 116.19}
NAMES = {
    "full": "Full",
    "no_rate": "no rate (β = 0)",
    "no_orthogonality": "no orthogonality (γ = 0)",
    "no_nesting": "no nesting",
    "pca": "PCA",
}
COLOURS = {
    "full": fig.BLUE,
    "no_rate": fig.SKY,
    "no_orthogonality": fig.GREEN,
    "no_nesting": fig.ORANGE,
    "pca": fig.RED,
}


@dataclass(frozen=True)
class Preset:
    """Size of the ablation.

    Attributes:
        seeds: number of seeds.
        steps: training steps.
        lr: peak learning rate.
        gammas: positive orthogonality weights.
        ks: prefixes judged.
    """

    seeds: int
    steps: int
    lr: float
    gammas: tuple[float, ...]
    ks: tuple[int, ...]


PRESETS = {
    "smoke": Preset(2, 30, 3e-3, (0.1, 1.0), (16, 35, 128)),
    "quick": Preset(3, 1300, 3e-3, (0.01, 0.1, 1.0), (4, 8, 16, 24, 35, 64, 96, 128)),
    "full": Preset(
        5,
        5000,
        2e-3,
        (0.001, 0.01, 0.1, 1.0, 10.0),
        (1, 2, 3, 4, 6, 8, 10, 12, 14, 16, 20, 24, 28, 32, 35, 40, 48, 56, 64, 72, 80, 88, 96, 104, 112, 120, 124, 128),
    ),
}


def run(job: Job) -> None:
    """Run the card: train all variants, judge orderings, write table, claims and figure."""
    started = time.perf_counter()
    preset = PRESETS[job.preset]
    seeds = [job.seed + i for i in range(preset.seeds)]
    members = [member_data(job.features, seed, job.rank)[0] for seed in seeds]
    views, dim = members[0].train.x.shape[1:]
    static = TrainConfig(arch=Architecture(n_views=views, view_dim=dim), steps=preset.steps, precision="bfloat16")
    found = ablate(job.sweep, static, preset.lr, preset.gammas, preset.ks, members, seeds)
    write_rows(job.out / "table.csv", table_rows(found))
    write_claims(job.out / "claims.json", judge_claims(preset, found))
    draw(job.out / "figure.png", preset, found)
    job.record(
        *(TITLE, caption(preset, found), seeds, started),
        steps=preset.steps,
        precision=static.precision,
        selected_gamma=found.selected_gamma(K),
        diverged=int(found.trained.diverged.sum()),
        members_of_an_earlier_run=int(found.trained.attrs["resumed"]),
    )


def judge_claims(preset: Preset, found: Ablation) -> list[Claim]:
    """The paper's claims about the encoder, by stated rules."""
    return [*_nesting(found), *_orderings(found), *_components(found), _gamma(preset, found), *_theory(found)]


def _nesting(found: Ablation) -> list[Claim]:
    claims = []
    for k in (16, K):
        full, without = found.at("full", k), found.at("no_nesting", k)
        ratio = interval(without / full)
        claims.append(
            Claim(
                f"Nesting is needed at short prefixes: without it the error at k = {k} is 10 times larger",
                "116.19 / 8.75 m = 13.3" if k == K else "-",
                f"{interval(without).text()} / {interval(full).text('m')}, ratio {ratio.text('', 1)}",
                above(ratio, 10.0),
                "interval of the paired ratio at least 10",
            )
        )
    return claims


def _orderings(found: Ablation) -> list[Claim]:
    claims = []
    learned = found.orders.sel(ordering="learned").values
    tail = found.orders.sel(ordering="tail_first").values
    half = found.ks.index(min(found.ks, key=lambda k: abs(k - 64)))
    for name, other in (("random orders", found.random_errors()), ("tail-first", tail)):
        worse = other - learned
        behind = [k for i, k in enumerate(found.ks) if worse[:, i].mean() <= 0]
        first = min(behind, default=found.ks[-1])
        at_half = interval(worse[:, half])
        claims.append(
            Claim(
                f"The learned order beats {name} until most coordinates are kept",
                "until most coordinates are retained",
                f"{name} worse by {at_half.text('m')} at k = {found.ks[half]}, on average at every k below {first}",
                weakest(above(interval(worse[:, i]), 0.0) for i in range(half + 1)),
                f"paired interval above zero at every prefix up to {found.ks[half]}",
            )
        )
    return claims


def _components(found: Ablation) -> list[Claim]:
    claims = []
    for variant, text, paper in (
        ("no_rate", "The rate term helps", "9.44 - 8.75 = 0.69 m"),
        ("no_orthogonality", "The orthogonality penalty helps", "9.30 - 8.75 = 0.55 m"),
    ):
        ablated, full = found.at(variant, K), found.at("full", K)
        difference, p = interval(ablated - full), float(ttest_rel(ablated, full).pvalue)
        claims.append(
            Claim(
                f"{text} at k = {K}: error without it minus error of Full",
                paper,
                f"{difference.text('m')} (paired t-test over {len(full)} common seeds: p = {p:.2g})",
                HELD if difference.low > 0 else NOT_HELD,
                "the whole interval of the paired difference above zero",
            )
        )
    return claims


def _gamma(preset: Preset, found: Ablation) -> Claim:
    base = found.at("full", K, "val_mean_m")
    larger = [gamma for gamma in preset.gammas if gamma > GAMMA]
    gains = {gamma: interval(found.at(named(gamma), K, "val_mean_m") - base) for gamma in larger}
    return Claim(
        "Larger orthogonality weights do not improve the validation error",
        "validation selects γ = 0.1",
        f"selected γ = {found.selected_gamma(K):g}; validation error minus that of γ = 0.1: "
        + ", ".join(f"{gain.text('m')} at γ = {gamma:g}" for gamma, gain in gains.items()),
        weakest(above(gain, 0.0) for gain in gains.values()),
        "paired interval of every larger weight above zero",
    )


def _theory(found: Ablation) -> list[Claim]:
    spectra = found.spectra
    inside = [
        bool(np.all(s.values >= s.lower[:, None] - 1e-4) and np.all(s.values <= s.upper[:, None] + 1e-4))
        for s in spectra.values()
    ]
    claims = [
        Claim(
            "Proposition 1: the singular values of the trained projection W lie within sqrt(1 - ε) and sqrt(1 + ε)",
            "a theorem",
            "; ".join(
                f"γ = {gamma:g}: {s.values.min():.3f} to {s.values.max():.3f}, ε = {float(s.epsilon.max()):.2g}"
                for gamma, s in spectra.items()
            ),
            HELD if all(inside) else NOT_HELD,
            "every seed; where ε is 1 or more the proposition promises nothing from below",
        )
    ]
    for check in check_bounds():
        claims.append(
            Claim(
                check.statement,
                "a theorem",
                f"identity within {check.deviation:.1e}, smallest gap {check.gap_nats:.2g} nats",
                HELD if check.deviation < 1e-4 and check.gap_nats >= 0 else NOT_HELD,
                "1,000 random linear-Gaussian models, all terms in closed form: identity to 1e-4, no negative gap",
            )
        )
    return claims


def caption(preset: Preset, found: Ablation) -> str:
    """What the reader of the figure needs to know."""
    orthogonal = found.spectra[GAMMA]
    return (
        f"Trained {preset.steps} steps per member, bfloat16 products; bands and bars are 95 % intervals over "
        f"{preset.seeds} seeds (split, initialisation, minibatches; common to all variants). (a) Orthogonality "
        f"weight at k = {K}; star: selected on validation among γ > 0. (b) Coordinates of Full (γ = {GAMMA:g}, "
        f"β = 0.001) kept in other orders; random: eight permutations. (c) Components at k = {K}, each trained "
        "separately; black ticks: the paper's values on its own data. (d) Zoom: paired difference to Full, one grey "
        f"dot per seed. Singular values of W at γ = {GAMMA:g}: {orthogonal.values.min():.2f} to "
        f"{orthogonal.values.max():.2f}."
    )


def draw(path: Path, preset: Preset, found: Ablation) -> None:
    """The four panels."""
    with mpl.rc_context(fig.style()):
        figure, axes = fig.panels(2, 2, height_in=2.3)
        _draw_gamma(axes[0], preset, found)
        _draw_orders(axes[1], found)
        _draw_components(axes[2], found)
        _draw_zoom(axes[3], preset, found)
        fig.save_figure(figure, path)


def _draw_gamma(ax: Axes, preset: Preset, found: Ablation) -> None:
    gammas = (0.0, *preset.gammas)
    x = np.arange(len(gammas))
    for metric, label, colour, style in (
        ("test_mean_m", "test", fig.BLUE, "-"),
        ("val_mean_m", "validation", fig.GREY, "--"),
    ):
        curves = np.stack([found.at(named(gamma), K, metric) for gamma in gammas], axis=1)
        fig.band(ax, x, curves, colour, label, style, "o")
    chosen = found.selected_gamma(K)
    star = min(range(len(gammas)), key=lambda i: abs(gammas[i] - chosen))
    error = found.at(named(gammas[star]), K).mean()
    ax.plot(star, error, "*", ms=11, color=fig.RED, zorder=5, label=f"selected γ = {chosen:g}: {error:.1f} m")
    ax.set_xticks(x, [f"{gamma:g}" for gamma in gammas])
    ax.set(xlabel="orthogonality weight γ", ylabel=f"mean error at k = {K} (m)")
    ax.set_ylim(bottom=0)
    ax.legend(loc="lower left")
    fig.title(ax, "a", "orthogonality weight")


def _draw_orders(ax: Axes, found: Ablation) -> None:
    k = np.array(found.ks)
    fig.band(ax, k, found.orders.sel(ordering="learned").values, COLOURS["full"], "learned order")
    fig.band(ax, k, found.random_errors(), fig.GREEN, "random order", "--")
    fig.band(ax, k, found.orders.sel(ordering="tail_first").values, fig.ORANGE, "tail first", "-.")
    ax.set(xlabel="coordinates kept k", ylabel="mean error (m)", yscale="log", xlim=(0, 129))
    fig.plain_log_ticks(ax.yaxis)
    ax.legend(loc="center", bbox_to_anchor=(0.42, 0.36))
    fig.title(ax, "b", "the order is learned")


def _draw_components(ax: Axes, found: Ablation) -> None:
    for row, name in enumerate(NAMES):
        span = interval(found.at(name, K))
        half = span.half if np.isfinite(span.half) else 0.0
        ax.barh(row, span.mean, xerr=half, height=0.6, color=COLOURS[name], error_kw={"lw": 1, "capsize": 2})
        right = span.mean + half
        if name in PAPER_M:
            ax.plot(PAPER_M[name], row, "|", ms=13, mew=1.8, color="black", label="paper" if row == 0 else None)
            right = max(right, PAPER_M[name])
        ax.text(right * 1.1, row, f"{span.mean:.1f} m", va="center", fontsize=6.5)
    ax.set_yticks(range(len(NAMES)), list(NAMES.values()))
    ax.set(xlabel=f"mean error at k = {K} (m)", xscale="log", xlim=(1, 500))
    ax.invert_yaxis()
    ax.grid(visible=False, axis="y")
    ax.legend(loc="lower right")
    fig.plain_log_ticks(ax.xaxis, subs=(1.0, 3.0))
    fig.title(ax, "c", "components")


def _draw_zoom(ax: Axes, preset: Preset, found: Ablation) -> None:
    names = ["no_rate", *(named(gamma) for gamma in (0.0, *preset.gammas) if gamma != GAMMA)]
    for row, name in enumerate(names):
        differences = found.at(name, K) - found.at("full", K)
        span = interval(differences)
        half = span.half if np.isfinite(span.half) else 0.0
        ax.errorbar(span.mean, row, xerr=half, fmt="o", ms=4, color=COLOURS.get(name, fig.PURPLE), capsize=2, lw=1.2)
        ax.plot(differences, np.full(len(differences), row + 0.28), ".", ms=3, color="#888888")
        if name in PAPER_M:
            paper = PAPER_M[name] - PAPER_M["full"]
            ax.plot(paper, row, "|", ms=13, mew=1.8, color="black", label="paper" if row == 0 else None)
    ax.axvline(0, color=fig.BLUE, lw=1)
    ax.set_yticks(range(len(names)), [NAMES.get(name, "γ = " + name.removeprefix("gamma_")) for name in names])
    ax.set(xlabel=f"error minus error of Full at k = {K} (m)")
    ax.invert_yaxis()
    ax.grid(visible=False, axis="y")
    ax.legend(loc="lower left")
    fig.title(ax, "d", "zoom: paired differences to Full")

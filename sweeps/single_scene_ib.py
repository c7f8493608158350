"""Fig. "conference-version": the fixed-rate O-VIB with the ARD prior, its two weights, and its cost."""

import time
from dataclasses import dataclass

from ovibjax.cards.fixed_rate_drawing import draw
from ovibjax.cards.fixed_rate_study import (
    FixedRateStudy,
    K,
    table_rows,
    time_encoders,
    train_config,
    train_fusion,
    train_grid,
)
from ovibjax.cards.job import Job
from ovibjax.encoder.loss import BETA, GAMMA
from ovibjax.encoder.training_data import member_data
from ovibjax.report import figures as fig
from ovibjax.report.claims import Claim, interval, write_claims
from ovibjax.report.rows import write_rows
from ovibjax.runtime.precision_choice import faster_precision

TITLE = "Fixed-rate O-VIB of the conference version"


@dataclass(frozen=True)
class Preset:
    """Size of the experiment.

    Attributes:
        seeds: number of seeds.
        steps: training steps of the fixed-rate models; by the number of frames if None (`encoder.recipe`).
        fusion_seeds: seeds of the attention baseline.
        fusion_steps: its training steps.
        betas: ARD weights, at gamma = 0.1.
        gammas: orthogonality weights, at beta = 1e-3.
    """

    seeds: int
    steps: int | None
    fusion_seeds: int
    fusion_steps: int
    betas: tuple[float, ...]
    gammas: tuple[float, ...]

    @property
    def over_beta(self) -> list[tuple[float, float]]:
        """Points (beta, gamma) that differ in beta."""
        return [(beta, GAMMA) for beta in self.betas]

    @property
    def over_gamma(self) -> list[tuple[float, float]]:
        """Points (beta, gamma) that differ in gamma."""
        return [(BETA, gamma) for gamma in self.gammas]


PRESETS = {
    "smoke": Preset(2, 30, 2, 10, (1e-3, 1e-1), (0.0, 0.1)),
    "quick": Preset(2, None, 2, 3000, (1e-3, 1e-2, 1e-1, 3e-1), (0.0, 0.1, 1.0)),
    "full": Preset(4, None, 4, 3000, (1e-3, 1e-2, 3e-2, 1e-1, 3e-1), (0.0, 1e-2, 0.1, 1.0, 10.0)),
}


def run(job: Job) -> None:
    """Run the card: train the grid and the baseline, time the encoders, write table, claims and figure."""
    started = time.perf_counter()
    preset, precision = PRESETS[job.preset], faster_precision()
    seeds = [job.seed + i for i in range(preset.seeds)]
    with job.stage("features"):
        members = [member_data(job.features, seed, job.rank)[0] for seed in seeds]
    grid = [*preset.over_beta, *(point for point in preset.over_gamma if point not in preset.over_beta)]
    first = slice(preset.fusion_seeds)
    static = train_config(members[0], preset.steps, precision)
    steps = static.steps_on(len(members[0].train.x))
    trained = train_grid(job.sweep, grid, static, members, seeds)
    fusion = train_fusion(job.sweep, preset.fusion_steps, members[first], seeds[first])
    with job.stage("time"):
        found = FixedRateStudy(trained, fusion, time_encoders(members[0]))
    write_rows(job.out / "table.csv", table_rows(found))
    write_claims(job.out / "claims.json", judge_claims(preset, found))
    with job.stage("draw"):
        draw(job.out / "figure.png", found, preset.over_beta, preset.over_gamma)
    beta, gamma = found.best()
    job.record(
        *(TITLE, caption(preset, steps, found), seeds, started),
        steps=steps,
        fusion_steps=preset.fusion_steps,
        precision=precision,
        selected={"beta": beta, "gamma": gamma},
        host_ms={name: round(ms, 3) for name, ms in found.host_ms.items()},
        diverged=int(found.trained.diverged.sum()),
        members_of_an_earlier_run=int(found.trained.attrs["resumed"]),
    )


def judge_claims(preset: Preset, found: FixedRateStudy) -> list[Claim]:
    """The paper's claims about the fixed-rate model, by stated rules."""
    return [_pruning(preset, found), _pruning_costs(preset, found), _fusion(found), _orthogonality(preset, found)]


def _pruning(preset: Preset, found: FixedRateStudy) -> Claim:
    dims = [found.at(beta, GAMMA, "active_dims") for beta in preset.betas]
    return Claim.rising(
        "A larger ARD weight leaves fewer active dimensions, monotonically",
        "from 8 to 2",
        ", ".join(f"{interval(d).mean:.1f}" for d in dims) + _at_betas(preset),
        *(-d for d in dims),
        rule=f"paired intervals over {preset.seeds} trials: no increase from one weight to the next, fewer at the end",
    )


def _pruning_costs(preset: Preset, found: FixedRateStudy) -> Claim:
    errors_m = [found.at(beta, GAMMA) for beta in preset.betas]
    return Claim.rising(
        "A larger ARD weight raises the error",
        "from 9.57 to 16.65 m",
        ", ".join(interval(e).text("m") for e in errors_m) + _at_betas(preset),
        *errors_m,
        rule="paired intervals: no decrease from one weight to the next, more at the end",
    )


def _at_betas(preset: Preset) -> str:
    return " at β = " + ", ".join(f"{beta:g}" for beta in preset.betas)


def _fusion(found: FixedRateStudy) -> Claim:
    beta, gamma = found.best()
    ours, fusion = found.at(beta, gamma), found.fusion.test_mean_m.values
    common = ours[: len(fusion)]
    return Claim.less(
        "The selected fixed-rate O-VIB beats the multi-view fusion baseline",
        "9.06 against 10.92 m",
        f"{interval(ours).text('m')} (β = {beta:g}, γ = {gamma:g}) against {interval(fusion).text('m')}, "
        f"paired difference {interval(common - fusion).text('m')}",
        common,
        fusion,
        rule=f"the whole interval of the paired difference over {len(fusion)} common trials below zero",
        strict=True,
    )


def _orthogonality(preset: Preset, found: FixedRateStudy) -> Claim:
    changes = {g: interval(found.at(BETA, g) - found.at(BETA, 0.0)) for g in preset.gammas if g > 0}
    best = min(preset.gammas, key=lambda g: found.at(BETA, g, "val_mean_m").mean())
    return Claim.true(
        "Orthogonality helps at fixed rate: γ = 0.1 is the best weight",
        "γ = 0.1 best",
        f"validation selects γ = {best:g}; test error minus that of γ = 0: "
        + ", ".join(f"{change.text('m')} at {g:g}" for g, change in changes.items()),
        best == GAMMA and changes[GAMMA].high < 0,
        "selected on validation, and the paired interval against γ = 0 below zero",
    )


def caption(preset: Preset, steps: int, found: FixedRateStudy) -> str:
    """What the reader of the figure needs to know."""
    fusion = f"{preset.fusion_steps} steps, {preset.fusion_seeds} trials"
    return (
        f"Fixed rate K = {K}, log-uniform prior, {steps} steps, {preset.seeds} trials per point. "
        f"{fig.spread(preset.seeds, 'trials')}. (a) Weight of the ARD term at γ = 0.1: coordinates not pruned "
        "(log α at most 3) and error. (b) Error over β at γ = 0.1 and (c) over γ at β = 0.001; every trial a dot, "
        f"star: lowest validation error of the panel; dashed: attention fusion of all views, no bottleneck ({fusion}). "
        "(d) Encoding one frame after feature extraction: the paper's Jetson profile read off its table (Jetson), and "
        "this machine (here), measured."
    )

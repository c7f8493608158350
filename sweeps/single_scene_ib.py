"""Fig. "conference-version": the fixed-rate O-VIB with the ARD prior, its two weights, and its cost."""

import itertools
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
import xarray
from matplotlib.axes import Axes

from ovibjax.cards.job import Job
from ovibjax.edge.member import DIMS, UNITS, FuseAndLocate, TrainAndJudge
from ovibjax.encoder.attention import AttentionConfig, init_attention, predict
from ovibjax.encoder.data_split import MemberData, member_data
from ovibjax.encoder.model import Architecture, encode, init
from ovibjax.encoder.train import TrainConfig
from ovibjax.link.latency import JETSON, compute_ms_at, measure_host
from ovibjax.report import figures as fig
from ovibjax.report.claims import HELD, NOT_HELD, Claim, Interval, above, below, interval, weakest, write_claims
from ovibjax.report.rows import write_rows
from ovibjax.sweep.work import Along
from ovibjax.views import full_mode

TITLE = "Fixed-rate O-VIB of the conference version"
K = 16
BETA, GAMMA = 1e-3, 0.1


@dataclass(frozen=True)
class Preset:
    """Size of the experiment.

    Attributes:
        trials: number of seeds.
        steps: training steps of the fixed-rate models.
        lr: their peak learning rate.
        betas: ARD weights, at gamma = 0.1.
        gammas: orthogonality weights, at beta = 1e-3.
        fusion_trials: seeds of the attention baseline.
        fusion_steps: its training steps.
    """

    trials: int
    steps: int
    lr: float
    betas: tuple[float, ...]
    gammas: tuple[float, ...]
    fusion_trials: int
    fusion_steps: int


PRESETS = {
    "smoke": Preset(2, 30, 3e-3, (1e-3, 1e-1), (0.0, 0.1), 2, 10),
    "quick": Preset(3, 800, 3e-3, (1e-3, 1e-2, 1e-1, 3e-1), (0.0, 0.1, 1.0), 2, 300),
    "full": Preset(10, 2000, 3e-3, (1e-4, 1e-3, 1e-2, 3e-2, 1e-1, 3e-1), (0.0, 1e-3, 1e-2, 0.1, 1.0, 10.0), 5, 3000),
}


@dataclass(frozen=True)
class Found:
    """Results.

    Attributes:
        trained: errors and active dimensions [point, seed]; coordinates beta and gamma along `point`.
        fusion: the attention baseline [seed].
        host_ms: encoding one frame on this machine, by method.
    """

    trained: xarray.Dataset
    fusion: xarray.Dataset
    host_ms: dict[str, float]

    def at(self, beta: float, gamma: float, metric: str = "test_mean_m") -> np.ndarray:
        """[seeds] a metric at one point."""
        match = np.isclose(self.trained.beta.values, beta) & np.isclose(self.trained.gamma.values, gamma)
        return self.trained[metric].values[int(np.flatnonzero(match)[0])]

    def best(self) -> tuple[float, float]:
        """(beta, gamma) with the lowest mean validation error."""
        point = int(np.argmin(self.trained.val_mean_m.mean("seed").values))
        return float(self.trained.beta[point]), float(self.trained.gamma[point])


def run(job: Job) -> None:
    """Run the card: train the grid and the baseline, time the encoders, write table, claims and figure."""
    started = time.perf_counter()
    preset = PRESETS[job.preset]
    seeds = [job.seed + i for i in range(preset.trials)]
    members = [member_data(job.features, seed, job.rank)[0] for seed in seeds]
    found = Found(
        train_grid(job, preset, members, seeds),
        train_fusion(job, preset, members, seeds),
        time_encoders(members[0]),
    )
    write_rows(job.out / "table.csv", table_rows(found))
    write_claims(job.out / "claims.json", judge_claims(preset, found))
    draw(job.out / "figure.png", preset, found)
    beta, gamma = found.best()
    job.record(
        *(TITLE, caption(preset, found), seeds, started),
        steps=preset.steps,
        fusion_steps=preset.fusion_steps,
        precision="bfloat16",
        selected={"beta": beta, "gamma": gamma},
        host_ms={name: round(ms, 3) for name, ms in found.host_ms.items()},
        diverged=int(found.trained.diverged.sum()),
        members_of_an_earlier_run=int(found.trained.attrs["resumed"]),
    )


def train_grid(job: Job, preset: Preset, members: list[MemberData], seeds: list[int]) -> xarray.Dataset:
    """Both one-dimensional sweeps in one: points (beta, gamma) that advance together, times seeds."""
    points = [(beta, GAMMA) for beta in preset.betas]
    points += [(BETA, gamma) for gamma in preset.gammas if (BETA, gamma) not in points]
    views, dim = members[0].train.x.shape[1:]
    static = TrainConfig(
        arch=Architecture(n_views=views, view_dim=dim, latent=K),
        prefixes=(K,),
        prior="ard",
        steps=preset.steps,
        precision="bfloat16",
    )
    beta, gamma = zip(*points, strict=True)
    dataset = job.sweep(
        "training fixed-rate models",
        TrainAndJudge(static, (K,), (full_mode(views),), lr=preset.lr),
        {"beta": beta, "gamma": gamma, "seed": seeds},
        Along("seed", members),
        zipped=[["beta", "gamma"]],
        dims=DIMS,
        units=UNITS,
    )
    return dataset.squeeze(["mode", "prefix"]).rename_dims({"beta_gamma": "point"})


def train_fusion(job: Job, preset: Preset, members: list[MemberData], seeds: list[int]) -> xarray.Dataset:
    """The attention baseline on the first seeds."""
    views, dim = members[0].train.x.shape[1:]
    static = AttentionConfig(n_views=views, view_dim=dim, steps=preset.fusion_steps)
    trials = preset.fusion_trials
    return job.sweep(
        "fusion baseline",
        FuseAndLocate(static),
        {"seed": seeds[:trials]},
        Along("seed", members[:trials]),
        units={"val_mean_m": "m", "test_mean_m": "m"},
    )


def time_encoders(member: MemberData) -> dict[str, float]:
    """Median milliseconds per frame on this machine; untrained weights cost the same."""
    views, dim = member.train.x.shape[1:]
    x = member.test_x[:1]
    cost = {}
    for latent in (K, 128):
        arch = Architecture(n_views=views, view_dim=dim, latent=latent)
        params = init(jax.random.key(0), arch)
        run_once = jax.jit(lambda p, v, arch=arch: encode(p, v.reshape(1, -1), arch)[0])
        cost[f"O-VIB, K = {latent}"] = _median_ms(lambda _, f=run_once, p=params: f(p, x))
    static = AttentionConfig(n_views=views, view_dim=dim)
    fusion = init_attention(jax.random.key(0), static)
    mask = jnp.ones(views, jnp.float32)
    fuse = jax.jit(lambda p, v: predict(p, v, mask, static))
    return cost | {"attention fusion": _median_ms(lambda _: fuse(fusion, x))}


def _median_ms(encode_once: Any) -> float:
    return float(compute_ms_at(measure_host(encode_once, [1]), 1))


def table_rows(found: Found) -> list[dict[str, Any]]:
    """One tidy row per member."""
    rows: list[dict[str, Any]] = []
    for point in range(found.trained.sizes["point"]):
        for seed in found.trained.seed.values:
            part = found.trained.isel(point=point).sel(seed=seed)
            known = {"method": "ovib_fixed", "k": K, "beta": float(part.beta), "gamma": float(part.gamma)}
            errors = {name: float(part[name]) for name in ("val_mean_m", "test_mean_m", "test_p90_m", "eta")}
            more = {"active_dims": int(part.active_dims), "diverged": bool(part.diverged)}
            rows.append(known | {"seed": int(seed)} | errors | more)
    for seed in found.fusion.seed.values:
        part = found.fusion.sel(seed=seed)
        errors = {name: float(part[name]) for name in ("val_mean_m", "test_mean_m")}
        blank = dict.fromkeys(rows[0], "")
        rows.append(blank | {"method": "attention_fusion", "seed": int(seed), "diverged": bool(part.diverged)} | errors)
    return rows


def _steps_between(preset: Preset, found: Found, metric: str) -> list[Interval]:
    """Paired change of a metric from each ARD weight to the next."""
    values = [found.at(beta, GAMMA, metric) for beta in preset.betas]
    return [interval(after - before) for before, after in itertools.pairwise(values)]


def judge_claims(preset: Preset, found: Found) -> list[Claim]:
    """The paper's claims about the fixed-rate model, by stated rules."""
    dims = [interval(found.at(beta, GAMMA, "active_dims")) for beta in preset.betas]
    errors = [interval(found.at(beta, GAMMA)) for beta in preset.betas]
    fewer, worse = _steps_between(preset, found, "active_dims"), _steps_between(preset, found, "test_mean_m")

    def ends(metric: str) -> Interval:
        return interval(found.at(preset.betas[-1], GAMMA, metric) - found.at(preset.betas[0], GAMMA, metric))

    beta, gamma = found.best()
    ours = found.at(beta, gamma)
    fusion = found.fusion.test_mean_m.values
    margin = interval(ours[: len(fusion)] - fusion)
    orthogonal = {g: interval(found.at(BETA, g) - found.at(BETA, 0.0)) for g in preset.gammas if g > 0}
    best_gamma = min(preset.gammas, key=lambda g: found.at(BETA, g, "val_mean_m").mean())
    return [
        Claim(
            "A larger ARD weight leaves fewer active dimensions, monotonically",
            "from 8 to 2",
            ", ".join(f"{d.mean:.1f}" for d in dims) + " at β = " + ", ".join(f"{b:g}" for b in preset.betas),
            weakest([*(below(step, 0.0) for step in fewer), HELD if ends("active_dims").high < 0 else NOT_HELD]),
            f"paired intervals over {preset.trials} trials: no increase from one weight to the next, fewer at the end",
        ),
        Claim(
            "A larger ARD weight raises the error",
            "from 9.57 to 16.65 m",
            ", ".join(e.text("m") for e in errors) + " at β = " + ", ".join(f"{b:g}" for b in preset.betas),
            weakest([*(above(step, 0.0) for step in worse), HELD if ends("test_mean_m").low > 0 else NOT_HELD]),
            "paired intervals: no decrease from one weight to the next, more at the end",
        ),
        Claim(
            "The selected fixed-rate O-VIB beats the multi-view fusion baseline",
            "9.06 against 10.92 m",
            f"{interval(ours).text('m')} (β = {beta:g}, γ = {gamma:g}) against {interval(fusion).text('m')}, "
            f"paired difference {margin.text('m')}",
            HELD if margin.high < 0 else NOT_HELD,
            f"the whole interval of the paired difference over {len(fusion)} common trials below zero",
        ),
        Claim(
            "Orthogonality helps at fixed rate: γ = 0.1 is the best weight",
            "γ = 0.1 best",
            f"validation selects γ = {best_gamma:g}; test error minus that of γ = 0: "
            + ", ".join(f"{d.text('m')} at {g:g}" for g, d in orthogonal.items()),
            HELD if best_gamma == GAMMA and orthogonal[GAMMA].high < 0 else NOT_HELD,
            "selected on validation, and the paired interval against γ = 0 below zero",
        ),
    ]


def caption(preset: Preset, found: Found) -> str:
    """What the reader of the figure needs to know."""
    return (
        f"Fixed rate K = {K}, log-uniform prior, {preset.steps} steps, {preset.trials} trials per point; bands are "
        "95 % intervals over trials. (a) Weight of the ARD term at γ = 0.1: coordinates not pruned (log α at most 3) "
        "and error. (b) Error over β at γ = 0.1 and (c) over γ at β = 0.001; every trial a dot, star: lowest "
        f"validation error of the panel; dashed: attention fusion of all views, no bottleneck ({preset.fusion_steps} "
        f"steps, {preset.fusion_trials} trials). (d) Encoding one frame after feature extraction: the paper's Jetson "
        "profile read off its table (Jetson), and this machine (here), measured."
    )


def draw(path: Path, preset: Preset, found: Found) -> None:
    """The four panels."""
    with mpl.rc_context(fig.style()):
        figure, axes = fig.panels(2, 2, height_in=2.2)
        _draw_ard(axes[0], preset, found)
        _draw_sweep(axes[1], found, [(beta, GAMMA) for beta in preset.betas], preset.betas, "rate weight β")
        _draw_sweep(axes[2], found, [(BETA, g) for g in preset.gammas], preset.gammas, "orthogonality weight γ")
        fig.title(axes[1], "b", "fixed k = 16 over β")
        fig.title(axes[2], "c", "fixed k = 16 over γ")
        _draw_cost(axes[3], found)
        fig.save_figure(figure, path)


def _draw_ard(ax: Axes, preset: Preset, found: Found) -> None:
    x = np.arange(len(preset.betas))
    dims = np.stack([found.at(beta, GAMMA, "active_dims") for beta in preset.betas], axis=1).astype(float)
    errors = np.stack([found.at(beta, GAMMA) for beta in preset.betas], axis=1)
    right = ax.twinx()
    fig.band(ax, x, dims, fig.BLUE, "active dimensions", "-", "o")
    fig.band(right, x, errors, fig.RED, "error", "--", "s")
    ax.set_xticks(x, [f"{beta:g}" for beta in preset.betas])
    ax.set(xlabel="ARD weight β", ylim=(0, K + 1))
    ax.set_ylabel("active dimensions of 16", color=fig.BLUE)
    right.set(yscale="log")
    right.set_ylabel("mean error (m)", color=fig.RED)
    right.spines["right"].set_visible(True)
    right.grid(visible=False)
    fig.plain_log_ticks(right.yaxis)
    fig.title(ax, "a", "ARD prunes, and pruning costs")


def _draw_sweep(
    ax: Axes, found: Found, points: list[tuple[float, float]], values: tuple[float, ...], label: str
) -> None:
    x = np.arange(len(points))
    curves = np.stack([found.at(*point) for point in points], axis=1)
    fig.band(ax, x, curves, fig.BLUE, f"O-VIB, k = {K}", "-", "o")
    for trial in curves:
        ax.plot(x, trial, ".", ms=2.5, color="#888888", zorder=1)
    chosen = int(np.argmin([found.at(*point, "val_mean_m").mean() for point in points]))
    best = curves[:, chosen].mean()
    ax.plot(chosen, best, "*", ms=11, color=fig.RED, zorder=5, label=f"selected: {best:.1f} m")
    fusion = float(found.fusion.test_mean_m.mean())
    ax.axhline(fusion, color=fig.ORANGE, ls="--", lw=1.2, label=f"attention fusion: {fusion:.1f} m")
    ax.set_xticks(x, [f"{value:g}" for value in values])
    ax.set(xlabel=label, ylabel="mean error (m)", yscale="log")
    fig.plain_log_ticks(ax.yaxis)
    low, high = ax.get_ylim()
    ax.set_ylim(low, high * (high / low) ** 0.5)  # room for the legend
    ax.legend(loc="upper left")


def _draw_cost(ax: Axes, found: Found) -> None:
    rows = [(f"Jetson: O-VIB, K = {k}", float(compute_ms_at(JETSON, k)), fig.ORANGE) for k in (16, 32, 128)]
    rows += [(f"here: {name}", ms, fig.BLUE) for name, ms in found.host_ms.items()]
    for row, (_, ms, colour) in enumerate(rows):
        ax.barh(row, ms, height=0.6, color=colour)
        ax.text(ms * 1.12, row, f"{ms:.1f} ms" if ms >= 1 else f"{ms:.2f} ms", va="center", fontsize=6.5)
    ax.set_yticks(range(len(rows)), [name for name, _, _ in rows])
    ax.set(xlabel="encoding one frame (ms)", xscale="log", xlim=(0.03, 300))
    ax.invert_yaxis()
    ax.grid(visible=False, axis="y")
    fig.plain_log_ticks(ax.xaxis, subs=(1.0,))
    fig.title(ax, "d", "compute cost")

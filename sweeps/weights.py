"""The six weights of VOI-Lyapunov and the V of Base-DPP, searched: what is left on the table beside the paper's."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from ovibjax.cards.job import Job
from ovibjax.cards.scheduling_drawing import events_of
from ovibjax.control.policy_study import seeds_to_keys
from ovibjax.report import figures as fig
from ovibjax.report.claims import REPORTED, Claim, interval, positive, write_claims
from ovibjax.report.rows import write_rows
from ovibjax.runtime.progress import console
from ovibjax.scheduling.clients import Events, GroupMetrics, ReplayMetrics, default_trace_params
from ovibjax.scheduling.congestion import LEVELS, PHASE_SPREAD_S, Case, compare, search
from ovibjax.scheduling.rules import SchedulerParams, Weights, default_params

TITLE = "Scheduler weights, searched"
VS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
SETTINGS = ("paper", "tuned_top10", "tuned_all")
NAMES = {"paper": "paper's weights", "tuned_top10": "tuned: top decile", "tuned_all": "tuned: all requests"}
COLOURS = {"paper": fig.BLUE, "tuned_top10": fig.RED, "tuned_all": fig.GREEN}


@dataclass(frozen=True)
class Preset:
    """Size of the search.

    Attributes:
        candidates: weight vectors tried, the paper's among them.
        tuning_seeds: seeds 0, 1, ... they are tried on.
        held_out_seeds: seeds they are judged on.
    """

    candidates: int
    tuning_seeds: int
    held_out_seeds: int


PRESETS = {"smoke": Preset(32, 2, 2), "quick": Preset(1024, 4, 16), "full": Preset(4096, 8, 64)}


@dataclass(frozen=True)
class Found:
    """Results on the host.

    Attributes:
        tried: [candidates, 6] weights; the first are the paper's.
        tuning: [candidates, 4] mean objectives on tuning seeds, see `congestion.objectives`.
        chosen: candidate of each of `SETTINGS`.
        held_out: [seeds, settings] metrics of VOI-Lyapunov.
        base_dpp: [seeds, V] metrics of Base-DPP.
        best_v: position in `VS` of the V with the lowest top-decile cost on tuning seeds.
    """

    tried: np.ndarray
    tuning: np.ndarray
    chosen: tuple[int, ...]
    held_out: ReplayMetrics
    base_dpp: ReplayMetrics
    best_v: int

    def of(self, setting: str, scope: str, metric: str) -> np.ndarray:
        """[seeds] a held-out metric of a setting."""
        return _column(self.held_out, scope, metric)[:, SETTINGS.index(setting)]


def _column(found: ReplayMetrics, scope: str, metric: str) -> np.ndarray:
    group: GroupMetrics = found.top if scope == "top10" else found.every
    return np.asarray(getattr(group, metric), np.float64)[0]


def run(job: Job) -> None:
    """Run the card: search, held-out comparison, tables, claims, figure."""
    started = time.perf_counter()
    preset = PRESETS[job.preset]
    events = events_of(job)
    seeds = [job.seed + i for i in range(preset.held_out_seeds)]
    with console.status("searching the weights"):
        found = look(events, seeds, preset)
    write_rows(job.out / "table.csv", table_rows(found, seeds))
    write_rows(job.out / "weights.csv", weight_rows(found))
    write_claims(job.out / "claims.json", judge_claims(found))
    draw(job.out / "figure.png", found)
    tuning = f"0 to {preset.tuning_seeds - 1}"
    job.record(TITLE, caption(preset, seeds), seeds, started, tuning_seeds=tuning, candidates=preset.candidates)


def candidates(count: int) -> Weights:
    """Weight vectors: the paper's first, then log-uniform between 0.03 and 10."""
    key = jax.random.key(0)
    draws = jax.vmap(lambda i: jax.random.uniform(jax.random.fold_in(key, i), (6,)))(jnp.arange(count))
    table = 10.0 ** (2.5 * draws - 1.5)
    table = table.at[0].set(jnp.stack(default_params().weights))
    return Weights(*table.T)


def look(events: Events, seeds: list[int], preset: Preset) -> Found:
    """Search on tuning seeds, judge on held-out ones, at high congestion."""
    n, rate = LEVELS["high"]
    case = Case(jnp.array([n]), jnp.array([rate], jnp.float32), jnp.array([PHASE_SPREAD_S], jnp.float32))
    trace, params = default_trace_params(), default_params()
    tuning_keys, held_keys = seeds_to_keys(list(range(preset.tuning_seeds))), seeds_to_keys(seeds)
    tried = candidates(preset.candidates)
    objectives = np.asarray(search(tuning_keys, events, case, trace, params._replace(weights=tried), n))
    tuning = objectives[0].mean(axis=0)
    chosen = (0, int(np.argmin(tuning[:, 0])), int(np.argmin(tuning[:, 2])))
    picked = Weights(*(leaf[np.array(chosen)] for leaf in tried))
    by_v: SchedulerParams = params._replace(V=jnp.array(VS, jnp.float32))
    tuned_v = compare(tuning_keys, events, case, trace, by_v, n, ("base_dpp",))["base_dpp"]
    best_v = int(np.argmin(_column(jax.device_get(tuned_v), "top10", "cost").mean(axis=0)))
    shaped = compare(held_keys, events, case, trace, params._replace(weights=picked), n, ("voi_lyapunov",))
    base = compare(held_keys, events, case, trace, by_v, n, ("base_dpp",))["base_dpp"]
    held_out, base = jax.device_get((shaped["voi_lyapunov"], base))
    return Found(np.stack([np.asarray(w) for w in tried], axis=1), tuning, chosen, held_out, base, best_v)


def table_rows(found: Found, seeds: list[int]) -> list[dict[str, Any]]:
    """One row per setting, held-out seed and scope."""
    metrics = ("edge_p95_ms", "e2e_p95_ms", "stale_m", "cost")
    rows = []
    for setting in SETTINGS:
        for i, seed in enumerate(seeds):
            for scope in ("top10", "all"):
                values = {metric: float(found.of(setting, scope, metric)[i]) for metric in metrics}
                rows.append({"setting": setting, "seed": seed, "scope": scope, **values})
    return rows


def weight_rows(found: Found) -> list[dict[str, Any]]:
    """The weights of each setting."""
    return [
        {"setting": setting, **{n: float(w) for n, w in zip(Weights._fields, found.tried[c], strict=True)}}
        for setting, c in zip(SETTINGS, found.chosen, strict=True)
    ]


def judge_claims(found: Found) -> list[Claim]:
    """What tuning gains on held-out seeds (no claim of the paper)."""
    claims = []
    for setting, scope, word in (("tuned_top10", "top10", "the top decile"), ("tuned_all", "all", "all requests")):
        paper, tuned = found.of("paper", scope, "cost"), found.of(setting, scope, "cost")
        gain, percent = interval(paper - tuned), interval(100.0 * (paper - tuned) / paper.mean())
        claims.append(
            Claim(
                f"Weights tuned for the cost of {word} beat the paper's on held-out seeds",
                "fixed before testing",
                f"cost {interval(tuned).text()} against {interval(paper).text()}, {percent.text('%', 1)} lower",
                positive(gain),
                "paired 95 % interval above zero",
            )
        )
    other = interval(found.of("tuned_top10", "all", "edge_p95_ms") - found.of("paper", "all", "edge_p95_ms"))
    claims.append(
        Claim(
            "What tuning for the top decile does to all requests: change of their edge p95",
            "-",
            other.text("ms", 1),
            REPORTED,
            "tuned minus paper's, paired",
        )
    )
    base = _column(found.base_dpp, "top10", "cost")
    gain = interval(base[:, VS.index(8.0)] - base[:, found.best_v])
    claims.append(
        Claim(
            f"Base-DPP gains from another V than 8 (tuned: {VS[found.best_v]:g})",
            "V = 8",
            f"top-decile cost lower by {gain.text()}",
            positive(gain) if found.best_v != VS.index(8.0) else REPORTED,
            "paired 95 % interval above zero",
        )
    )
    return claims


def caption(preset: Preset, seeds: list[int]) -> str:
    """What the reader of the figure needs to know."""
    return (
        f"High congestion (30 clients, 4 KB/s). (a) {preset.candidates} weight vectors of VOI-Lyapunov on "
        f"{preset.tuning_seeds} tuning seeds; stars: the paper's, and the best for either cost. (b) Cost on "
        f"{len(seeds)} held-out seeds, 95 % intervals. (c) The weights: value per service, value, laxity, age, "
        "overrun, service."
    )


def draw(path: Path, found: Found) -> None:
    """The three panels."""
    with mpl.rc_context(fig.style()):
        figure, axes = fig.panels(3, 1, height_in=2.4)
        _draw_search(axes[0], found)
        _draw_held_out(axes[1], found)
        _draw_weights(axes[2], found)
        fig.save_figure(figure, path)


def _draw_search(ax: Axes, found: Found) -> None:
    top, every = found.tuning[:, 0], found.tuning[:, 2]
    ax.plot(top, every, ".", ms=1.5, color=fig.SKY, alpha=0.6)
    for setting, c in zip(SETTINGS, found.chosen, strict=True):
        ax.plot(top[c], every[c], "*", ms=11, color=COLOURS[setting], label=NAMES[setting], zorder=4)
    ax.set(xlabel="cost, top decile", ylabel="cost, all requests")
    ax.legend(loc="upper right", frameon=True, framealpha=0.85, edgecolor="none")
    fig.title(ax, "a", "tuning seeds")


def _draw_held_out(ax: Axes, found: Found) -> None:
    for i, setting in enumerate(SETTINGS):
        spans = [interval(found.of(setting, scope, "cost")) for scope in ("top10", "all")]
        half = [s.half if np.isfinite(s.half) else 0.0 for s in spans]
        x = np.arange(2) + (i - 1) * 0.26
        ax.bar(x, [s.mean for s in spans], 0.24, yerr=half, color=COLOURS[setting], error_kw={"lw": 1, "capsize": 2})
        for place, span in zip(x, spans, strict=True):
            ax.text(place, 0.03, f"{span.mean:.2f}", ha="center", color="white", fontsize=6, rotation=90, va="bottom")
    ax.set_xticks(range(2), ["top decile", "all requests"])
    ax.set(ylabel="weighted cost")
    ax.grid(visible=False, axis="x")
    fig.title(ax, "b", "held-out seeds")


def _draw_weights(ax: Axes, found: Found) -> None:
    x = np.arange(6)
    for i, (setting, c) in enumerate(zip(SETTINGS, found.chosen, strict=True)):
        ax.bar(x + (i - 1) * 0.26, found.tried[c], 0.24, color=COLOURS[setting])
    ax.set_xticks(x, ["v/G", "v", "laxity", "age", "overr.", "G"])
    ax.set(ylabel="weight", yscale="log")
    fig.plain_log_ticks(ax.yaxis, subs=(1.0, 3.0))
    ax.grid(visible=False, axis="x")
    fig.title(ax, "c", "the weights")

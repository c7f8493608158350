"""The whole system on a (beta, gamma, k, V, scheduler, seed) grid, in one compiled program (not in the paper)."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray
from matplotlib.axes import Axes

from ovibjax.cards.control_study import PAPER_PROFILE_KB_PER_S, drives_of
from ovibjax.cards.job import Job
from ovibjax.cards.scheduling_drawing import COLOURS, NAMES
from ovibjax.report import figures as fig
from ovibjax.report.claims import HELD, NOT_HELD, REPORTED, Claim, interval, positive, write_claims
from ovibjax.report.rows import write_rows
from ovibjax.report.shares import variance_shares
from ovibjax.runtime.progress import progress_bar
from ovibjax.scheduling.rules import POLICIES
from ovibjax.system.data import SystemSize
from ovibjax.system.grids import sweep_system

TITLE = "The whole system on one grid"
GREEK = {"beta": "β", "gamma": "γ", "scheduler": "rule"}
SHARES = {
    "mean_route_m": "route error",
    "kb": "KB per route",
    "top_edge_p95_ms": "top edge p95",
    "top_cost": "top cost",
}
PALETTE = (fig.BLUE, fig.ORANGE, fig.GREEN, fig.PURPLE, fig.RED, fig.SKY, fig.YELLOW)
REST = "#cccccc"
BUDGET_KB = 2.1


@dataclass(frozen=True)
class Preset:
    """The grid.

    Attributes:
        betas: weights of the rate term.
        gammas: weights of the orthogonality penalty.
        ks: prefix lengths.
        Vs: weights of VOI against backlog.
        seeds: number of seeds.
        size: how much is trained and replayed.
        scene: preset of the drives.
    """

    betas: tuple[float, ...]
    gammas: tuple[float, ...]
    ks: tuple[int, ...]
    Vs: tuple[float, ...]
    seeds: int
    size: SystemSize
    scene: str


VS = (0.0, 1.0, 4.0, 8.0, 16.0, 64.0)
PRESETS = {
    "smoke": Preset((1e-3,), (0.1,), (8, 16), (0.0, 8.0), 2, SystemSize(20, 256, clients=2, fleet=4), "smoke"),
    "quick": Preset((1e-4, 1e-2), (0.0, 0.1), (8, 16, 32, 64), VS, 2, SystemSize(), "full"),
    "full": Preset((1e-4, 1e-3, 1e-2), (0.0, 0.1, 1.0), (8, 16, 32, 64), VS, 5, SystemSize(2000), "full"),
}


def run(job: Job) -> None:
    """Run the card: one sweep, table, claims, figure."""
    started = time.perf_counter()
    preset = PRESETS[job.preset]
    with progress_bar("rendering the routes", 1) as update:
        drives, training = drives_of(preset.scene, job.own_features, update)
    seeds = [job.seed + i for i in range(preset.seeds)]
    axes = {"beta": list(preset.betas), "gamma": list(preset.gammas), "seed": seeds}
    along = (preset.ks, preset.Vs, POLICIES)

    def compute(**options: Any) -> xarray.Dataset:
        return sweep_system((drives, training, preset.size), axes, along, **options)

    found = job.kept("training and replaying the system", compute)
    write_rows(job.out / "table.csv", table_rows(found))
    write_claims(job.out / "claims.json", judge_claims(found))
    draw(job.out / "figure.png", found)
    points = int(np.prod([found.sizes[dim] for dim in ("beta", "gamma", "k", "V", "seed")]))
    job.record(
        *(TITLE, caption(found, preset, points), seeds, started),
        points=points,
        schedulers=len(POLICIES),
        steps=preset.size.steps,
        unserved=int(found.unserved.sum()),
        resumed_members=found.attrs["resumed"],
    )


def table_rows(found: xarray.Dataset) -> list[dict[str, Any]]:
    """One row per point and rule, means over seeds with half-widths of 95 % intervals."""
    columns = ("mean_route_m", "p95_route_m", "kb", "top_edge_p95_ms", "top_cost", "all_edge_p95_ms")
    dims = ("beta", "gamma", "k", "V", "scheduler")
    grid = {name: found[name].broadcast_like(found.top_cost).transpose(*dims, "seed").values for name in columns}
    rows = []
    for at in np.ndindex(*(found.sizes[dim] for dim in dims)):
        row: dict[str, Any] = {dim: found[dim].values[i] for dim, i in zip(dims, at, strict=True)}
        for name in columns:
            span = interval(grid[name][at])
            row |= {name: f"{span.mean:.4g}", f"{name}_ci": f"{span.half:.3g}"}
        rows.append(row)
    return rows


def judge_claims(found: xarray.Dataset) -> list[Claim]:
    """What the grid says, with intervals over seeds."""
    middle = found.isel(beta=found.sizes["beta"] // 2, gamma=found.sizes["gamma"] // 2)
    claims = []
    for axis, metric, unit in (
        ("beta", "mean_route_m", "m"),
        ("gamma", "mean_route_m", "m"),
        ("k", "mean_route_m", "m"),
        ("beta", "top_edge_p95_ms", "ms"),
        ("k", "top_edge_p95_ms", "ms"),
    ):
        values = found[metric].mean([dim for dim in found[metric].dims if dim not in (axis, "seed")])
        low, high = (found[axis].values[i] for i in (0, -1))
        change = interval(values.sel({axis: high}).values - values.sel({axis: low}).values)
        claims.append(
            Claim(
                f"How far {axis} from {low:g} to {high:g} moves {SHARES[metric]}, over the rest of the grid",
                *("-", change.text(unit), REPORTED),
                "paired difference over seeds",
            )
        )
    shaped = middle.top_cost.isel(V=0)
    gain = interval((shaped.sel(scheduler="fifo") - shaped.sel(scheduler="voi_lyapunov")).mean("k").values)
    claims.append(
        Claim(
            "VOI-Lyapunov has a lower weighted cost than FIFO for the top decile at every prefix, in the whole system",
            *("lower", f"{gain.text()} lower, mean over k", positive(gain)),
            "the whole interval of the paired difference above zero",
        )
    )
    spent = float(found.kb.max())
    claims.append(
        Claim(
            f"No point and no seed sends more than the budget of {BUDGET_KB} KB a route",
            *("2.1 KB", f"at most {spent:.3f} KB", HELD if spent <= BUDGET_KB else NOT_HELD),
            "the largest mean payload of a route over the grid",
        )
    )
    return claims


def caption(found: xarray.Dataset, preset: Preset, points: int) -> str:
    """What the reader of the figure needs to know."""
    size = preset.size
    return (
        f"{points} points x {len(POLICIES)} rules, one program: an encoder per (β, γ, seed), retrieval, g_ψ and "
        f"request control per k, the queue per V and rule. {size.clients} clients on held-out routes, each followed by "
        f"a fleet of {size.fleet} that repeats its requests, at {size.kb_per_s:g} KB/s (the paper's high congestion; "
        f"its request control is at {PAPER_PROFILE_KB_PER_S:g} KB/s). (a) Route error and (b) top-decile edge p95 "
        "against k. (c) Every point, the lowest edge p95 on top; outlined: no other is better in KB, route error and "
        "edge p95 together. (d) "
        "Variance shares by axis, two-way interactions and the rest. Bands are 95 % intervals over "
        f"{found.sizes['seed']} seeds. V moves Base-DPP only."
    )


def draw(path: Path, found: xarray.Dataset) -> None:
    """The four panels."""
    with mpl.rc_context(fig.style()):
        figure, axes = fig.panels(2, 2, height_in=2.3)
        _draw_error(axes[0], found)
        _draw_edge(axes[1], found)
        _draw_front(axes[2], found)
        _draw_shares(axes[3], found)
        fig.save_figure(figure, path)


def _prefix_axis(ax: Axes, found: xarray.Dataset) -> None:
    ks = found.k.values
    ax.set_xscale("log", base=2)
    ax.set_xticks(ks, [str(k) for k in ks])
    ax.minorticks_off()
    ax.set_xlabel("prefix length k (floats)")


def _draw_error(ax: Axes, found: xarray.Dataset) -> None:
    for beta, colour in zip(found.beta.values, PALETTE, strict=False):
        curves = found.mean_route_m.sel(beta=beta).mean("gamma").transpose("seed", "k").values
        fig.band(ax, found.k.values, curves, colour, f"β = {beta:g}", marker="o")
    _prefix_axis(ax, found)
    ax.set(ylabel="mean route error (m)", ylim=(0, None))
    ax.legend(loc="lower right")
    fig.title(ax, "a", "route error at one payload budget")


def _draw_edge(ax: Axes, found: xarray.Dataset) -> None:
    tail = found.top_edge_p95_ms.mean(["beta", "gamma"]).sel(V=8.0, method="nearest")
    for rule in ("edf", "fifo", "base_dpp", "voi_lyapunov"):
        curves = tail.sel(scheduler=rule).transpose("seed", "k").values
        style = "--" if rule == "base_dpp" else "-"
        fig.band(ax, found.k.values, curves, COLOURS[rule], NAMES[rule], style, marker="o")
    _prefix_axis(ax, found)
    ax.set(ylabel="edge p95, top decile (ms)", ylim=(0, None))
    ax.legend(loc="lower left", ncols=2)
    fig.title(ax, "b", "edge latency by rule")


def pareto(points: np.ndarray) -> np.ndarray:
    """[P] bool, points [P, D] that no other point beats or equals in every coordinate and beats in one."""
    no_worse = np.all(points[None] <= points[:, None], axis=2)
    better = np.any(points[None] < points[:, None], axis=2)
    return np.logical_not(np.any(no_worse & better, axis=1))


def _draw_front(ax: Axes, found: xarray.Dataset) -> None:
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
    ax.axvline(BUDGET_KB, color="black", lw=0.8, ls=":")
    ax.text(BUDGET_KB, ax.get_ylim()[1], "budget ", ha="right", va="top", fontsize=6.5)
    ax.set(xlabel="payload per route (KB)", ylabel="mean route error (m)")
    ax.legend(loc="center left")
    fig.title(ax, "c", "Pareto front of the whole grid")


def _draw_shares(ax: Axes, found: xarray.Dataset) -> None:
    """Stacked bars: the axes alone, seeds, interactions, the rest."""
    single = ["beta", "gamma", "k", "V", "scheduler", "seed"]
    parts = {name: variance_shares(found[name]) for name in SHARES}
    left = np.zeros(len(SHARES))
    colours = dict(zip(single, (fig.BLUE, fig.SKY, fig.ORANGE, fig.GREEN, fig.PURPLE, fig.GREY), strict=True))
    labels = {
        **{name: GREEK.get(name, name) for name in single},
        "pairs": "two-way interactions",
        "rest": "rest",
    }
    rows = list(SHARES)
    for key, label in labels.items():
        if key == "pairs":
            values = [sum(v for name, v in parts[row].items() if " x " in name) for row in rows]
        else:
            values = [parts[row].get(key, 0.0) for row in rows]
        colour = {"pairs": fig.YELLOW, "rest": REST}.get(key) or colours[key]
        ax.barh(range(len(rows)), 100 * np.array(values), left=left, height=0.62, color=colour, label=label)
        left += 100 * np.array(values)
    ax.set_yticks(range(len(rows)), [SHARES[row] for row in rows])
    ax.invert_yaxis()
    ax.set(xlabel="share of variance over the grid (%)", xlim=(0, 100))
    ax.grid(visible=False, axis="y")
    ax.legend(loc="upper center", bbox_to_anchor=(0.45, -0.22), ncols=4, columnspacing=0.9, handlelength=1.0)
    fig.title(ax, "d", "what moves what")

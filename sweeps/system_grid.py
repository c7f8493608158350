"""The whole system on a (beta, gamma, k, V, scheduler, seed) grid, in one compiled program (not in the paper)."""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray

from ovibjax.cards.control_study import PAPER_PROFILE_KB_PER_S, drives_of
from ovibjax.cards.job import Job
from ovibjax.cards.system_drawing import METRICS, draw_edge, draw_error, draw_front, draw_shares
from ovibjax.control.controller import PAPER_BUDGET_KB
from ovibjax.report import figures as fig
from ovibjax.report import panels
from ovibjax.report.claims import Claim, interval, write_claims
from ovibjax.report.rows import write_rows
from ovibjax.runtime.progress import progress_bar
from ovibjax.scheduling.rules import POLICIES
from ovibjax.system.data import SystemSize
from ovibjax.system.grids import sweep_system

TITLE = "The whole system on one grid"


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
    "quick": Preset((1e-4, 1e-2), (0.0, 0.1), (8, 16, 32, 64), VS, 4, SystemSize(), "full"),
    "full": Preset((1e-4, 1e-3, 1e-2), (0.0, 0.1, 1.0), (8, 16, 32, 64), VS, 5, SystemSize(), "full"),
}


def run(job: Job) -> None:
    """Run the card: one sweep, table, claims, figure."""
    started = time.perf_counter()
    preset = PRESETS[job.preset]
    with job.stage("render"), progress_bar("rendering the routes", 1) as update:
        drives, training = drives_of(preset.scene, job.own_drive, update)
    seeds = [job.seed + i for i in range(preset.seeds)]
    axes = {"beta": list(preset.betas), "gamma": list(preset.gammas), "seed": seeds}
    along = (preset.ks, preset.Vs, POLICIES)

    def compute(**options: Any) -> xarray.Dataset:
        return sweep_system((drives, training, preset.size), axes, along, **options)

    found = job.kept("training and replaying the system", compute)
    write_rows(job.out / "table.csv", table_rows(found))
    write_claims(job.out / "claims.json", judge_claims(found))
    with job.stage("draw"):
        panels.draw_panels(job.out / "figure.png", found, PANELS, 2, height_in=2.3)
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
    """What the grid says, with intervals over seeds; the paper has no such grid."""
    middle = found.isel(beta=found.sizes["beta"] // 2, gamma=found.sizes["gamma"] // 2)
    shaped = middle.top_cost.isel(V=0)
    gain = (shaped.sel(scheduler="fifo") - shaped.sel(scheduler="voi_lyapunov")).transpose("k", "seed")
    gains = ", ".join(f"{interval(of_k.values).text()} at k = {int(of_k.k)}" for of_k in gain)
    free_kb = found.free_kb.max(("beta", "gamma", "k"))
    claims = [
        *(_effect(found, axis, "mean_route_m", "m") for axis in ("beta", "gamma", "k")),
        *(_effect(found, axis, "top_edge_p95_ms", "ms") for axis in ("beta", "k")),
        Claim.above_zero(
            "VOI-Lyapunov has a lower weighted cost than FIFO for the top decile at every prefix, in the whole system",
            "lower",
            f"lower by {gains}",
            *gain.values,
            rule="whole interval of the paired difference above zero at every prefix",
        ),
        Claim.at_most(
            f"Prices alone keep the budget of {PAPER_BUDGET_KB} KB on every route, at every point of the grid",
            "2.1 KB",
            f"at most {interval(free_kb.values).text('KB')} without the cap, at most {float(found.kb.max()):.3f} KB "
            "on average under it",
            PAPER_BUDGET_KB,
            free_kb.values,
            rule="interval over seeds of the largest payload of any route and point, with no cap to hold it back",
        ),
    ]
    return [claim.as_own() for claim in claims]


def _effect(found: xarray.Dataset, axis: str, metric: str, unit: str) -> Claim:
    values = found[metric].mean([dim for dim in found[metric].dims if dim not in (axis, "seed")])
    low, high = (found[axis].values[i] for i in (0, -1))
    change = interval(values.sel({axis: high}).values - values.sel({axis: low}).values)
    return Claim.reported(
        f"How far {axis} from {low:g} to {high:g} moves {METRICS[metric]}, over the rest of the grid",
        *("-", change.text(unit), "paired difference over seeds"),
    )


def caption(found: xarray.Dataset, preset: Preset, points: int) -> str:
    """What the reader of the figure needs to know."""
    size = preset.size
    return (
        f"{points} points x {len(POLICIES)} rules, one program: an encoder per (β, γ, seed), retrieval, g_ψ and "
        f"request control per k, the queue per V and rule. {size.clients} clients on held-out routes, each leading a "
        f"fleet of {size.fleet} that asks when it does, with requests of all of them, at {size.kb_per_s:g} KB/s (the "
        f"paper's high congestion; its request control is at {PAPER_PROFILE_KB_PER_S:g} KB/s); corrections "
        "are fused by their calibrated risk. (a) Route error and (b) top-decile edge p95 "
        "against k. (c) Every point, the lowest edge p95 on top; outlined: no other is better in KB, route error and "
        "edge p95 together. (d) Variance shares by axis, two-way interactions and the rest. "
        f"{fig.spread(found.sizes['seed'])}. V moves Base-DPP only."
    )


PANELS = {
    "route error at one payload budget": draw_error,
    "edge latency by rule": draw_edge,
    "Pareto front of the whole grid": draw_front,
    "what moves what": draw_shares,
}

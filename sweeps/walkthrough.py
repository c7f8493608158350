"""Walkthrough: build a town, define a grid, get a labelled dataset, plot it; every step in plain Python.

Read `run` from top to bottom; each step stands alone and works in a notebook. `ovibjax reproduce --only walkthrough`
executes it and draws what it finds.
"""

import time
from pathlib import Path

import numpy as np
import xarray

from ovibjax.cards.control_study import drives_of
from ovibjax.cards.job import Job
from ovibjax.cards.scheduling_drawing import COLOURS, NAMES
from ovibjax.features.frames import CONTEXTS, FeatureSet
from ovibjax.report import figures as fig
from ovibjax.report import panels
from ovibjax.report.best import Choice, choose
from ovibjax.report.claims import Claim, write_claims
from ovibjax.report.rows import write_rows
from ovibjax.runtime.progress import progress_bar
from ovibjax.scheduling.rules import POLICIES
from ovibjax.system.data import SystemSize
from ovibjax.system.grids import sweep_system

TITLE = "Walkthrough: from a town to a plot, in Python"
SEEDS = {"smoke": 1, "quick": 2, "full": 3}
SIZES = {"smoke": SystemSize(20, 256, clients=1, fleet=3), "quick": SystemSize(), "full": SystemSize()}
BETAS, KS, VS = [1e-4, 1e-2], [8, 16, 32, 64], [0.0, 1.0, 4.0, 8.0, 16.0, 64.0]
CONTEXT_COLOURS = (fig.BLUE, fig.ORANGE, fig.GREEN, fig.GREY)


def run(job: Job) -> None:
    """Every step, from the town to the figure."""
    started = time.perf_counter()

    # 1. Drives: sequences of frames, half a second apart, with features, poses and contexts. The embedded town renders
    #    them once and keeps them; your own frames come as one feature set, the first 60 % for training.
    scene = "smoke" if job.preset == "smoke" else "full"
    with job.stage("render"), progress_bar("rendering the routes", 1) as update:
        drives, training = drives_of(scene, job.own_drive, update)

    # 2. A grid. Axes that training depends on; then prefixes, values of V and rules, which cost no training.
    size = SIZES[job.preset]
    seeds = [job.seed + i for i in range(SEEDS[job.preset])]
    axes = {"beta": BETAS, "gamma": [0.1], "seed": seeds}

    # 3. One compiled program, one labelled dataset: dimensions beta, gamma, seed, k, V, scheduler, units as attributes.
    grid = job.kept(
        "training and replaying",
        lambda **kept: sweep_system((drives, training, size), axes, (KS, VS, POLICIES), **kept),
    )

    # 4. Selections and means are xarray's.
    error_m = grid.mean_route_m.sel(gamma=0.1).transpose("seed", "beta", "k")
    tail_ms = grid.top_edge_p95_ms.sel(V=8.0).mean(["beta", "gamma"]).transpose("seed", "scheduler", "k")

    # 5. The best point under a budget, as `ovibjax best` finds it.
    best = choose(grid, "mean_route_m", ["kb<=2.1"])

    # 6. The same point in a grid of its own: what a member gives does not depend on the grid that it is in.
    own = {"beta": [best.point["beta"]], "gamma": [best.point["gamma"]], "seed": seeds[:1]}
    with job.stage("train"):
        alone = sweep_system((drives, training, size), own, (KS, VS, POLICIES))
    inside = float(grid.mean_route_m.sel(**best.point, seed=seeds[0]))
    gap = abs(float(alone.mean_route_m.sel(**best.point, seed=seeds[0])) / inside - 1.0)

    # 7. A table, a judged claim and a figure.
    write_rows(job.out / "table.csv", grid.mean_route_m.to_dataframe().reset_index().to_dict("records"))
    statement = "A point in a grid of its own equals the same point inside the larger grid"
    ours = f"relative difference of the route error {gap:.1e}"
    claim = Claim.true(statement, "-", ours, gap <= 1e-4, "at most 1e-4").as_own()
    write_claims(job.out / "claims.json", [claim])
    with job.stage("draw"):
        draw(job.out / "figure.png", drives, error_m, tail_ms, best)
    caption = (
        "The script `sweeps/walkthrough.py`, executed: (a) drives by context, (b) and (c) what a grid of "
        f"{grid.top_cost.size} points says. {fig.spread(len(seeds))}."
    )
    job.record(TITLE, caption, seeds, started, points=int(grid.top_cost.size), steps=size.steps)


def draw(
    path: Path, drives: list[FeatureSet], error_m: xarray.DataArray, tail_ms: xarray.DataArray, best: Choice
) -> None:
    """The three panels: drives, error by prefix with the best point, latency by prefix and rule."""
    with panels.sheet(path, 3) as (plan, errors, tails):
        for number, drive in enumerate(drives):
            for code, colour in enumerate(CONTEXT_COLOURS):
                rows = drive.context == (code if code < len(CONTEXTS) else -1)
                label = (*CONTEXTS, "unknown")[code] if number == 0 and rows.any() else None
                plan.plot(*drive.positions_m[rows, :2].T, ".", ms=1.5, color=colour, label=label)
        plan.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
        plan.legend(loc="upper center", bbox_to_anchor=(0.5, -0.22), markerscale=4, ncols=2)
        fig.title(plan, "a", f"{len(drives)} drives")

        for beta, colour in zip(BETAS, (fig.BLUE, fig.ORANGE), strict=True):
            fig.band(errors, np.array(KS), error_m.sel(beta=beta).values, colour, f"β = {beta:g}", marker="o")
        panels.star(errors, best.point["k"], best.means["mean_route_m"], f"best: k = {best.point['k']}")
        errors.set(xlabel="prefix length k (floats)", ylabel="mean route error (m)", ylim=(0, None))
        errors.legend(loc="lower right")
        fig.title(errors, "b", "error of the route")

        for rule in ("edf", "fifo", "voi_lyapunov"):
            fig.band(tails, np.array(KS), tail_ms.sel(scheduler=rule).values, COLOURS[rule], NAMES[rule], marker="o")
        tails.set(xlabel="prefix length k (floats)", ylabel="edge p95, top decile (ms)", ylim=(0, None))
        panels.headroom(tails, 1.25)
        tails.legend(loc="upper center", ncols=3, columnspacing=0.8, handlelength=1.4, handletextpad=0.3)
        fig.title(tails, "c", "latency at the edge")

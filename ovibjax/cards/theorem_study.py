"""The theorem of the slotted scheduler, simulated: readings, loads and V in one sweep, beside what is promised."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
import xarray

from ovibjax.cards.job import Job
from ovibjax.report.claims import Interval, interval
from ovibjax.scheduling.slotted_replay import Horizon, RunCases
from ovibjax.scheduling.stationary import capacity, draw_system, least_growth
from ovibjax.scheduling.theorem import Promise, Setting, empty_case, make_case, stack
from ovibjax.sweep.work import Along

CLIENTS = 6
BUSY, LIGHT = 0.9, 0.5
LOADS = (0.6, 0.8, 0.9, 0.95, 1.05, 1.1, 1.2)
LOAD_V = 8.0
WARM_UP = 0.2
READ_AT = (0.01, 0.1, 1.0)
# A gap may vanish to rounding.
_FLOOR = 1e-6
_MEANS = ("utility", "gap", "backlog")

PROOF_BUSY, PROOF_LIGHT = Setting("proof", BUSY), Setting("proof", LIGHT)
PENDING_BUSY, PENDING_LIGHT = Setting("pending", BUSY), Setting("pending", LIGHT)
SHIFTED_LIGHT = Setting("shifted", LIGHT)
SETTINGS = (PROOF_BUSY, PROOF_LIGHT, PENDING_BUSY, PENDING_LIGHT, SHIFTED_LIGHT)


@dataclass(frozen=True)
class TheoremSize:
    """Size of the experiment.

    Attributes:
        seeds: random systems, each with its own arrivals.
        states: joint states of a system.
        vs: values of V.
        horizon: length of a run, in 100 blocks or a multiple.
    """

    seeds: int
    states: int
    vs: tuple[float, ...]
    horizon: Horizon


@dataclass(frozen=True)
class TheoremRuns:
    """Runs of all settings and loads.

    Attributes:
        runs: means after the warm-up, `utility`, `gap` and `backlog`, and `best`, `gap_bound`, `backlog_bound`
            [setting, V, seed].
        growth: backlog over slots, `measured` [load, slots, seed], and the least of any policy, `least` [load, seed].
        resumed: members that an earlier, interrupted run had finished.
    """

    runs: xarray.Dataset
    growth: xarray.Dataset
    resumed: int

    def at(self, setting: Setting, metric: str) -> np.ndarray:
        """[seeds, V] a metric of one setting."""
        return self.runs[metric].sel(setting=setting.name).transpose("seed", "V").values

    def slope(self, setting: Setting, metric: str) -> Interval:
        """Exponent of V, fitted to the curve of each seed."""
        x = np.log(self.runs.V.values)
        return interval([np.polyfit(x, np.log(np.maximum(curve, _FLOOR)), 1)[0] for curve in self.at(setting, metric)])

    def used(self, setting: Setting, metric: str) -> np.ndarray:
        """[V, seeds] a metric as a share of its bound."""
        return (self.at(setting, metric) / self.at(setting, f"{metric}_bound")).T


def measure(job: Job, size: TheoremSize, seeds: Sequence[int]) -> TheoremRuns:
    """Benchmarks of all systems, and one sweep over settings and V, and over loads at one V.

    Args:
        job: what the card was given.
        size: length of the runs and values of V.
        seeds: a random system each.

    Returns:
        Runs beside what the theorem promises of them.
    """
    vs = np.array(size.vs)
    systems = [draw_system(jax.random.fold_in(jax.random.key(seed), 1), size.states, CLIENTS) for seed in seeds]
    edges = [capacity(system, np.ones(CLIENTS)) * np.ones(CLIENTS) for system in systems]
    made = [[make_case(*system, setting, vs) for setting in SETTINGS] for system in zip(systems, edges, strict=True)]
    cases = [
        stack([*(case for case, _ in row), *(empty_case(load * edge) for load in LOADS)])
        for row, edge in zip(made, edges, strict=True)
    ]
    points = [(setting.name, v) for setting in SETTINGS for v in size.vs]
    points += [(f"load_{load:g}", LOAD_V) for load in LOADS]
    runs = _sweep(job, size.horizon, points, seeds, list(zip(systems, cases, strict=True)))
    over_v, loads = (runs.isel(point=part) for part in (slice(-len(LOADS)), slice(-len(LOADS), None)))
    least = [[least_growth(system, load * edge) for load in LOADS] for system, edge in zip(systems, edges, strict=True)]
    promises = [[promise for _, promise in row] for row in made]
    return TheoremRuns(_over_v(over_v, promises, size), _growth(loads, least), int(runs.attrs["resumed"]))


def _sweep(
    job: Job, horizon: Horizon, points: list[tuple[str, float]], seeds: Sequence[int], data: list[Any]
) -> xarray.Dataset:
    """Block means [point, seed, slot]."""
    names, vs = zip(*points, strict=True)
    number = {name: i for i, name in enumerate(dict.fromkeys(names))}
    dataset = job.sweep(
        "slotted scheduler",
        RunCases(horizon),
        {"case": [number[name] for name in names], "V": vs, "seed": seeds},
        Along("seed", data),
        zipped=[["case", "V"]],
        dims=dict.fromkeys((*_MEANS, "left"), ("slot",)),
        coords={"slot": horizon.slots * np.arange(1, horizon.blocks + 1)},
        units={"utility": "m", "gap": "m"},
        stage="replay",
        # All points of a seed side by side: they share its random numbers, and a lane is small.
        lanes=len(points),
    )
    return dataset.rename_dims({"case_V": "point"})


def _over_v(runs: xarray.Dataset, promises: list[list[Promise]], size: TheoremSize) -> xarray.Dataset:
    """Means after the warm-up, and what is promised of them, [setting, V, seed]."""
    settled = runs.isel(slot=slice(int(WARM_UP * size.horizon.blocks), None))
    shape = (len(SETTINGS), len(size.vs), runs.sizes["seed"])
    values = {name: settled[name].values.astype(np.float64).mean(-1).reshape(shape) for name in _MEANS}
    for name in ("best", "gap_bound", "backlog_bound"):
        promised = np.array([[getattr(promise, name) for promise in row] for row in promises])
        values[name] = promised.transpose(1, 2, 0)
    dims = ("setting", "V", "seed")
    coords = {"setting": [setting.name for setting in SETTINGS], "V": np.array(size.vs), "seed": runs.seed.values}
    return xarray.Dataset({name: (dims, part) for name, part in values.items()}, coords)


def _growth(runs: xarray.Dataset, least: list[list[float]]) -> xarray.Dataset:
    """Backlog over slots, `measured` [load, slots, seed], and `least` [load, seed]."""
    read = [round(share * runs.sizes["slot"]) - 1 for share in READ_AT]
    left = runs.left.isel(slot=read).transpose("point", "slot", "seed")
    slots = left.slot.values
    measured = left.values.astype(np.float64) / slots[:, None]
    return xarray.Dataset(
        {"measured": (("load", "slots", "seed"), measured), "least": (("load", "seed"), np.array(least).T)},
        {"load": list(LOADS), "slots": slots, "seed": runs.seed.values},
    )

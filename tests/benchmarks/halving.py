"""Halving against the whole grid: the point that is found, and the member-steps and seconds that it takes.

    python -m tests.benchmarks.halving            (a quiet machine; some 20 minutes on two cores)
    python -m tests.benchmarks.halving --steps 200

64 points (four weights of the rate term and of the orthogonality penalty, four learning rates) of the encoder on the
embedded town, three seeds each, judged at four prefixes. The whole grid is trained to the end; a halving by three
chooses by the mean validation error over prefixes and seeds, and knows nothing of the grid. All figures of points are
those of the whole grid, which has them for all: members that the halving trained to the end are compared with it bit
for bit.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jax
import numpy as np
import xarray

from ovibjax.edge.member import DIMS, SCORE, UNITS, TrainAndJudge
from ovibjax.encoder.model import Architecture
from ovibjax.encoder.train import TrainConfig
from ovibjax.encoder.training_data import member_data
from ovibjax.report.claims import interval
from ovibjax.runtime.progress import progress_bar
from ovibjax.sweep.engine import run
from ovibjax.sweep.halving import halve
from ovibjax.sweep.work import Along
from ovibjax.world.town.feature_set import town_features

POINTS = {"beta": [1e-4, 1e-3, 1e-2, 1e-1], "gamma": [0.0, 0.01, 0.1, 1.0], "lr": [1e-3, 2e-3, 4e-3, 8e-3]}
PREFIXES = (8, 16, 35, 128)


def timed(said: str, work: Any) -> tuple[xarray.Dataset, float]:
    """Results with their wall-clock seconds; programs are compiled before."""
    with progress_bar(said, 1) as update:
        start = time.perf_counter()
        return work(update), time.perf_counter() - start


def by_seed(whole: xarray.Dataset, point: dict[str, float], name: str) -> np.ndarray:
    """[seeds] an output at a point of the whole grid, its mean over prefixes and modes."""
    values = whole[name].sel(point)
    return values.mean([dim for dim in values.dims if dim != "seed"]).values.astype(np.float64)


def differences(halved: xarray.Dataset, whole: xarray.Dataset) -> int:
    """Outputs of members trained to the end that have other bits than in the whole grid."""
    (dim,), count = halved.steps.dims, 0
    for i in np.flatnonzero(halved.steps.values == halved.steps.values.max()):
        point = {name: halved[name].values[i] for name in POINTS}
        for name in whole.data_vars:
            count += halved[name].isel({dim: i}).values.tobytes() != whole[name].sel(point).values.tobytes()
    return count


def report(halved: xarray.Dataset, whole: xarray.Dataset) -> None:
    """What each of them finds."""
    over = [dim for dim in whole[SCORE].dims if dim not in POINTS]
    mean = whole[SCORE].mean(over).where(~whole.diverged.any("seed"))
    best = lowest(mean)
    end = halved.isel({halved.steps.dims[0]: np.flatnonzero(halved.steps.values == halved.steps.values.max())})
    scores = end[SCORE].mean([dim for dim in end[SCORE].dims if dim != end.steps.dims[0]]).values
    found = {name: float(end[name].values[int(np.argmin(scores))]) for name in POINTS}
    rank = int((mean.values < float(mean.sel(found))).sum()) + 1
    for said, point in (("whole grid", best), ("halving", found)):
        named = ", ".join(f"{name} {value:g}" for name, value in point.items())
        values = [interval(by_seed(whole, point, name)).text(digits=3) for name in (SCORE, "test_mean_m")]
        print(f"{said}: {named}; validation {values[0]} m, test {values[1]} m")
    first, other = by_seed(whole, best, SCORE), by_seed(whole, found, SCORE)
    print(f"the point of the halving has rank {rank} of {mean.size} in the whole grid")
    span, gap = interval(first), interval(other - first)
    within = "is" if span.low <= other.mean() <= span.high else "is NOT"
    print(f"its validation error {within} within the interval of the best's")
    print(f"paired difference to the best: {gap.text(digits=3)} m")


def lowest(mean: xarray.DataArray) -> dict[str, float]:
    """The point with the lowest value."""
    at = np.unravel_index(int(np.nanargmin(mean.values)), mean.shape)
    return {str(dim): float(mean[dim].values[i]) for dim, i in zip(mean.dims, at, strict=True)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, help="training steps; by default those of the recipe")
    parser.add_argument("--seeds", type=int, default=3)
    given = parser.parse_args()
    town, seeds = town_features(), list(range(given.seeds))
    members = [member_data(town, seed)[0] for seed in seeds]
    n, n_views, view_dim = members[0].train.x.shape
    static = TrainConfig(arch=Architecture(n_views=n_views, view_dim=view_dim), steps=given.steps)
    fn = TrainAndJudge(static, PREFIXES, ("A5",)).staged(n)
    axes, data = {**POINTS, "seed": seeds}, Along("seed", members)
    labels = {"dims": DIMS, "units": UNITS, "coords": {"prefix": list(PREFIXES), "mode": ["A5"]}}
    run(fn, {name: values[:1] for name, values in POINTS.items()} | {"seed": [0]}, Along("seed", members[:1]))
    with tempfile.TemporaryDirectory() as folder:
        halved, halved_s = timed(
            "halving",
            lambda update: halve(
                fn, axes, data, score=SCORE, store=Path(folder) / "h.zarr", on_progress=update, **labels
            ),
        )
        whole, whole_s = timed(
            "whole grid",
            lambda update: run(fn, axes, data, store=Path(folder) / "w.zarr", on_progress=update, **labels),
        )
    rungs = ", ".join(f"{rung['points']} to {rung['steps']}" for rung in halved.attrs["rungs"])
    print(f"{len(seeds)} seeds, {fn.steps} steps ({fn.every} an epoch), {jax.devices()[0].platform}; points: {rungs}")
    report(halved, whole)
    print(f"members trained to the end with other bits than in the whole grid: {differences(halved, whole)} outputs")
    print(f"member-steps: {halved.attrs['spent']:.1%} of the whole grid's")
    print(f"seconds: {halved_s:.0f} against {whole_s:.0f}, {whole_s / halved_s:.2f} times as fast")
    print(f"ratio: {1 / halved.attrs['spent']:.2f}")


if __name__ == "__main__":
    main()

"""`sweep run` on `examples/digits.py`: fits per second beside scikit-learn's grid search and a plain jitted loop.

    python -m tests.benchmarks.own_function            (extra [bench]; a quiet machine; some minutes on two cores)

The search is one of penalties, rates and seeds. Both sides fit the same model (no intercept) to the same number of
images as often, each fit with a split of its own by seed, and score it on its training and on its other images.

- `sweep run`: the command, from the start of its process to its end, its store on disk; in a new cache folder, once
  more with the compiled program kept from before, and with members four by four (that program kept as well).
- engine: `sweep.run` in this process, in memory, compiled before.
- plain loop: `jax.jit` of the member function, called point after point, compiled before.
- GridSearchCV: `LogisticRegression`, one process per core, started for it. It has no rate, so that its grid has so many
  more penalties. It stops where it has converged (`tol` 1e-4, the default) or after as many iterations as our steps;
  with `tol` 0 it goes on as long as its line search finds anything lower.

2 virtual cores (AMD EPYC with AVX-512), quiet, Python 3.11, jax 0.10.2, scikit-learn 1.9.1, 1,024 fits:

    sweep run, nothing compiled yet      60.8 fits/s     16.8 s  best accuracy 0.9628
    sweep run                            63.1 fits/s     16.2 s  best accuracy 0.9628
    sweep run, 4 lanes                   97.6 fits/s     10.5 s  best accuracy 0.9628
    engine                               97.4 fits/s     10.5 s  best accuracy 0.9628
    plain loop                           54.8 fits/s     18.7 s  best accuracy 0.9628
    GridSearchCV, tol 0.0001            106.8 fits/s      9.6 s  best accuracy 0.9700, 38 iterations
    GridSearchCV, tol 0                  48.4 fits/s     21.2 s  best accuracy 0.9700, 112 iterations
    against a plain loop: 1.15, the engine alone 1.78
    against GridSearchCV with tol 0: 1.30; with 4 lanes 2.02
    ratio with 4 lanes: 0.91
    ratio: 0.59

The peer of the last lines stops after 38 of its iterations, where ours takes 200 steps. In processor time a fit takes
18 ms, and vmapping four halves that; by itself the engine takes one at a time here, as it counts what a member keeps
alive at more than a core's cache. At the largest rates gradient descent does not settle, and members whose last bits
differ, in the loop and in the command, end up to 0.4 apart in accuracy.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jax
import numpy as np
import sklearn
from joblib.externals.loky import get_reusable_executor
from sklearn.datasets import load_digits
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import GridSearchCV, ShuffleSplit

from ovibjax.sweep.engine import run
from ovibjax.sweep.from_file import data_of, member_of, read_sweep_file
from ovibjax.sweep.grid import Axis
from ovibjax.sweep.store import open_dataset

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "digits.py"


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """A result, and its wall-clock seconds."""
    start = time.perf_counter()
    result = work()
    return result, time.perf_counter() - start


def command(axes: dict[str, list[Any]], out: Path, cache: Path, *more: str) -> None:
    """The command, in a process of its own."""
    typed = [f"{name}={','.join(map(repr, values))}" for name, values in axes.items()]
    words = [sys.executable, "-m", "ovibjax", "sweep", "run", EXAMPLE, "--axis", *typed, "--out", out, *more]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("JAX_COMPILATION")}
    environment["PYTHONPATH"] = os.pathsep.join([str(ROOT), *filter(None, [environment.get("PYTHONPATH")])])
    environment["OVIBJAX_CACHE"] = str(cache)
    subprocess.run(list(map(str, words)), check=True, env=environment, capture_output=True)


def plain_loop(axes: dict[str, list[Any]]) -> tuple[np.ndarray, float]:
    """Test accuracies as one computes them without a tool, and seconds; compiled before."""
    file = read_sweep_file(EXAMPLE)
    data = jax.device_put(data_of(file, file.axes))
    fit = jax.jit(file.member)
    points = list(product(*axes.values()))

    def one(values: tuple[Any, ...]) -> dict[str, np.ndarray]:
        point = {name: np.float32(value) for name, value in zip(axes, values, strict=True)}
        point["seed"] = np.int32(values[-1])
        return jax.device_get(fit(jax.random.key(point["seed"]), point, data))

    one(points[0])
    results, seconds = timed(lambda: [one(point) for point in points])
    return np.array([result["test_accuracy"] for result in results]), seconds


def grid_search(penalties: np.ndarray, seeds: int, tol: float) -> tuple[GridSearchCV, float, float]:
    """The search of scikit-learn, its seconds, and the mean number of iterations of a fit."""
    file = read_sweep_file(EXAMPLE)
    steps, tested = file.options["settings"]["steps"], file.options["settings"]["tested"]
    pixels, digits = load_digits(return_X_y=True)
    x = pixels / 16
    # Ours is the mean over images, theirs the sum, times C.
    costs = 1 / (penalties * (len(x) - tested))
    model = LogisticRegression(fit_intercept=False, max_iter=steps, tol=tol)
    splits = ShuffleSplit(n_splits=seeds, test_size=tested, random_state=0)
    search = GridSearchCV(model, {"C": costs}, cv=splits, n_jobs=os.cpu_count(), refit=False, return_train_score=True)
    get_reusable_executor().shutdown(wait=True)  # its processes start within the time, as ours does
    train = next(iter(splits.split(x)))[0]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        _, seconds = timed(lambda: search.fit(x, digits))
        fits = [LogisticRegression(**{**model.get_params(), "C": c}).fit(x[train], digits[train]) for c in costs[::8]]
    return search, seconds, float(np.mean([fit.n_iter_.max() for fit in fits]))


def main() -> None:
    """Time all of them in one run and print the ratio."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--penalties", type=int, default=32, help="values of l2 (default 32)")
    parser.add_argument("--rates", type=int, default=4, help="learning rates (default 4)")
    parser.add_argument("--seeds", type=int, default=8, help="splits (default 8)")
    options = parser.parse_args()
    penalties = np.logspace(-5, 0, options.penalties)
    axes = {
        "l2": penalties.tolist(),
        "rate": np.linspace(0.75, 3.0, options.rates).tolist(),
        "seed": list(range(options.seeds)),
    }
    count = options.penalties * options.rates * options.seeds
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    device = jax.devices()[0].device_kind
    print(f"{device}, {os.cpu_count()} cores, load {load:.1f}, jax {jax.__version__}, ", end="")
    print(f"scikit-learn {sklearn.__version__}; {count} fits")

    def row(name: str, seconds: float, accuracy: float, note: str = "") -> float:
        speed = f"{count / seconds:8.1f} fits/s  {seconds:7.1f} s"
        print(f"{name:32s} {speed}  best accuracy {accuracy:.4f}{note}", flush=True)
        return count / seconds

    rates, accuracies = {}, {}
    with tempfile.TemporaryDirectory() as folder:
        by_four = ("--lanes", "4")
        command({**axes, "seed": [0]}, Path(folder) / "first.zarr", Path(folder) / "cache", *by_four)
        for name, more in (("sweep run, nothing compiled yet", ()), ("sweep run", ()), ("sweep run, 4 lanes", by_four)):
            out = Path(folder) / f"{len(rates)}.zarr"
            _, seconds = timed(lambda out=out, more=more: command(axes, out, Path(folder) / "cache", *more))
            accuracies[name] = open_dataset(out).test_accuracy
            rates[name] = row(name, seconds, float(accuracies[name].mean("seed").max()))
    file = read_sweep_file(EXAMPLE)
    grid = {name: Axis(tuple(values)) for name, values in axes.items()}
    data = data_of(file, grid)
    run(member_of(file), grid, data, **file.options)
    dataset, seconds = timed(lambda: run(member_of(file), grid, data, **file.options))
    rates["engine"] = row("engine", seconds, float(dataset.test_accuracy.mean("seed").max()))
    found, seconds = plain_loop(axes)
    theirs = accuracies["sweep run"].copy(data=found.reshape(accuracies["sweep run"].shape))
    rates["loop"] = row("plain loop", seconds, float(theirs.mean("seed").max()))
    apart = float(np.abs(theirs - accuracies["sweep run"]).max())
    print(f"  largest difference of an accuracy between the loop and `sweep run`: {apart:.1e}")
    many = np.logspace(-5, 0, options.penalties * options.rates)
    for tol in (1e-4, 0.0):
        search, seconds, iterations = grid_search(many, options.seeds, tol)
        best = float(search.cv_results_["mean_test_score"].max())
        rates[tol] = row(f"GridSearchCV, tol {tol:g}", seconds, best, f", {iterations:.0f} iterations")
    print(f"{file.options['settings']['steps']} steps of ours a fit")
    print(f"against a plain loop: {rates['sweep run'] / rates['loop']:.2f}", end="")
    print(f", the engine alone {rates['engine'] / rates['loop']:.2f}")
    print(f"against GridSearchCV with tol 0: {rates['sweep run'] / rates[0.0]:.2f}", end="")
    print(f"; with 4 lanes {rates['sweep run, 4 lanes'] / rates[0.0]:.2f}")
    print(f"ratio with 4 lanes: {rates['sweep run, 4 lanes'] / rates[1e-4]:.2f}")
    print(f"ratio: {rates['sweep run'] / rates[1e-4]:.2f}")


if __name__ == "__main__":
    main()

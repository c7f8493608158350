"""Results of a sweep with unfinished and diverged members, as the tables, files and drawings are tested on."""

import numpy as np
import xarray as xr

GRID = ("beta", "gamma", "seed")
BETA, GAMMA, PREFIX = np.float32([1e-3, 1e-2, 1e-1]), np.float32([0.0, 0.01, 0.1, 1.0]), [5, 35]


def made_results() -> xr.Dataset:
    """At (0.1, 0) one member is unfinished and one diverged; at (0.1, 1) all diverged."""
    rng = np.random.default_rng(0)
    shape = (3, 4, 5)
    finished, diverged = np.ones(shape, bool), np.zeros(shape, bool)
    finished[2, 0, 0], diverged[2, 0, 1], diverged[2, 3] = False, True, True
    mean_m = rng.uniform(1.0, 2.0, (*shape, 2))
    mean_m[1, 2, :, 1] = 0.5 + 0.01 * np.arange(5)
    mean_m[diverged] = 1e-9
    latency, loss = rng.uniform(20.0, 30.0, shape), rng.uniform(0.1, 1.0, (*shape, 6)).astype(np.float32)
    for values in (mean_m, latency, loss):
        values[~finished] = np.nan
    return xr.Dataset(
        {
            "mean_m": ((*GRID, "prefix"), mean_m, {"units": "m"}),
            "latency": (GRID, latency, {"units": "ms"}),
            "loss": ((*GRID, "epoch"), loss),
            "params.a.kernel": ((*GRID, "d0", "d1"), np.zeros((*shape, 2, 2))),
            "params.a.bias": ((*GRID, "d0"), np.zeros((*shape, 2))),
            "bits": ("prefix", np.array([160, 1120])),
            "finished": (GRID, finished),
            "diverged": (GRID, diverged),
        },
        coords={
            "beta": ("beta", BETA, {"units": "1/bit"}),
            "gamma": GAMMA,
            "seed": range(5),
            "prefix": PREFIX,
            "epoch": np.arange(1, 7),
        },
    )


def zipped(results: xr.Dataset) -> xr.Dataset:
    """Gamma chosen per beta, along one dimension."""
    data = results.isel(gamma=0, drop=True).rename_dims(beta="beta_gamma").reset_index("beta")
    return data.assign_coords(gamma=("beta_gamma", GAMMA[1:]))

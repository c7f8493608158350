"""Means with intervals over one axis or several, against loops; what is said of members that are missing."""

import numpy as np
import pytest
import xarray as xr

from ovibjax.report.claims import interval
from ovibjax.report.means import average, counted, notes_on, over_text, prepare
from tests.report.cases import made_results, zipped


@pytest.fixture
def results() -> xr.Dataset:
    return made_results()


def counts(results: xr.Dataset, place: tuple[int, ...]) -> bool:
    return bool(results["finished"].values[place] and not results["diverged"].values[place])


def close(found: tuple[float, float], numbers: list[float]) -> None:
    """As the interval of these numbers, or nothing where there are none or one is not finite."""
    span = interval(numbers if np.isfinite(numbers).all() else [])
    wanted = (span.mean, span.half if np.isfinite(span.mean) else np.nan)
    np.testing.assert_allclose(found, wanted, rtol=1e-9)


def test_one_axis_against_a_loop(results) -> None:
    results["latency"][0, 1, 2] = np.inf  # counts, and spoils its mean
    results["finished"][1, 1, 1:] = False  # one member left
    data, along = prepare(results, ["latency", "mean_m"], "seed")
    mean, half = (part.values for part in average(data, data["latency"], along))
    by_prefix = [part.transpose("beta", "gamma", "prefix").values for part in average(data, data["mean_m"], along)]
    for b, g in np.ndindex(3, 4):
        seeds = [s for s in range(5) if counts(results, (b, g, s))]
        close((mean[b, g], half[b, g]), [float(results["latency"][b, g, s]) for s in seeds])
        for k in range(2):
            numbers = [float(results["mean_m"][b, g, s, k]) for s in seeds]
            close((by_prefix[0][b, g, k], by_prefix[1][b, g, k]), numbers)
    assert np.isinf(half[1, 1]) and np.isnan(mean[2, 3])


def test_with_seed_among_several_axes_the_interval_is_over_seeds(results) -> None:
    for over in (["gamma", "seed"], ["seed", "gamma"]):
        data, along = prepare(results, ["latency"], over)
        mean, half = (part.values for part in average(data, data["latency"], along))
        for b in range(3):
            kept = [[g for g in range(4) if counts(results, (b, g, s))] for s in range(5)]
            per_seed = [np.mean([float(results["latency"][b, g, s]) for g in gs]) for s, gs in enumerate(kept) if gs]
            close((mean[b], half[b]), per_seed)
        assert over_text(data, along) == "5 values of seed, each a mean over gamma"
    data, along = prepare(results, ["latency"], ["beta", "gamma"])
    mean, half = (part.values for part in average(data, data["latency"], along))
    for s in range(5):
        places = [(b, g) for b, g in np.ndindex(3, 4) if counts(results, (b, g, s))]
        close((mean[s], half[s]), [float(results["latency"][(*place, s)]) for place in places])
    assert over_text(data, along) == "12 members over beta and gamma"


def test_without_an_axis_every_member_stands_by_itself(results) -> None:
    for part, over in ((results, []), (results.isel(seed=1), "seed"), (results.isel(seed=1, drop=True), "seed")):
        data, along = prepare(part, ["latency"], over)
        mean, half = average(data, data["latency"], along)
        use = part["finished"] & ~part["diverged"]
        np.testing.assert_array_equal(mean.values, part["latency"].where(use).values)
        assert not np.isfinite(half).any()


def test_what_is_missing_is_counted(results) -> None:
    data, along = prepare(results, ["latency"], "seed")
    assert notes_on(data, along, [0, 8]) == ["", "3 of 5 seeds: 1 diverged, 1 unfinished"]
    assert notes_on(data, along, [11]) == ["0 of 5 seeds: 5 diverged"]
    assert counted(data, ["gamma", "beta"], along)[:, 2].tolist() == [3, 5, 5, 0]
    data, along = prepare(results, ["latency"], ["gamma", "seed"])
    assert notes_on(data, along, [2]) == ["13 of 20 members: 6 diverged, 1 unfinished"]
    data, along = prepare(results, ["latency"], "beta")
    assert notes_on(data, along, [0]) == ["2 of 3 values of beta: 1 unfinished"]
    data, along = prepare(zipped(results), ["latency"], ())
    assert notes_on(data, along, [9, 10, 11]) == ["", "unfinished", "diverged"]

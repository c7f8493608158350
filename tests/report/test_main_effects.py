"""Main effects and interactions, against closed forms and a plain loop."""

import numpy as np
import pytest
import xarray as xr

from ovibjax.errors import InputError
from ovibjax.report.claims import interval
from ovibjax.report.main_effects import effects
from tests.report.cases import made_results, zipped


def results(values, **axes):
    """Complete results with `seed` as the last axis."""
    dims = list(axes)
    flags = {name: (dims, np.full(values.shape, name == "finished")) for name in ("finished", "diverged")}
    return xr.Dataset({"y": (dims, values), **flags}, coords=axes)


def test_a_sum_has_no_interaction_and_a_product_of_centred_values_nothing_else():
    a, b, seed = np.array([-1.0, 1.0]), np.array([-2.0, 0.0, 2.0]), np.zeros(2)
    axes = {"a": a, "b": b, "seed": [0, 1]}
    added = effects(results(a[:, None, None] + b[:, None] + seed, **axes), "y")
    assert added.interactions()["a x b"] == pytest.approx(0, abs=1e-12)
    assert added.main() == pytest.approx({"b": 8 / 11, "a": 3 / 11}) and list(added.main()) == ["b", "a"]
    times = effects(results(a[:, None, None] * b[:, None] + seed, **axes), "y")
    assert times.interactions()["a x b"] == pytest.approx(1) and times.shares["rest"] == 0


def test_levels_are_means_over_the_rest_with_intervals_over_seeds():
    values = np.random.default_rng(0).normal(size=(2, 3, 4))
    found = effects(results(values, a=[0.0, 1.0], b=[0.0, 1.0, 2.0], seed=range(4)), "y")
    for level, (text, span) in enumerate(found.levels["a"]):
        expected = interval(values[level].mean(axis=0))
        assert text == str(level) and found.complete
        np.testing.assert_allclose([span.mean, span.half], [expected.mean, expected.half])


def test_members_that_do_not_count_are_in_no_mean():
    data = made_results()
    found = effects(data, "latency")
    counts = (data.finished & ~data.diverged).values
    expected = interval(
        [np.mean(row[use]) for row, use in zip(*(_by_seed(part) for part in (data, counts)), strict=True)]
    )
    assert not found.complete and found.shares == {}
    np.testing.assert_allclose([found.levels["beta"][2][1].mean], [expected.mean])


def _by_seed(part):
    values = part.latency.values if isinstance(part, xr.Dataset) else part
    return np.moveaxis(values[2], 1, 0)


def test_trailing_axes_count_and_long_ones_are_not_listed():
    data = made_results().isel(beta=[0, 1])
    found = effects(data, "mean_m")
    assert set(found.levels) == {"beta", "gamma", "prefix"} and "gamma x prefix" in found.shares
    long = xr.concat([data.loss] * 5, "epoch").assign_coords(epoch=range(30))
    assert set(effects(data.drop_dims("epoch").assign(loss=long), "loss").levels) == {"beta", "gamma"}


def test_zipped_axes_are_one_and_without_seeds_there_is_no_interval():
    assert list(effects(zipped(made_results()), "latency").levels) == ["beta / gamma"]
    spans = effects(made_results().isel(seed=0, drop=True), "latency").levels["gamma"]
    assert all(np.isinf(span.half) for _, span in spans)


def test_points_that_were_drawn_have_rank_correlations():
    n = 20
    a, b = np.linspace(0, 1, n) ** 3, np.random.default_rng(1).permutation(n) / n
    flags = {name: (("point", "seed"), np.full((n, 2), name == "finished")) for name in ("finished", "diverged")}
    y = np.exp(3 * a)[:, None] + np.array([0.0, 1.0])
    coords = {"a": ("point", a), "b": ("point", b), "kind": ("point", ["x"] * n), "seed": [0, 1]}
    found = effects(xr.Dataset({"y": (("point", "seed"), y), **flags}, coords=coords), "y")
    assert found.ranks["a"] == pytest.approx(1) and list(found.ranks) == ["a", "b"] and abs(found.ranks["b"]) < 0.5
    assert effects(made_results(), "latency").ranks == {}


def test_an_unknown_metric_is_refused():
    with pytest.raises(InputError, match="latency"):
        effects(made_results(), "latencies")

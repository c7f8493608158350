"""The benchmark's linear programs: closed forms, and strong duality with a brute-force dual."""

import jax
import numpy as np
import pytest

from ovibjax.scheduling.stationary import (
    SlottedSystem,
    best_stationary,
    capacity,
    draw_system,
    drift_constant,
    least_growth,
)
from tests.oracles import slotted as oracle


def one_client():
    """A request worth 1 or 10 metres, which always fits."""
    ones = np.ones((2, 1), np.int32)
    return SlottedSystem(ones, ones, np.array([[1.0], [10.0]], np.float32), np.int32(1), np.int32(1))


def one_server(n):
    """One of n clients per slot, each worth 1 metre."""
    ones = np.ones((1, n), np.int32)
    return SlottedSystem(ones, ones, np.ones((1, n), np.float32), np.int32(1), np.int32(n))


def test_one_client_in_closed_form():
    system = one_client()
    least = best_stationary(system, [0.1], exactly=False)
    assert least.utility == pytest.approx(5.5) and least.price == pytest.approx([0.0], abs=1e-9)
    # Exactly one request in ten slots: only slots worth 10, and one request more is worth 10 more.
    exact = best_stationary(system, [0.1], exactly=True)
    assert exact.utility == pytest.approx(1.0) and exact.price == pytest.approx([-10.0])
    assert best_stationary(system, [0.75], exactly=True).utility == pytest.approx(5.25)
    assert capacity(system, [0.5]) == pytest.approx(2.0)
    assert drift_constant(system, [0.1]) == pytest.approx(0.5 * 1.1)
    with pytest.raises(ValueError, match="no policy serves arrivals"):
        best_stationary(system, [1.01], exactly=False)


def test_the_edge_of_a_shared_server():
    system = one_server(3)
    assert capacity(system, [1.0, 1.0, 2.0]) == pytest.approx(0.25)
    assert least_growth(system, [0.2, 0.3, 0.5]) == pytest.approx(0.0, abs=1e-9)
    assert least_growth(system, [0.2, 0.6, 0.5]) == pytest.approx(0.3)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("exactly", [False, True])
def test_utility_equals_the_dual_at_its_prices(seed, exactly):
    system = draw_system(jax.random.key(seed), states=16, clients=4)
    edge = capacity(system, np.ones(4))
    rng = np.random.default_rng(seed)
    for load in (0.4, 0.95):
        rate = np.full(4, load * edge)
        found = best_stationary(system, rate, exactly)
        assert oracle.dual_value(found.price, rate, system) == pytest.approx(found.utility, rel=1e-6)
        assert exactly or found.price.min() >= -1e-9
        for _ in range(5):  # every other price bounds the utility from above
            other = rng.uniform(-3.0, 3.0, 4) if exactly else rng.uniform(0.0, 3.0, 4)
            assert oracle.dual_value(other, rate, system) >= found.utility - 1e-6
    with pytest.raises(ValueError, match="no policy"):
        best_stationary(system, np.full(4, 1.001 * edge), exactly)


def test_serving_exactly_is_worth_at_most_as_much_as_serving_at_least():
    system = draw_system(jax.random.key(2), states=32, clients=5)
    edge = capacity(system, np.ones(5))
    for load in (0.3, 0.9):
        exact, least = (best_stationary(system, np.full(5, load * edge), kind).utility for kind in (True, False))
        assert exact <= least + 1e-9
    assert drift_constant(system, np.full(5, 0.2)) >= 0.5 * (1.0 + edge * 5)


def test_drawn_systems_are_bounded_and_follow_their_key():
    system = draw_system(jax.random.key(0), states=500, clients=6)
    assert set(np.unique(system.payload)) == {4 * k + 20 + 4 * n for k in (16, 32) for n in (1, 3, 4, 5)}
    assert system.voi.min() > 0 and system.voi.max() < 8.4
    assert system.service.min() > 16_300 and system.service.max() <= 42_300
    assert system.payload.dtype == system.service.dtype == np.int32 and system.voi.dtype == np.float32
    richer = system.payload > np.median(system.payload)
    assert system.voi[richer].mean() > 1.5 * system.voi[~richer].mean()
    again, other = (draw_system(jax.random.key(seed), 500, 6) for seed in (0, 1))
    np.testing.assert_array_equal(again.voi, system.voi)
    assert not np.array_equal(other.voi, system.voi) and not np.array_equal(other.payload, system.payload)

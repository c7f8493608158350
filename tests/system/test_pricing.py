"""Prices by code: what is chosen, and that candidates are replayed as the system replays them."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray

from ovibjax.control.voi import Prices
from ovibjax.system import chain
from ovibjax.system.data import make_system
from ovibjax.system.pricing import Priced, lowest_risk_prices, random_prices
from tests.system.test_chain import SIZE, drive


def test_the_lowest_risk_within_the_budget_on_every_seed_is_chosen():
    # Two seeds, two codes, one prefix, three candidates; the first is best but too dear on the second seed.
    risk_m = np.array([[[[1.0, 5.0, 4.0]], [[1.0, 5.0, 4.0]]]] * 2)
    most_kb = np.array([[[[2.0, 1.0, 2.0]], [[9.0, 7.0, 8.0]]], [[[2.2, 1.0, 2.0]], [[9.0, 7.0, 8.0]]]])
    dims = ("seed", "code", "k", "candidate")
    searched = xarray.Dataset({"risk_m": (dims, risk_m), "most_kb": (dims, most_kb)})
    tried = Prices(np.array([1.0, 2.0, 3.0]), np.zeros(3), np.array([10.0, 20.0, 30.0]))
    prices = lowest_risk_prices(searched, tried, budget_kb=2.1)
    assert prices.bandwidth_m_per_s.tolist() == [[3.0], [2.0]]  # the second code: none fits, the least is taken
    assert prices.delay_m_per_s.tolist() == [[30.0], [20.0]]


def test_prices_drawn_are_positive_and_their_number_changes_none():
    few, many = random_prices(3), random_prices(5)
    np.testing.assert_array_equal(few.delay_m_per_s, many.delay_m_per_s[:3])
    assert (few.bandwidth_m_per_s > 0).all() and not few.energy_m_per_j.any()


@pytest.fixture(scope="module")
def made():
    data, static = make_system([drive(seed) for seed in range(3)], 1, SIZE)
    arch = replace(static.train.arch, latent=8, hidden=16, last_hidden=16)
    train = replace(static.train, arch=arch, prefixes=(4, 8))
    drift = data.env.drift._replace(rate_m_per_s=6.0 * data.env.drift.rate_m_per_s)
    codes = ("float32", "entropy")
    static = replace(static, train=train, requests=80, codes=codes, compact=True, schedulers=("fifo",))
    return data._replace(env=data.env._replace(drift=drift)), static


@pytest.mark.long
def test_candidates_are_replayed_as_the_system_replays_them(made):
    data, static = made
    key, ks = jax.random.key(3), jnp.array([4, 8])
    tried = Prices(*(jnp.array(values, jnp.float32) for values in ([1.0, 50.0], [0.0, 0.0], [2.0, 80.0])))
    found = jax.jit(Priced(static))(key, {}, (ks, tried, data))
    assert found["risk_m"].shape == (2, 2, 2)
    # By code and prefix, another of the two.
    choice = np.array([[0, 1], [1, 0]])
    prices = Prices(*(leaf[choice] for leaf in tried))
    budget = data.control._replace(budget_bytes=jnp.float32(jnp.inf), prices=prices)
    free = data._replace(control=budget)
    system = jax.jit(chain.along, static_argnames="static")(key, {}, ks, jnp.array([8.0]), free, static)
    for name, of_system in (("risk_m", "risk_m"), ("most_kb", "free_kb")):
        taken = np.take_along_axis(np.asarray(found[name]), choice[..., None], axis=-1)[..., 0]
        np.testing.assert_allclose(taken, system[of_system], rtol=1e-4)
    assert found["most_kb"][0, 0, 0] > found["most_kb"][0, 0, 1]
    assert (np.asarray(system["unserved"]) == 0).all()

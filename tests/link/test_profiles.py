"""Controlled throughput profiles against quadrature, a closed form and the oracle; their means and limits."""

import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import special

from ovibjax.link import profiles
from tests.link.cases import K_FACTORS, KEY, fading_power
from tests.oracles import channel as oracle

ergodic, profile_rate_bps = jax.jit(profiles.ergodic_bps_per_hz), jax.jit(profiles.profile_rate_bps)
N = 40_000


@pytest.mark.parametrize("k", K_FACTORS)
@pytest.mark.parametrize("snr", [1e-3, 0.3, 1.0, 30.0, 1e4])
def test_ergodic_rate_equals_quadrature(snr, k):
    assert float(ergodic(snr, k)) == pytest.approx(oracle.ergodic_bps_per_hz(snr, k), rel=3e-6)


def test_ergodic_rate_of_rayleigh_in_closed_form():
    # Alouini and Goldsmith: exp(1 / snr) E1(1 / snr) / ln 2; the left end needs the scaled integral's asymptote.
    snr = 10.0 ** np.arange(-2, 9)
    expected = np.exp(1 / snr) * special.exp1(1 / snr) / math.log(2)
    np.testing.assert_allclose(ergodic(snr, 0.0), expected, rtol=3e-6)
    assert float(ergodic(1e-6, 0.0)) == pytest.approx(1e-6 / math.log(2), rel=3e-6)
    assert float(ergodic(0.0, 0.0)) == 0.0
    np.testing.assert_allclose(ergodic(snr, 1e6), np.log2(1 + snr), rtol=1e-5)  # no fading left


@pytest.mark.parametrize(("snr", "k", "depth"), [(1.0, 0.0, 1.0), (0.1, 3.0, 0.5), (50.0, 10.0, 0.2)])
def test_profile_equals_the_oracle(snr, k, depth):
    power = np.float32([0.0, 1e-6, 0.1, 1.0, 7.0])
    for mean in profiles.PROFILES_KB_PER_S:
        expected = [oracle.profile_rate_bps(float(h), mean, snr, k, depth) for h in power]
        np.testing.assert_allclose(profile_rate_bps(power, mean, snr, k, depth), expected, rtol=5e-6, atol=1e-3)


@pytest.mark.parametrize("k", [0.0, 5.0])
@pytest.mark.parametrize("snr", [0.0, 0.2, 1.0, 100.0])
def test_mean_of_a_profile_is_its_name(snr, k):
    power = np.concatenate([fading_power(key, (N,), k) for key in jax.random.split(KEY, 10)])
    for mean, depth in itertools.product(profiles.PROFILES_KB_PER_S, (0.0, 0.4, 1.0)):
        rates = np.asarray(profile_rate_bps(power, mean, snr, k, depth), np.float64)
        assert rates.mean() == pytest.approx(mean * 8192, rel=0.01)
    assert rates.std() > 0.05 * rates.mean()


def test_profile_limits():
    power = np.float32([0.0, 1e-9, 0.5, 1.0, 4.0])
    np.testing.assert_array_equal(profile_rate_bps(power, 8, 1.0, 0.0, 0.0), np.full(5, 65536.0))
    deep = np.asarray(profile_rate_bps(power, 8))
    assert deep[0] == 0 and 0 < deep[1] < 1e-3  # nothing holds a deep fade up
    assert np.all(np.diff(deep) > 0)
    # As the SNR falls the rate becomes proportional to |h|^2, without 0 / 0 at none.
    np.testing.assert_allclose(profile_rate_bps(power, 4, 0.0), 4 * 8192 * power, rtol=1e-4)
    gradient = jax.jit(jax.grad(lambda *leaves: profiles.profile_rate_bps(jnp.float32(0), *leaves), (0, 1, 2, 3)))
    assert np.isfinite([gradient(8.0, snr, 0.0, 1.0) for snr in (0.0, 1.0)]).all()


@settings(deadline=None, max_examples=60)
@given(st.floats(0, 20), st.floats(0, 20), st.floats(1e-3, 1e3), st.floats(0, 20), st.floats(0, 1))
def test_profile_grows_with_the_fading_power(low, high, snr, k, depth):
    low, high = sorted((low, high))
    rates = np.asarray(profile_rate_bps(np.float32([low, high]), 8.0, snr, k, depth))
    assert 0 <= rates[0] <= rates[1]


def test_profile_vmap_equals_loop():
    power = np.random.default_rng(2).exponential(size=30).astype(np.float32)
    means, depths = jnp.array([4.0, 8.0, 12.0]), jnp.array([0.0, 0.5, 1.0])
    snrs = jnp.array([0.1, 1.0])

    @jax.jit
    def member(mean, depth, snr):
        return profiles.profile_rate_bps(power, mean, snr, 1.0, depth)

    over_snr = jax.vmap(member, (None, None, 0))
    over_depth = jax.vmap(over_snr, (None, 0, None))
    grid = jax.jit(jax.vmap(over_depth, (0, None, None)))(means, depths, snrs)
    loop = [[[member(m, d, s) for s in snrs] for d in depths] for m in means]
    assert grid.shape == (3, 3, 2, 30)
    np.testing.assert_allclose(grid, np.array(loop), rtol=5e-6)

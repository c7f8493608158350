"""The uplink against exact arithmetic, the moments and distributions of its randomness, and its limits."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from ovibjax.link import channel
from ovibjax.link.latency import transmit_s
from ovibjax.link.profiles import PROFILES_KB_PER_S
from tests.link.cases import K_FACTORS, KEY, fading_power
from tests.oracles import channel as oracle

rate_bps, path_gain, draw_gain = (jax.jit(f) for f in (channel.rate_bps, channel.path_gain, channel.draw_gain))
shadowing_rows_db = jax.jit(jax.vmap(channel.draw_shadowing_db, (0, None, None)), static_argnums=1)
rate_gradient = jax.jit(jax.grad(channel.rate_bps, argnums=(0, 1, 2, 3)))

DEFAULT = channel.make_channel_params()
RADIO = (DEFAULT.bandwidth_hz, DEFAULT.power_w, DEFAULT.noise_w_per_hz)
N = 40_000


def test_rate_equals_exact_arithmetic():
    rng = np.random.default_rng(0)
    gains = 10 ** rng.uniform(-25, 0, 200)
    radios = [10 ** rng.uniform(low, high, 200) for low, high in ((3, 8), (-4, 1), (-21, -17))]
    arguments = [np.float32(values) for values in (gains, *radios)]
    out = rate_bps(*arguments)
    assert out.shape == (200,) and out.dtype == jnp.float32
    np.testing.assert_allclose(out, [oracle.rate_bps(*row) for row in zip(*arguments, strict=True)], rtol=2e-6)


@pytest.mark.parametrize("snr", [1e-3, 1e-6, 1e-9, 1e-12, 1e-20, 1e-30])
def test_tiny_snr_keeps_its_digits(snr):
    # log2(1 + snr) in float32 is 0 below 6e-8; the true value is snr / ln 2 to second order.
    assert float(rate_bps(snr, 1.0, 1.0, 1.0)) == pytest.approx(math.log1p(snr) / math.log(2), rel=1e-6)


def test_zero_gain_is_a_dead_link_with_finite_gradients():
    assert float(rate_bps(0.0, *RADIO)) == 0.0 and float(transmit_s(100, rate_bps(0.0, *RADIO))) == math.inf
    for gain in (0.0, 1e-13):
        gradient = rate_gradient(jnp.float32(gain), *RADIO)
        assert np.isfinite(gradient).all()
    slope = rate_gradient(jnp.float32(0), *RADIO)[0]
    assert float(slope) == pytest.approx(0.025 / 1.6e-20 / math.log(2), rel=1e-6)  # P / (N0 ln 2)
    assert float(rate_bps(1e-13, RADIO[0], 0.0, RADIO[2])) == 0.0
    assert float(path_gain(300.0, DEFAULT, 0.0, 0.0)) == 0.0


@settings(deadline=None, max_examples=100)
@given(
    st.floats(-20, 0), st.floats(0.05, 3), st.floats(3, 8), st.floats(0.05, 3), st.floats(-20, -18), st.floats(-3, 1)
)
def test_rate_is_monotone(log_gain, more_gain, log_bandwidth, more_bandwidth, log_noise, log_power):
    gain, bandwidth, noise, power = 10**log_gain, 10**log_bandwidth, 10**log_noise, 10**log_power
    base = float(rate_bps(gain, bandwidth, power, noise))
    assert float(rate_bps(gain * 10**more_gain, bandwidth, power, noise)) > base > 0
    assert float(rate_bps(gain, bandwidth, power * 10**more_gain, noise)) > base
    assert float(rate_bps(gain, bandwidth, power, noise * 10**more_gain)) < base
    # More bandwidth never hurts, but is worth nothing once the SNR per hertz is tiny.
    assert float(rate_bps(gain, bandwidth * 10**more_bandwidth, power, noise)) >= base * (1 - 1e-6)


def test_path_gain_equals_the_link_budget():
    rng = np.random.default_rng(1)
    params = channel.make_channel_params(g0=3e-5, rho0_m=2.0, kappa=2.7)
    distance, shadowing, power = rng.uniform(2, 2000, 100), rng.normal(0, 8, 100), rng.exponential(size=100)
    expected = [
        oracle.path_gain_db(d, 3e-5, 2.0, 2.7, s, p) for d, s, p in zip(distance, shadowing, power, strict=True)
    ]
    np.testing.assert_allclose(10 * np.log10(path_gain(distance, params, shadowing, power)), expected, atol=1e-4)


@pytest.mark.parametrize("kappa", [2.0, 3.5, 4.0])
def test_path_loss_slope_per_decade(kappa):
    gain = path_gain(10.0 ** np.arange(5), DEFAULT._replace(kappa=jnp.float32(kappa)), 0.0, 1.0)
    np.testing.assert_allclose(np.diff(10 * np.log10(gain)), -10 * kappa, atol=1e-4)
    assert float(gain[0]) == pytest.approx(7.6e-4, rel=1e-6)  # g0 at the reference distance of 1 m


def test_default_link_is_weak_at_some_hundred_metres():
    distances = jnp.array([340.0, 385.0, 470.0])
    kb_per_s = rate_bps(path_gain(distances, DEFAULT, 0.0, 1.0), *RADIO) / 8192
    np.testing.assert_allclose(kb_per_s, [12, 8, 4], rtol=0.03)
    assert PROFILES_KB_PER_S == (4, 8, 12)
    # 868 MHz in free space at 1 m, and -174 dBm/Hz with a noise figure of 6 dB.
    assert float(DEFAULT.g0) == pytest.approx((299_792_458 / 868e6 / (4 * math.pi)) ** 2, rel=0.01)
    assert float(DEFAULT.noise_w_per_hz) == pytest.approx(10 ** ((-174 + 6 - 30) / 10), rel=0.01)


@pytest.mark.parametrize("k", K_FACTORS)
def test_fading_moments_and_distribution(k):
    power = np.asarray(fading_power(KEY, (N,), k), np.float64)
    variance = (1 + 2 * k) / (1 + k) ** 2
    assert power.min() >= 0
    assert power.mean() == pytest.approx(1, abs=4 * math.sqrt(variance / N))
    fourth = oracle.fading_distribution(k).stats(moments="k") + 3
    assert power.var() == pytest.approx(variance, rel=4 * math.sqrt((fourth - 1) / N))
    assert stats.kstest(power, oracle.fading_distribution(k).cdf).pvalue > 1e-3
    assert abs(np.corrcoef(power[1:], power[:-1])[0, 1]) < 4 / math.sqrt(N)


def test_fading_takes_a_factor_per_element():
    odd = np.arange(N) % 2 == 1
    both, rayleigh, rician = (np.asarray(fading_power(KEY, (N,), k)) for k in (np.float32(9 * odd), 0.0, 9.0))
    np.testing.assert_allclose(both, np.where(odd, rician, rayleigh), rtol=1e-6)


@pytest.mark.parametrize("correlation", [0.0, 0.6, 0.92])
def test_shadowing_moments_and_autocorrelation(correlation):
    params = channel.make_channel_params(shadowing_sigma_db=5.0, shadowing_correlation=correlation)
    xi = np.asarray(shadowing_rows_db(jax.random.split(KEY, 4000), 40, params), np.float64)
    # Rows are independent, so the error of a slot's figure follows from their number alone.
    np.testing.assert_allclose(xi.mean(axis=0), 0, atol=5 * 5 / math.sqrt(4000))
    np.testing.assert_allclose(xi.std(axis=0), 5, rtol=5 / math.sqrt(2 * 4000))
    for lag in (1, 2, 5, 20):
        measured = np.corrcoef(xi[:, 0], xi[:, lag])[0, 1]
        assert measured == pytest.approx(correlation**lag, abs=5 / math.sqrt(4000))
    assert stats.kstest(xi[:, 39] / 5, stats.norm.cdf).pvalue > 1e-3
    # 10^(xi / 10) is log-normal: its mean exceeds 1 by the well-known factor.
    sigma = 5 * math.log(10) / 10
    gain = np.asarray(path_gain(1.0, params._replace(g0=jnp.float32(1)), xi[:, 0], 1.0), np.float64)
    error = 5 * math.sqrt(math.expm1(sigma**2) / 4000)
    assert gain.mean() == pytest.approx(math.exp(sigma**2 / 2), rel=error)


def test_shadowing_limits():
    keys = jax.random.split(KEY, 4000)
    frozen = np.asarray(shadowing_rows_db(keys, 40, channel.make_channel_params(shadowing_correlation=1.0)))
    np.testing.assert_array_equal(frozen, np.repeat(frozen[:, :1], 40, axis=1))
    assert not np.any(shadowing_rows_db(keys, 40, channel.make_channel_params(shadowing_sigma_db=0.0)))
    one = draw_gain(KEY, jnp.array([300.0]), DEFAULT)
    assert one.shape == (1,) and float(one[0]) > 0


def test_the_stream_depends_on_the_key_only():
    distance = np.linspace(100, 600, 60, dtype=np.float32)
    gain = np.asarray(draw_gain(KEY, distance, DEFAULT))
    assert gain.shape == (60,) and gain.dtype == jnp.float32
    longer = np.append(distance, np.full(N - 60, 50.0)).astype(np.float32)
    np.testing.assert_allclose(draw_gain(KEY, longer, DEFAULT)[:60], gain, rtol=2e-5)
    assert not np.any(np.asarray(draw_gain(jax.random.key(8), distance, DEFAULT)) == gain)
    # Distance scales the same fades; the shadowing scales with its deviation and leaves the fading alone.
    doubled_db = 10 * np.log10(np.asarray(draw_gain(KEY, 2 * distance, DEFAULT)) / gain)
    np.testing.assert_allclose(doubled_db, -40 * math.log10(2), atol=1e-4)
    sigmas = [DEFAULT._replace(shadowing_sigma_db=jnp.float32(sigma)) for sigma in (0, 3, 6)]
    none, half, full = (10 * np.log10(draw_gain(KEY, distance, params)) for params in sigmas)
    np.testing.assert_allclose(full - none, 2 * (half - none), atol=2e-4)
    assert np.std(full - none) > 1


def test_gain_is_the_product_of_independent_parts():
    params = channel.make_channel_params(shadowing_sigma_db=2.0, rician_k_factor=3.0, shadowing_correlation=0.5)
    # Without shadowing what is left is the fading, of its own distribution.
    clear = params._replace(shadowing_sigma_db=jnp.float32(0))
    gains = (np.asarray(draw_gain(KEY, jnp.full(N, 200.0), link), np.float64) for link in (params, clear))
    relative, fading = (gain / float(path_gain(200.0, params, 0.0, 1.0)) for gain in gains)
    assert stats.kstest(fading, oracle.fading_distribution(3.0).cdf).pvalue > 1e-3
    shadowing_db = 10 * np.log10(relative / fading)
    assert shadowing_db.std() == pytest.approx(2, rel=0.03)
    assert np.corrcoef(shadowing_db[1:], shadowing_db[:-1])[0, 1] == pytest.approx(0.5, abs=0.03)
    assert abs(np.corrcoef(shadowing_db, fading)[0, 1]) < 0.03


def test_draws_vmap_equals_loop():
    keys = jax.random.split(KEY, 3)
    distance = np.float32([np.linspace(100, 500, 60), np.full(60, 250)])
    links = [channel.make_channel_params(kappa=kappa, rician_k_factor=k) for kappa, k in ((3.0, 0.0), (4.0, 2.0))]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *links)
    over_links = jax.vmap(channel.draw_gain, (None, 0, 0))
    grid = jax.jit(jax.vmap(over_links, (0, None, None)))(keys, distance, stacked)
    loop = [[draw_gain(key, d, link) for d, link in zip(distance, links, strict=True)] for key in keys]
    np.testing.assert_allclose(grid, np.array(loop), rtol=2e-5)


def test_params_are_float32_leaves():
    assert len(jax.tree.leaves(DEFAULT)) == len(DEFAULT) == 9
    assert all(leaf.dtype == jnp.float32 and leaf.shape == () and not leaf.weak_type for leaf in DEFAULT)

"""The block-fading uplink and its controlled throughput profiles (paper, Section "Communication Model").

The gain of a slot is drawn once and holds for the request sent in it. Distance enters by a power law, obstacles by
log-normal shadowing that lasts over slots, small-scale fading by an independent Rician or Rayleigh draw per slot.
The evaluation's controlled profiles keep the fading and fix the mean rate instead of the distance.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from ovibjax.link.latency import kbytes_per_s

PROFILES_KB_PER_S = (4, 8, 12)
"""Mean rates of the paper's weak-link profiles, KB/s of 1,024 bytes."""

_SNR_MIN = 1e-6
_NODES = 96
_LOG_FIRST = math.log(1e-9)
_LOG_LAST = math.log(24.0)


class ChannelParams(NamedTuple):
    """Numbers of one link; every field is a float32 leaf that can be swept.

    Attributes:
        g0: path gain at the reference distance, a ratio of powers.
        rho0_m: reference distance.
        kappa: path-loss exponent.
        shadowing_sigma_db: standard deviation of the shadowing.
        shadowing_correlation: correlation of the shadowing of neighbouring slots, 0 to 1.
        rician_k_factor: power of the direct path over that of the scattered ones; 0 is Rayleigh.
        bandwidth_hz: channel bandwidth B.
        power_w: transmit power P of the client.
        noise_w_per_hz: noise power spectral density N0.
    """

    g0: jax.Array
    rho0_m: jax.Array
    kappa: jax.Array
    shadowing_sigma_db: jax.Array
    shadowing_correlation: jax.Array
    rician_k_factor: jax.Array
    bandwidth_hz: jax.Array
    power_w: jax.Array
    noise_w_per_hz: jax.Array


def make_channel_params(
    g0: float = 7.6e-4,
    rho0_m: float = 1.0,
    kappa: float = 4.0,
    shadowing_sigma_db: float = 6.0,
    shadowing_correlation: float = 0.92,
    rician_k_factor: float = 0.0,
    bandwidth_hz: float = 125e3,
    power_w: float = 0.025,
    noise_w_per_hz: float = 1.6e-20,
) -> ChannelParams:
    """Channel parameters as float32 arrays; the defaults are a weak sub-GHz link, for the paper states none.

    They describe a narrow-band radio at 868 MHz that sends 25 mW (the European limit) in 125 kHz: free-space gain
    at 1 m, the exponent of an obstructed urban path, thermal noise with a noise figure of 6 dB, and shadowing that
    decorrelates over about 20 m at the 1.6 m per slot of the embedded routes, exp(-1.6 / 20). Without shadowing
    and fading the rate is 12, 8 and 4 KB/s at about 340, 385 and 470 m.
    """
    values = (g0, rho0_m, kappa, shadowing_sigma_db, shadowing_correlation, rician_k_factor)
    radio = (bandwidth_hz, power_w, noise_w_per_hz)
    return ChannelParams(*(jnp.asarray(value, jnp.float32) for value in (*values, *radio)))


def rate_bps(gain: ArrayLike, bandwidth_hz: ArrayLike, power_w: ArrayLike, noise_w_per_hz: ArrayLike) -> jax.Array:
    """Achievable rate R = B log2(1 + P g / (N0 B)) (paper, Section "Communication Model").

    Args:
        gain: [...] channel gain g, zero or more.
        bandwidth_hz: [...] bandwidth B, positive.
        power_w: [...] transmit power P.
        noise_w_per_hz: [...] noise power spectral density N0, positive.

    Returns:
        [...] float32 bits per second; 0 at zero gain, with a finite gradient.
    """
    gain, bandwidth, power, noise = (
        jnp.asarray(value, jnp.float32) for value in (gain, bandwidth_hz, power_w, noise_w_per_hz)
    )
    # P / (N0 B) is large where g is tiny: taken first, neither product leaves the range of float32.
    snr = gain * (power / (noise * bandwidth))
    return bandwidth * jnp.log1p(snr) / math.log(2.0)


def path_gain(
    distance_m: ArrayLike, params: ChannelParams, shadowing_db: ArrayLike, fading_power: ArrayLike
) -> jax.Array:
    """Channel gain g = g0 (rho0 / rho)^kappa 10^(xi / 10) |h|^2 (paper, Section "Communication Model").

    Args:
        distance_m: [...] client-edge distance rho, positive; the power law is meant for rho0 and beyond.
        params: the link.
        shadowing_db: [...] shadowing xi in dB.
        fading_power: [...] small-scale fading |h|^2.

    Returns:
        [...] float32 gain.
    """
    distance, shadowing, power = (jnp.asarray(value, jnp.float32) for value in (distance_m, shadowing_db, fading_power))
    path = params.g0 * (params.rho0_m / distance) ** params.kappa
    return path * jnp.exp(shadowing * (math.log(10.0) / 10.0)) * power


def fading_power(key: jax.Array, shape: tuple[int, ...], k_factor: ArrayLike) -> jax.Array:
    """Independent draws of |h|^2 with mean 1: a direct path of power K / (1 + K) plus complex Gaussian scatter.

    Args:
        key: PRNG key.
        shape: shape of the result.
        k_factor: Rician factor K >= 0, scalar or broadcastable to `shape`; 0 is Rayleigh, where |h|^2 is
            exponential. The variance is (1 + 2 K) / (1 + K)^2.

    Returns:
        `shape` float32.
    """
    real_key, imaginary_key = jax.random.split(key)
    k = jnp.asarray(k_factor, jnp.float32)
    direct = jnp.sqrt(2.0 * k)
    real = direct + jax.random.normal(real_key, shape, jnp.float32)
    imaginary = jax.random.normal(imaginary_key, shape, jnp.float32)
    return (real**2 + imaginary**2) / (2.0 * (1.0 + k))


def draw_shadowing_db(key: jax.Array, n_slots: int, params: ChannelParams) -> jax.Array:
    """Stationary AR(1) shadowing xi, normal in dB, correlated over neighbouring slots.

    Args:
        key: PRNG key.
        n_slots: number of slots T.
        params: the link; its deviation scales the draws, its correlation c gives c^n at n slots apart.

    Returns:
        [T] float32 dB.
    """
    correlation = params.shadowing_correlation
    innovation = jnp.sqrt(1.0 - correlation**2)

    def step(previous: jax.Array, noise: jax.Array) -> tuple[jax.Array, jax.Array]:
        current = correlation * previous + innovation * noise
        return current, current

    noise = jax.random.normal(key, (n_slots,), jnp.float32)
    # The first slot has the stationary variance, so no slot is special.
    _, rest = jax.lax.scan(step, noise[0], noise[1:])
    return params.shadowing_sigma_db * jnp.concatenate([noise[:1], rest])


def draw_gain(key: jax.Array, distance_m: jax.Array, params: ChannelParams) -> jax.Array:
    """Gains of one route: power law, AR(1) shadowing and independent block fading per slot.

    The draws depend on the key alone: distances and parameters scale them, and a longer route continues a shorter
    one, so links that differ in a parameter are compared under the same fades.

    Args:
        key: PRNG key.
        distance_m: [T] client-edge distance per slot, T >= 1.
        params: the link.

    Returns:
        [T] float32 gain g.
    """
    shadowing_key, fading_key = jax.random.split(key)
    n_slots = distance_m.shape[0]
    shadowing_db = draw_shadowing_db(shadowing_key, n_slots, params)
    return path_gain(distance_m, params, shadowing_db, fading_power(fading_key, (n_slots,), params.rician_k_factor))


def ergodic_bps_per_hz(snr: ArrayLike, k_factor: ArrayLike) -> jax.Array:
    """Mean spectral efficiency E[log2(1 + snr |h|^2)] under Rician fading of unit mean power.

    ln(1 + x) is the integral of (1 - exp(-z x)) exp(-z) / z over z > 0, so the mean needs only the moment generating
    function of |h|^2, which is elementary for every K, Rayleigh included. On z = exp(u) the trapezoid rule with 96
    points reaches the rounding of float32 for mean SNR up to 80 dB.

    Args:
        snr: [...] mean signal-to-noise ratio, linear, zero or more.
        k_factor: [...] Rician factor K >= 0.

    Returns:
        [...] float32 bits per second and hertz.
    """
    snr, k = jnp.broadcast_arrays(jnp.asarray(snr, jnp.float32), jnp.asarray(k_factor, jnp.float32))
    snr, k = snr[..., None], k[..., None]
    nodes = jnp.arange(_NODES, dtype=jnp.float32).reshape((1,) * (snr.ndim - 1) + (_NODES,))
    # 1 - E[exp(-z snr |h|^2)] grows like z snr until z is about 1 / snr: the grid must begin well below that.
    first = _LOG_FIRST - jnp.log1p(snr)
    spacing = (_LOG_LAST - first) / (_NODES - 1)
    z = jnp.exp(first + spacing * nodes)
    x = z * snr
    log_mgf = -jnp.log1p(x / (1.0 + k)) - k * x / (1.0 + k + x)
    integral = jnp.sum(-jnp.expm1(log_mgf) * jnp.exp(-z), axis=-1) * spacing[..., 0]
    return integral / math.log(2.0)


def profile_rate_bps(
    fading_power: ArrayLike,
    mean_kb_per_s: ArrayLike,
    snr: ArrayLike = 1.0,
    k_factor: ArrayLike = 0.0,
    depth: ArrayLike = 1.0,
) -> jax.Array:
    """Rate of a controlled throughput profile with block fading around it (paper, Section "Experimental Setup").

    R = mean (1 - depth + depth log2(1 + snr |h|^2) / E[log2(1 + snr |h|^2)]). The rate follows the fading as on a
    link of that mean SNR, scaled so that its mean is the profile's at any SNR, K and depth. At depth 1 nothing
    bounds a fade from below: the rate goes to 0 with |h|^2.

    Args:
        fading_power: [...] |h|^2 of each slot, of mean 1, as `fading_power` draws it with the same K.
        mean_kb_per_s: [...] mean rate of the profile in KB/s of 1,024 bytes.
        snr: [...] mean signal-to-noise ratio, linear; the default, 0 dB, is a weak link. A small one lets the rate
            swing in proportion to |h|^2 (the limit, reached at 1e-6), a large one flattens it.
        k_factor: [...] Rician factor K of the fading.
        depth: [...] 0 for the constant profile to 1 for the whole fading.

    Returns:
        [...] float32 bits per second.
    """
    power, mean, depth = (jnp.asarray(value, jnp.float32) for value in (fading_power, mean_kb_per_s, depth))
    snr = jnp.maximum(jnp.asarray(snr, jnp.float32), _SNR_MIN)
    relative = jnp.log1p(snr * power) / (math.log(2.0) * ergodic_bps_per_hz(snr, k_factor))
    return kbytes_per_s(mean) * (1.0 - depth + depth * relative)

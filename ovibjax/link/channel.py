"""How fast a wireless uplink is, slot by slot: the block-fading channel (paper, Section "Communication Model").

The gain of a slot is drawn once and holds for the request sent in it. Distance enters by a power law, obstacles by
log-normal shadowing that lasts over slots, small-scale fading by an independent Rician or Rayleigh draw per slot.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike


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


WEAK_LINK = {
    "g0": 7.6e-4,
    "rho0_m": 1.0,
    "kappa": 4.0,
    "shadowing_sigma_db": 6.0,
    "shadowing_correlation": 0.92,
    "rician_k_factor": 0.0,
    "bandwidth_hz": 125e3,
    "power_w": 0.025,
    "noise_w_per_hz": 1.6e-20,
}
"""Fields of `ChannelParams` for a weak sub-GHz link, as the paper states no numbers: a narrow-band radio at 868 MHz
that sends 25 mW (the European limit) in 125 kHz, with free-space gain at 1 m, the exponent of an obstructed urban path,
thermal noise with a noise figure of 6 dB, and shadowing that decorrelates over about 20 m at the 1.6 m per slot of the
embedded routes, exp(-1.6 / 20). Without shadowing and fading the rate is 12, 8 and 4 KB/s at about 340, 385 and 470
m."""


def make_channel_params(**changes: float) -> ChannelParams:
    """Channel parameters as float32 arrays.

    Args:
        changes: fields of `ChannelParams` that differ from those of `WEAK_LINK`.

    Returns:
        The parameters.
    """
    values = {**WEAK_LINK, **changes}
    return ChannelParams(**{name: jnp.asarray(value, jnp.float32) for name, value in values.items()})


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

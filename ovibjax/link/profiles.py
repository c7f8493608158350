"""Links of a given mean throughput: the evaluation's controlled profiles (paper, Section "Experimental Setup").

They keep the block fading of `link.channel` and fix the mean rate instead of the distance.
"""

import math

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
        fading_power: [...] |h|^2 of each slot, of mean 1, as `channel.fading_power` draws it with the same K.
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

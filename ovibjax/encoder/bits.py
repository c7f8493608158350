"""Training for bits: codes that are rounded to learned steps and cost their length under a learned prior.

Ballé, Laparra and Simoncelli, "End-to-end optimized image compression", 2017 (not in the paper): in training, uniform
noise of one step stands for rounding, and the cost of a coordinate is the negative logarithm of what a Gaussian of
learned mean and width gives to the step around it. In use, coordinates are rounded. Only the coordinates that are sent
cost anything, so that every prefix pays for itself alone.

What is learned lies beside the layers of the network, as `bits`: per coordinate the logarithm of the step, the mean and
the logarithm of the width of the prior, all in the units of the code.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import log_ndtr

from ovibjax.encoder.model import Architecture, Params, encode
from ovibjax.link.codes.rounding import Grid, along_last, snapped

STEP = 0.5
"""Step that training starts with, half the deviation of an average feature; steps are learned from there."""

_LEAST, _MOST = -12.0, 12.0  # logarithms of steps and widths, so that no cost is infinite
_TAIL = 100.0  # widths from the mean
_TINY = 1e-7  # of a step that is nothing beside the width
_FURTHEST = 1 << 20  # multiples of a step that a code may be away from zero


def with_bits(params: Params, x: jax.Array, arch: Architecture) -> Params:
    """Parameters of a network with steps and a prior, the latter fitted to the codes it begins with.

    Args:
        params: initial parameters of the network.
        x: [N, M, r] training features.
        arch: widths of the network (static).

    Returns:
        The parameters, with `bits` beside the layers.
    """
    z = encode(params, x.reshape(x.shape[0], -1), arch)[0]
    width = jnp.std(z, axis=0) + 0.1 * STEP
    log_step = jnp.full(arch.latent, math.log(STEP), jnp.float32)
    bits = {"log_step": log_step, "mean": jnp.mean(z, axis=0), "log_width": jnp.log(width)}
    return {"params": params["params"] | {"bits": bits}}


def trained_for_bits(params: Params) -> bool:
    """Whether a network has steps and a prior."""
    return "bits" in params["params"]


def steps_of(params: Params) -> jax.Array:
    """Learned steps [K] of a network that was trained for bits."""
    return jnp.exp(jnp.clip(params["params"]["bits"]["log_step"], _LEAST, _MOST))


def code_of(params: Params, x: jax.Array, arch: Architecture) -> jax.Array:
    """The code that is sent of each frame: posterior means, rounded to the learned steps where there are any.

    Args:
        params: parameters of the network.
        x: [B, M r] flattened features, zero where a view is absent.
        arch: widths of the network (static).

    Returns:
        [B, K] codes as the edge receives them.
    """
    mu = encode(params, x, arch)[0]
    if not trained_for_bits(params):
        return mu
    bound = jnp.full(mu.shape[-1], _FURTHEST, jnp.int32)
    return snapped(Grid(steps_of(params), -bound, bound), mu)


def code_bits(params: Params, z: jax.Array) -> jax.Array:
    """Length of each coordinate of a code under the learned prior.

    Args:
        params: parameters of a network that was trained for bits.
        z: [..., K] codes, noisy or rounded.

    Returns:
        [..., K] bits: -log2 of the Gaussian's share of the step around each value.
    """
    bits = params["params"]["bits"]
    width = jnp.exp(jnp.clip(bits["log_width"], _LEAST, _MOST))
    half = along_last(0.5 * steps_of(params) / width, z)
    # By symmetry, the lower tail: there the difference of two distribution functions keeps its digits.
    away = jnp.abs(z - along_last(bits["mean"], z)) / along_last(width, z)
    upper = log_ndtr(jnp.maximum(half - away, -_TAIL))
    lower = log_ndtr(jnp.maximum(-half - away, -1.5 * _TAIL))
    # Further out float32 loses the slope of the tail; it goes on in a straight line.
    beyond = _TAIL * jnp.maximum(away - half - _TAIL, 0.0)
    return (beyond - upper - jnp.log(-jnp.expm1(-jnp.maximum(upper - lower, _TINY)))) / np.float32(math.log(2.0))

"""What a code costs, in nats: the divergence of its distribution from a prior (paper, eqs. "rate_term" and "ardkl")."""

import jax
import jax.numpy as jnp

ARD_CONSTANTS = (0.63576, 1.87320, 1.48695)
"""(c1, c2, c3) of the closed-form approximation (paper, eq. "ardkl"), fitted by Molchanov et al. (2017)."""

# A mean of exactly zero makes alpha infinite; below this square the term has long vanished.
_TINY = 1e-16


def gaussian_kl(mu: jax.Array, logvar: jax.Array) -> jax.Array:
    """Rate of a Gaussian code: its KL divergence from the standard normal prior, summed over the last axis.

    Args:
        mu: [..., K] posterior means.
        logvar: [..., K] logarithms of the posterior variances.

    Returns:
        [...] nats (paper, eq. "rate_term").
    """
    return 0.5 * jnp.sum(mu**2 + jnp.exp(logvar) - logvar - 1.0, axis=-1)


def log_alpha(mu: jax.Array, logvar: jax.Array) -> jax.Array:
    """Logarithm of the noise-to-signal ratio alpha = sigma^2 / mu^2, elementwise."""
    return logvar - jnp.log(mu**2 + _TINY)


def ard_kl(mu: jax.Array, logvar: jax.Array) -> jax.Array:
    """Rate under automatic relevance determination: approximate KL divergence from the prior p(z) ~ 1/|z|.

    Args:
        mu: [..., K] posterior means.
        logvar: [..., K] logarithms of the posterior variances.

    Returns:
        [...] nats, summed over the last axis, within 0.009 per coordinate of the exact value up to its additive
        constant (paper, eq. "ardkl").
    """
    c1, c2, c3 = ARD_CONSTANTS
    ratio = log_alpha(mu, logvar)
    return jnp.sum(0.5 * jax.nn.softplus(-ratio) - c1 * jax.nn.sigmoid(c2 + c3 * ratio) + c1, axis=-1)


def active_dims(mu: jax.Array, logvar: jax.Array, threshold: float = 3.0) -> jax.Array:
    """Number of coordinates that automatic relevance determination has not pruned.

    Args:
        mu: [N, K] posterior means.
        logvar: [N, K] logarithms of the posterior variances.
        threshold: a coordinate is pruned when log alpha, with signal and noise averaged over the N samples,
            exceeds this; 3 is the customary choice of Molchanov et al.

    Returns:
        int32 scalar.
    """
    noise = jnp.mean(jnp.exp(logvar), axis=0)
    signal = jnp.mean(mu**2, axis=0)
    return jnp.sum(jnp.log(noise) - jnp.log(signal + _TINY) <= threshold).astype(jnp.int32)

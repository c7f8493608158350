"""The composite objective of O-VIB and its masks (paper, eqs. "prefix_mask" and "composite_loss")."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.encoder.model import Architecture, Params, decode, encode, locate, mean_projection
from ovibjax.encoder.rate import ard_kl, gaussian_kl


class Hypers(NamedTuple):
    """Numbers of one member of a grid; every field is an array leaf.

    Attributes:
        alpha: weight of the localization term.
        beta: weight of the rate term.
        gamma: weight of the orthogonality penalty.
        lr: peak learning rate.
        weight_decay: decoupled weight decay of AdamW.
    """

    alpha: jax.Array
    beta: jax.Array
    gamma: jax.Array
    lr: jax.Array
    weight_decay: jax.Array


def make_hypers(
    alpha: float = 1.0,
    beta: float = 1e-3,
    gamma: float = 0.1,
    lr: float = 2e-3,
    weight_decay: float = 1e-4,
) -> Hypers:
    """Hyperparameters as float32 arrays; defaults are the paper's (alpha, beta, gamma)."""
    return Hypers(*(jnp.asarray(value, jnp.float32) for value in (alpha, beta, gamma, lr, weight_decay)))


class Batch(NamedTuple):
    """One minibatch with its sampled masks and noise.

    Attributes:
        x: [B, M, r] features.
        y: [B, 3] standardised positions.
        view_mask: [B, M] mask m_S of each example.
        prefix_mask: [B, K] mask m^(k) of each example.
        noise: [B, K] standard normal.
    """

    x: jax.Array
    y: jax.Array
    view_mask: jax.Array
    prefix_mask: jax.Array
    noise: jax.Array


def prefix_mask(k: jax.Array | int, K: int) -> jax.Array:
    """Binary mask of the first k of K coordinates; k may be traced.

    Args:
        k: prefix length, scalar.
        K: full latent dimension.

    Returns:
        [K] float32 (paper, eq. "prefix_mask").
    """
    return (jnp.arange(K) < k).astype(jnp.float32)


def orthogonality_penalty(W: jax.Array) -> jax.Array:
    """Normalised deviation of the rows of W from orthonormality, K^-2 ||W W^T - I||_F^2.

    Args:
        W: [K, d_h] posterior-mean projection.

    Returns:
        Scalar (paper, last term of eq. "composite_loss").
    """
    size = W.shape[0]
    return jnp.sum((W @ W.T - jnp.eye(size, dtype=W.dtype)) ** 2) / size**2


def composite_loss(
    params: Params, batch: Batch, hypers: Hypers, arch: Architecture, prior: str
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """The training objective and each of its terms.

    Units: features are centred and scaled so that every coordinate has unit variance on average; dividing their
    squared error by r gives each view unit energy, the scale of the paper's unit-norm features. Positions are
    standardised. In these units the paper's (alpha, beta, gamma) = (1, 1e-3, 0.1) are the defaults.

    Args:
        params: parameters of the network.
        batch: a minibatch.
        hypers: weights of the terms.
        arch: widths of the network (static).
        prior: "gaussian" or "ard" (static).

    Returns:
        The scalar loss, and the unweighted terms `reconstruction`, `localization`, `rate` (nats), `orthogonality`.

    Raises:
        ValueError: unknown prior.
    """
    if prior not in ("gaussian", "ard"):
        raise ValueError(f"prior is 'gaussian' or 'ard', not {prior!r}")
    views = batch.view_mask[:, :, None]
    x = (batch.x * views).reshape(batch.x.shape[0], -1)
    mu, logvar = encode(params, x, arch)
    z = (mu + jnp.exp(0.5 * logvar) * batch.noise) * batch.prefix_mask
    descriptor = decode(params, z, arch)
    # The view mask applies to the decoded descriptor as to the input.
    descriptor = (descriptor.reshape(batch.x.shape) * views).reshape(x.shape)
    position = locate(params, descriptor, arch)
    kl = gaussian_kl if prior == "gaussian" else ard_kl
    terms = {
        "reconstruction": jnp.mean(jnp.sum((x - descriptor) ** 2, axis=-1)) / batch.x.shape[2],
        "localization": jnp.mean(jnp.sum((batch.y - position) ** 2, axis=-1)),
        "rate": jnp.mean(kl(mu, logvar)),
        "orthogonality": orthogonality_penalty(mean_projection(params)),
    }
    loss = terms["reconstruction"] + hypers.alpha * terms["localization"]
    loss = loss + hypers.beta * terms["rate"] + hypers.gamma * terms["orthogonality"]
    return loss, terms

"""What training minimises: the composite objective of O-VIB, and the mask that makes any prefix of the code a code
(paper, eqs. "composite_loss" and "prefix_mask").
"""

from collections.abc import Sequence
from typing import NamedTuple, cast

import jax
import jax.numpy as jnp

from ovibjax.encoder.bits import code_bits, steps_of
from ovibjax.encoder.model import OVIB, Architecture, Params, mean_projection, split_views
from ovibjax.encoder.orthogonality import orthogonality_penalty
from ovibjax.encoder.rate import ard_kl, gaussian_kl

ALPHA, BETA, GAMMA = 1.0, 1e-3, 0.1
"""Weights of localization, rate and orthogonality in the paper's evaluation (Section "Experimental Setup")."""

LR = 4e-3
"""Peak learning rate; the paper's is `recipe.PAPER_LR`."""


class Hypers(NamedTuple):
    """Numbers of one member of a grid; every field is an array leaf.

    Attributes:
        alpha: weight of the localization term (this and the next two: paper, eq. "composite_loss").
        beta: weight of the rate term; where that is in bits, the price lambda of a bit.
        gamma: weight of the orthogonality penalty.
        lr: peak learning rate.
        weight_decay: decoupled weight decay of AdamW.
        nesting: share of examples that see a random prefix; the others see all K coordinates. 1 is the paper's
            nested training, 0 is none.
    """

    alpha: jax.Array
    beta: jax.Array
    gamma: jax.Array
    lr: jax.Array
    weight_decay: jax.Array
    nesting: jax.Array


def make_hypers(
    alpha: float = ALPHA,
    beta: float = BETA,
    gamma: float = GAMMA,
    lr: float = LR,
    weight_decay: float = 1e-4,
    nesting: float = 1.0,
) -> Hypers:
    """Hyperparameters as float32 arrays.

    Args:
        alpha: weight of the localization term; the paper's by default, as the next two.
        beta: weight of the rate term.
        gamma: weight of the orthogonality penalty.
        lr: peak learning rate.
        weight_decay: decoupled weight decay of AdamW.
        nesting: share of examples that see a random prefix.

    Returns:
        The hyperparameters.
    """
    return Hypers(*(jnp.asarray(value, jnp.float32) for value in (alpha, beta, gamma, lr, weight_decay, nesting)))


PRIORS = ("gaussian", "ard", "bits")
"""Rate terms: divergence from a standard normal or a log-uniform prior, or length in bits under a learned one."""

TERMS = ("reconstruction", "localization", "rate", "orthogonality")
"""What `composite_loss` is made of."""


class Batch(NamedTuple):
    """One minibatch with its sampled masks and noise.

    Attributes:
        x: [B, M, r] features.
        y: [B, 3] standardised positions.
        view_mask: [B, M] mask m_S of each example.
        prefix_mask: [B, K] mask m^(k) of each example.
        noise: [B, K] standard normal; uniform within half of one to either side where the rate term is in bits.
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


def composite_loss(
    params: Params,
    batch: Batch,
    hypers: Hypers,
    arch: Architecture,
    prior: str,
    rows: Sequence[int] | None = None,
    precision: str = "float32",
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """The training objective and each of its terms (paper, eq. "composite_loss").

    Units: features are centred and scaled so that every coordinate has unit variance on average; dividing their
    squared error by r gives each view unit energy, the scale of the paper's unit-norm features. Positions are
    standardised. In these units the paper's (alpha, beta, gamma) = (1, 1e-3, 0.1) are the defaults.

    Args:
        params: parameters of the network.
        batch: a minibatch.
        hypers: weights of the terms.
        arch: widths of the network (static).
        prior: one of `PRIORS` (static).
        rows: per view, the number of leading rows beyond which it is masked everywhere (static); all by default.
            It changes the work, not the result.
        precision: type of the operands of the network's products (static).

    Returns:
        The scalar loss, and its unweighted `TERMS`, the rate in nats of all coordinates, or in bits of those sent.

    Raises:
        ValueError: unknown prior or precision.
    """
    if prior not in PRIORS:
        raise ValueError(f"prior is one of {', '.join(PRIORS)}, not {prior!r}")
    size = batch.x.shape[0]
    counts = tuple(rows or [size] * arch.n_views)
    network = OVIB(arch, precision)
    # The view mask applies to the decoded descriptor as to the input.
    masks = [batch.view_mask[:count, view, None] for view, count in enumerate(counts)]
    views = [x * mask for x, mask in zip(split_views(batch.x, arch, counts), masks, strict=True)]
    mu, logvar = cast(tuple[jax.Array, jax.Array], network.apply(params, views, method="encode"))
    z = mu + (steps_of(params)[None] if prior == "bits" else jnp.exp(0.5 * logvar)) * batch.noise
    decoded = cast(list[jax.Array], network.apply(params, z, batch.prefix_mask, counts, method="decode"))
    descriptor = [x * mask for x, mask in zip(decoded, masks, strict=True)]
    position = cast(jax.Array, network.apply(params, descriptor, method="locate"))
    if prior == "bits":
        rate = jnp.sum(batch.prefix_mask * code_bits(params, z), axis=-1)
    else:
        rate = (gaussian_kl if prior == "gaussian" else ard_kl)(mu, logvar)
    squared_errors = [jnp.sum((x - y) ** 2) for x, y in zip(views, descriptor, strict=True)]
    terms = {
        "reconstruction": sum(squared_errors, jnp.float32(0.0)) / (size * arch.view_dim),
        "localization": jnp.mean(jnp.sum((batch.y - position) ** 2, axis=-1)),
        "rate": jnp.mean(rate),
        "orthogonality": orthogonality_penalty(mean_projection(params)),
    }
    loss = terms["reconstruction"] + hypers.alpha * terms["localization"]
    loss = loss + hypers.beta * terms["rate"] + hypers.gamma * terms["orthogonality"]
    return loss, terms

"""How far the paper's lemmas and theorem are from failing on random models, in numbers for a report."""

from typing import NamedTuple

import jax
import numpy as np

from ovibjax.encoder.information_bounds import Bounds, bounds, exact_decoder, random_model


class Check(NamedTuple):
    """One statement, an identity with a gap that must not be negative.

    Attributes:
        statement: what the paper proves.
        deviation: largest relative deviation between the two sides of the identity.
        gap_nats: smallest gap.
    """

    statement: str
    deviation: float
    gap_nats: float


def check_bounds(models: int = 1000, features: int = 6, latent: int = 4, beta: float = 1e-2) -> list[Check]:
    """Lemmas 1 and 2 and the bound of Theorem 1 on random linear-Gaussian models and inexact decoders.

    Args:
        models: number of models.
        features: feature dimension n.
        latent: latent dimension K.
        beta: weight of the rate.

    Returns:
        Three checks, in the paper's order.
    """

    def one(key: jax.Array) -> Bounds:
        key_model, key_decoder = jax.random.split(key)
        model = random_model(key_model, features, latent)
        exact = exact_decoder(model)
        noise = 0.3 * jax.random.normal(key_decoder, exact.map.shape)
        return bounds(model, exact._replace(map=exact.map + noise), beta)

    b = jax.device_get(jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(0), models)))

    def check(statement: str, left: np.ndarray, right: np.ndarray, gap: np.ndarray, scale: np.ndarray) -> Check:
        return Check(statement, float(np.max(np.abs(left - right) / (1 + np.abs(scale)))), float(gap.min()))

    return [
        check(
            "Lemma 1: I(x; z) = R - KL(q(z) || p(z)), so at most R",
            *(b.information_xz, b.rate - b.marginal_kl, b.marginal_kl, b.rate),
        ),
        check(
            "Lemma 2: I(z; y) is at least E log p(y|z) + h(y)",
            *(b.information_zy, b.log_likelihood + b.entropy_y + b.decoder_kl, b.decoder_kl, b.log_likelihood),
        ),
        check(
            "Theorem 1: the IB objective is at most its variational bound",
            *(b.objective, b.bound - b.gap, b.gap, b.bound),
        ),
    ]

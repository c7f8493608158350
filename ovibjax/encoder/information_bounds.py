"""The paper's information bounds in numbers (Lemmas 1 and 2, Theorem 1), on a model where both sides have closed forms.

Features, task variable and encoder are linear-Gaussian, so that both sides of every inequality are exact and its gap is
the divergence its proof drops. The two sides are computed along different routes, never one from the other: that the
identities hold is a result. Covariances enter as triangular factors of stacked square roots, never as sums of a large
and a small matrix: float32 stays adequate for coordinates that are nearly noiseless.
"""

import itertools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular


class LinearGaussian(NamedTuple):
    """Features x ~ N(0, x_cov), task variable y = y_map x + N(0, y_cov), encoder q(z|x) = N(encoder x + bias, noise).

    y and z depend on each other through x alone, the paper's Markov chain y - x - z.

    Attributes:
        x_cov: [n, n] covariance of the features, positive definite.
        y_map: [3, n] regression of the task variable on the features.
        y_cov: [3, 3] covariance of y given x, positive definite.
        encoder: [K, n] posterior-mean map.
        bias: [K] posterior mean at x = 0.
        noise_var: [K] posterior variances sigma^2, positive.
    """

    x_cov: jax.Array
    y_map: jax.Array
    y_cov: jax.Array
    encoder: jax.Array
    bias: jax.Array
    noise_var: jax.Array


class Decoder(NamedTuple):
    """Variational decoder p_theta(y|z) = N(map z + offset, cov).

    Attributes:
        map: [3, K].
        offset: [3].
        cov: [3, 3], positive definite.
    """

    map: jax.Array
    offset: jax.Array
    cov: jax.Array


class Bounds(NamedTuple):
    """Both sides of the two lemmas and of the theorem, scalars in nats.

    Lemma 1: `information_xz` = `rate` - `marginal_kl` <= `rate` (paper, eqs. "chain_rule_exact" and "rate_upper").
    Lemma 2: `information_zy` = `log_likelihood` + `entropy_y` + `decoder_kl` >= `log_likelihood` + `entropy_y`
    (paper, eq. "izy_bound").
    Theorem 1: `objective` = `bound` - `gap` <= `bound`, for beta >= 0 (paper, eq. "vib_upper").

    Attributes:
        information_xz: I(x; z).
        rate: R = E KL(q(z|x) || p(z)) from the standard normal prior, the loss term of the encoder.
        marginal_kl: KL(q(z) || p(z)) of the induced marginal.
        information_zy: I(z; y).
        information_xy: I(x; y), the most that any encoder can keep of y.
        log_likelihood: E log p_theta(y|z); differential, of either sign.
        entropy_y: h(y); differential, of either sign.
        decoder_kl: E KL(p(y|z) || p_theta(y|z)), zero for the exact decoder alone.
        objective: L_IB = beta I(x; z) - I(z; y) (paper, eq. "OP:IB").
        bound: beta R - E log p_theta(y|z) - h(y); without the constant h(y) what is trained (paper, eq. "vib_obj").
        gap: beta KL(q(z) || p(z)) + E KL(p(y|z) || p_theta(y|z)).
    """

    information_xz: jax.Array
    rate: jax.Array
    marginal_kl: jax.Array
    information_zy: jax.Array
    information_xy: jax.Array
    log_likelihood: jax.Array
    entropy_y: jax.Array
    decoder_kl: jax.Array
    objective: jax.Array
    bound: jax.Array
    gap: jax.Array


def random_model(key: jax.Array, n: int, latent: int) -> LinearGaussian:
    """A well-conditioned random model.

    Args:
        key: random key.
        n: dimension of the features.
        latent: latent dimension K; may exceed n.

    Returns:
        float32 leaves; posterior variances between exp(-4) and 1, the prior's.
    """
    key_normal, key_noise = jax.random.split(key)
    # One draw for all: each costs about a second to compile.
    normal = jax.random.normal(key_normal, (n * n + 9 + 3 * n + latent * n + latent,), jnp.float32)
    ends = list(itertools.accumulate((n * n, 9, 3 * n, latent * n)))
    half_x, half_y, y_map, encoder, bias = jnp.split(normal, ends)
    half_x = half_x.reshape(n, n) / math.sqrt(n)
    half_y = 0.2 * half_y.reshape(3, 3)
    with jax.default_matmul_precision("float32"):
        return LinearGaussian(
            x_cov=half_x @ half_x.T + 0.1 * jnp.eye(n, dtype=jnp.float32),
            y_map=y_map.reshape(3, n) / math.sqrt(n),
            y_cov=half_y @ half_y.T + 0.05 * jnp.eye(3, dtype=jnp.float32),
            encoder=encoder.reshape(latent, n) / math.sqrt(n),
            bias=0.5 * bias,
            noise_var=jnp.exp(jax.random.uniform(key_noise, (latent,), jnp.float32, -4.0, 0.0)),
        )


def _root(*halves: jax.Array) -> jax.Array:
    """Lower triangular L with L L^T the sum of H H^T over the halves H [m, .]; its diagonal may be negative."""
    return jnp.linalg.qr(jnp.concatenate(halves, axis=1).T, mode="r").T


def _half_logdet(root: jax.Array) -> jax.Array:
    """Half the log-determinant of L L^T."""
    return jnp.sum(jnp.log(jnp.abs(jnp.diagonal(root))))


def _mahalanobis(root: jax.Array, half: jax.Array) -> jax.Array:
    """Trace of (L L^T)^-1 H H^T."""
    return jnp.sum(solve_triangular(root, half, lower=True) ** 2)


def exact_decoder(model: LinearGaussian) -> Decoder:
    """The posterior p(y|z) of the model, for which Lemma 2 is an equality.

    Args:
        model: the model.

    Returns:
        The decoder of least bound.
    """
    with jax.default_matmul_precision("float32"):
        half_x = jnp.linalg.cholesky(model.x_cov)
        latent = model.bias.shape[0]
        # The root of the covariance of (z, y) in blocks: [[root of z, 0], [gain times root of z, root of y given z]].
        noise = jnp.diag(jnp.sqrt(model.noise_var))
        top = jnp.concatenate([model.encoder @ half_x, noise, jnp.zeros((latent, 3), noise.dtype)], axis=1)
        low = [model.y_map @ half_x, jnp.zeros((3, latent), noise.dtype), jnp.linalg.cholesky(model.y_cov)]
        root = _root(jnp.concatenate([top, jnp.concatenate(low, axis=1)]))
        gain = solve_triangular(root[:latent, :latent], root[latent:, :latent].T, lower=True, trans=1).T
        residual = root[latent:, latent:]
        return Decoder(map=gain, offset=-gain @ model.bias, cov=residual @ residual.T)


def bounds(model: LinearGaussian, decoder: Decoder, beta: jax.Array | float) -> Bounds:
    """Every term of Lemmas 1 and 2 and Theorem 1; can be jitted, vmapped and differentiated in the decoder.

    Args:
        model: features, task variable and encoder.
        decoder: any decoder, exact or not.
        beta: weight of the rate, not negative.

    Returns:
        float32 scalars.
    """
    with jax.default_matmul_precision("float32"):
        half_x = jnp.linalg.cholesky(model.x_cov)
        exact = exact_decoder(model)
        half_noise = jnp.diag(jnp.sqrt(model.noise_var))
        half_z = model.encoder @ half_x
        half_y = model.y_map @ half_x
        root_noise_y, root_decoder = jnp.linalg.cholesky(model.y_cov), jnp.linalg.cholesky(decoder.cov)
        half_logdet_y = _half_logdet(_root(half_y, root_noise_y))
        # The covariance of x given z is X (I + G^T G)^-1 X^T, with G = noise^-1/2 encoder X and X X^T = x_cov.
        snr = half_z / jnp.sqrt(model.noise_var)[:, None]
        root_snr = _root(snr.T, jnp.eye(snr.shape[1], dtype=snr.dtype))
        half_y_given_z = solve_triangular(root_snr, half_y.T, lower=True).T
        size = jnp.asarray(model.bias.shape[0], half_z.dtype)

        # I(x; z) on the side of x, KL(q(z) || p) on the side of z: two determinants, n by n and K by K.
        information_xz = _half_logdet(root_snr)
        second_moment = jnp.sum(half_z**2) + jnp.sum(model.bias**2) + jnp.sum(model.noise_var)
        rate = 0.5 * (second_moment - jnp.sum(jnp.log(model.noise_var)) - size)
        marginal_kl = 0.5 * (second_moment - size) - _half_logdet(_root(half_z, half_noise))

        information_zy = half_logdet_y - _half_logdet(_root(half_y_given_z, root_noise_y))
        # The likelihood needs the error of the decoder, its divergence the difference from the exact posterior mean.
        shift = (decoder.map @ model.bias + decoder.offset)[:, None]
        error = jnp.concatenate([half_y - decoder.map @ half_z, root_noise_y, decoder.map @ half_noise, shift], axis=1)
        half_logdet_decoder = _half_logdet(root_decoder)
        log_likelihood = -1.5 * math.log(2 * math.pi) - half_logdet_decoder - 0.5 * _mahalanobis(root_decoder, error)
        change = exact.map - decoder.map
        difference = jnp.concatenate([change @ half_z, change @ half_noise, shift], axis=1)
        root_exact = jnp.linalg.cholesky(exact.cov)
        spread = _mahalanobis(root_decoder, root_exact) + _mahalanobis(root_decoder, difference)
        decoder_kl = 0.5 * (spread - 3.0) + half_logdet_decoder - _half_logdet(root_exact)

        entropy_y = 1.5 * math.log(2 * math.pi * math.e) + half_logdet_y
        return Bounds(
            information_xz=information_xz,
            rate=rate,
            marginal_kl=marginal_kl,
            information_zy=information_zy,
            information_xy=half_logdet_y - _half_logdet(root_noise_y),
            log_likelihood=log_likelihood,
            entropy_y=entropy_y,
            decoder_kl=decoder_kl,
            objective=beta * information_xz - information_zy,
            bound=beta * rate - log_likelihood - entropy_y,
            gap=beta * marginal_kl + decoder_kl,
        )

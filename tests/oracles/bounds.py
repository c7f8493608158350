"""Linear-Gaussian informations in float64 from blocks of one joint covariance, and samples of the same model."""

import math

import numpy as np
from scipy import stats


def joint(model):
    """Mean and covariance of (x, z, y) stacked, with the three index blocks.

    The stack is a linear map of independent sources: standard normals behind x, z's noise, y's noise.
    """
    x_cov, y_map, y_cov, encoder, bias, noise_var = (np.asarray(leaf, np.float64) for leaf in model)
    n, latent = len(x_cov), len(bias)
    root = np.linalg.cholesky(x_cov)
    rows = [
        np.hstack([root, np.zeros((n, latent)), np.zeros((n, 3))]),
        np.hstack([encoder @ root, np.diag(np.sqrt(noise_var)), np.zeros((latent, 3))]),
        np.hstack([y_map @ root, np.zeros((3, latent)), np.linalg.cholesky(y_cov)]),
    ]
    sources = np.vstack(rows)
    mean = np.concatenate([np.zeros(n), bias, np.zeros(3)])
    return mean, sources @ sources.T, (range(n), range(n, n + latent), range(n + latent, n + latent + 3))


def entropy(cov, *blocks):
    """Differential entropy of some coordinates."""
    index = [i for block in blocks for i in block]
    return stats.multivariate_normal(np.zeros(len(index)), cov[np.ix_(index, index)]).entropy()


def divergence(mean_p, cov_p, mean_q, cov_q):
    """KL(N(mean_p, cov_p) || N(mean_q, cov_q))."""
    inverse, delta = np.linalg.inv(cov_q), mean_q - mean_p
    logdets = np.linalg.slogdet(cov_q)[1] - np.linalg.slogdet(cov_p)[1]
    return 0.5 * (np.trace(inverse @ cov_p) + delta @ inverse @ delta - len(delta) + logdets)


def posterior(model):
    """Map, offset and covariance of p(y|z) by conditioning the joint covariance."""
    mean, cov, (_, z, y) = joint(model)
    gain = np.linalg.solve(cov[np.ix_(z, z)], cov[np.ix_(z, y)]).T
    return gain, -gain @ mean[z], cov[np.ix_(y, y)] - gain @ cov[np.ix_(z, y)]


def bounds(model, decoder, beta):
    """Every field of `ovibjax.encoder.information_bounds.Bounds` by name."""
    mean, cov, (x, z, y) = joint(model)
    gain, offset, decoder_cov = (np.asarray(leaf, np.float64) for leaf in decoder)
    latent = len(z)
    out = {"information_xz": entropy(cov, x) + entropy(cov, z) - entropy(cov, x, z)}
    out["information_zy"] = entropy(cov, z) + entropy(cov, y) - entropy(cov, z, y)
    out["information_xy"] = entropy(cov, x) + entropy(cov, y) - entropy(cov, x, y)
    out["entropy_y"] = entropy(cov, y)
    out["marginal_kl"] = divergence(mean[z], cov[np.ix_(z, z)], np.zeros(latent), np.eye(latent))
    # Cross-entropy of q(z) and the prior, less the entropy of q(z|x).
    cross = 0.5 * (latent * math.log(2 * math.pi) + np.trace(cov[np.ix_(z, z)]) + mean[z] @ mean[z])
    out["rate"] = cross - (entropy(cov, x, z) - entropy(cov, x))
    # Residual y - map z - offset as a linear map of (z, y).
    zy = [*z, *y]
    residual = np.hstack([-gain, np.eye(3)])
    error = residual @ mean[zy] - offset
    moment = residual @ cov[np.ix_(zy, zy)] @ residual.T + np.outer(error, error)
    log_normaliser = 0.5 * (3 * math.log(2 * math.pi) + np.linalg.slogdet(decoder_cov)[1])
    out["log_likelihood"] = -log_normaliser - 0.5 * np.trace(np.linalg.solve(decoder_cov, moment))
    exact_gain, exact_offset, exact_cov = posterior(model)
    # The divergence at the mean of z, and the spread of the two posterior means over z.
    change = gain - exact_gain
    spread = np.trace(np.linalg.solve(decoder_cov, change @ cov[np.ix_(z, z)] @ change.T))
    at_mean = divergence(exact_gain @ mean[z] + exact_offset, exact_cov, gain @ mean[z] + offset, decoder_cov)
    out["decoder_kl"] = at_mean + 0.5 * spread
    out["objective"] = beta * out["information_xz"] - out["information_zy"]
    out["bound"] = beta * out["rate"] - out["log_likelihood"] - out["entropy_y"]
    out["gap"] = out["bound"] - out["objective"]
    return out


def sample(model, count, seed):
    """Draws of x, z, y along the Markov chain y - x - z, float64."""
    x_cov, y_map, y_cov, encoder, bias, noise_var = (np.asarray(leaf, np.float64) for leaf in model)
    rng = np.random.default_rng(seed)
    x = rng.multivariate_normal(np.zeros(len(x_cov)), x_cov, count)
    z = x @ encoder.T + bias + np.sqrt(noise_var) * rng.normal(size=(count, len(bias)))
    y = x @ y_map.T + rng.multivariate_normal(np.zeros(3), y_cov, count)
    return x, z, y


def samples_of_terms(model, decoder, count, seed):
    """One sample mean's worth of each expectation: name -> [count] values, from densities alone."""
    x, z, y = sample(model, count, seed)
    mean, cov, (_, z_block, y_block) = joint(model)
    gain, offset, decoder_cov = (np.asarray(leaf, np.float64) for leaf in decoder)
    encoder, bias, noise_var = (np.asarray(leaf, np.float64) for leaf in model[3:])
    normal, zy = stats.multivariate_normal, [*z_block, *y_block]
    log_q_given_x = stats.norm.logpdf(z, x @ encoder.T + bias, np.sqrt(noise_var)).sum(axis=1)
    log_q = normal(mean[z_block], cov[np.ix_(z_block, z_block)]).logpdf(z)
    log_prior = stats.norm.logpdf(z).sum(axis=1)
    log_y = normal(np.zeros(3), cov[np.ix_(y_block, y_block)]).logpdf(y)
    log_zy = normal(mean[zy], cov[np.ix_(zy, zy)]).logpdf(np.hstack([z, y]))
    log_decoder = normal(np.zeros(3), decoder_cov).logpdf(y - z @ gain.T - offset)
    return {
        "information_xz": log_q_given_x - log_q,
        "rate": log_q_given_x - log_prior,
        "marginal_kl": log_q - log_prior,
        "information_zy": log_zy - log_q - log_y,
        "log_likelihood": log_decoder,
        "entropy_y": -log_y,
        "decoder_kl": log_zy - log_q - log_decoder,
    }

"""The encoder of the paper in plain float64 NumPy: rate terms, masks, objective, network, AdamW."""

import itertools
import math

import numpy as np
from scipy import integrate, special

from ovibjax.encoder.model import dense_layers

MODES = {"F": [0], "FS": [0, 2, 3], "H4": [0, 1, 2, 3], "A5": [0, 1, 2, 3, 4]}


def gaussian_kl(mu, logvar):
    """Eq. "rate_term" for each row, summed over the last axis."""
    mu, logvar = np.asarray(mu, np.float64), np.asarray(logvar, np.float64)
    sigma2 = np.exp(logvar)
    return 0.5 * (mu**2 + sigma2 - np.log(sigma2) - 1).sum(axis=-1)


def ard_summand(log_alpha):
    """One coordinate of eq. "ardkl" as a function of log alpha."""
    c1, c2, c3 = 0.63576, 1.87320, 1.48695
    log_alpha = np.asarray(log_alpha, np.float64)
    sigm = special.expit(c2 + c3 * log_alpha)
    return 0.5 * np.logaddexp(0.0, -log_alpha) - c1 * sigm + c1


def ard_kl(mu, logvar):
    """Eq. "ardkl"; a mean of zero is the limit alpha -> infinity, where a summand vanishes."""
    mu, logvar = np.broadcast_arrays(np.asarray(mu, np.float64), np.asarray(logvar, np.float64))
    total = np.zeros(mu.shape[:-1])
    for i in np.ndindex(mu.shape):
        if mu[i] != 0:
            total[i[:-1]] += ard_summand(logvar[i] - 2 * math.log(abs(mu[i])))
    return total


def log_uniform_kl(log_alpha):
    """KL(N(mu, sigma^2) || 1/|z|) by quadrature, its additive constant fixed by the limit 0 at alpha -> infinity.

    The divergence is E log|mu + sigma eps| - log sigma + constant. With m = 1/sqrt(alpha) it is E log|m + eps| less
    its value at m = 0, which is E log|eps| = -(Euler's gamma + log 2) / 2.
    """
    m = math.exp(-0.5 * log_alpha)

    def integrand(t):
        pair = math.exp(-0.5 * (t - m) ** 2) + math.exp(-0.5 * (t + m) ** 2)
        return pair / math.sqrt(2 * math.pi) * math.log(t)

    # The logarithm is singular at 0, the bell stands at m.
    edges = sorted({0.0, 1.0, *(max(m + step, 1.0) for step in (-10, -4, 0, 4, 10)), m + 14.0})
    parts = [integrate.quad(integrand, a, b, epsabs=1e-11)[0] for a, b in itertools.pairwise(edges)]
    return sum(parts) + 0.5 * (np.euler_gamma + math.log(2))


def log_uniform_kl_series(log_alpha):
    """The same from the logarithm of a non-central chi-square: a Poisson mixture of digammas."""
    rate = 0.5 * math.exp(-log_alpha)
    j = np.arange(int(rate + 40 * math.sqrt(rate) + 60))
    poisson = np.exp(-rate + special.xlogy(j, rate) - special.gammaln(j + 1))
    mean_log_square = math.log(2) + (poisson * special.digamma(0.5 + j)).sum()
    return 0.5 * mean_log_square + 0.5 * (np.euler_gamma + math.log(2))


def active_dims(mu, logvar, threshold):
    """Coordinates whose noise-to-signal ratio, averaged over samples, is at most exp(threshold)."""
    count = 0
    for i in range(mu.shape[1]):
        noise = np.exp(np.asarray(logvar[:, i], np.float64)).mean()
        signal = (np.asarray(mu[:, i], np.float64) ** 2).mean()
        count += noise <= math.exp(threshold) * signal
    return count


def prefix_mask(k, size):
    """Eq. "prefix_mask"."""
    return np.array([1.0] * min(k, size) + [0.0] * max(size - k, 0))


def view_mask(mode, n_views):
    """The view mask m_S."""
    return np.array([1.0 if view in MODES[mode] else 0.0 for view in range(n_views)])


def equal_shares(size, modes, n_views):
    """View masks [B, M] of a batch: example n of B takes mode floor(n Q / B) of Q, those with most views first."""
    ordered = sorted(modes, key=lambda mode: len(MODES[mode]), reverse=True)
    return np.array([view_mask(ordered[n * len(ordered) // size], n_views) for n in range(size)])


def orthogonality(w):
    """Last term of eq. "composite_loss" without gamma."""
    w = np.asarray(w, np.float64)
    size, total = len(w), 0.0
    for i in range(size):
        for j in range(size):
            total += (w[i] @ w[j] - (i == j)) ** 2
    return total / size**2


def composite_loss(batch, weights, prior, w, encode, decode, locate):
    """Eq. "composite_loss", example by example; `encode`, `decode`, `locate` map one vector each.

    `decode` is also told which coordinates were sent.

    Units as documented with the product: squared feature error per view coordinate (divided by r).
    """
    size, _, width = batch["x"].shape
    terms = {"reconstruction": 0.0, "localization": 0.0, "rate": 0.0}
    for n in range(size):
        over_coordinates = np.repeat(batch["view_mask"][n], width)
        x_s = batch["x"][n].reshape(-1) * over_coordinates
        mu, logvar = encode(x_s)
        z = batch["prefix_mask"][n] * (mu + np.exp(logvar) ** 0.5 * batch["noise"][n])
        x_hat = decode(z, batch["prefix_mask"][n]) * over_coordinates
        y_hat = locate(x_hat)
        terms["reconstruction"] += ((x_s - x_hat) ** 2).sum() / width / size
        terms["localization"] += ((batch["y"][n] - y_hat) ** 2).sum() / size
        terms["rate"] += {"gaussian": gaussian_kl, "ard": ard_kl}[prior](mu, logvar) / size
    terms["orthogonality"] = orthogonality(w)
    loss = terms["reconstruction"] + weights["alpha"] * terms["localization"]
    return loss + weights["beta"] * terms["rate"] + weights["gamma"] * terms["orthogonality"], terms


def _dense(layer, x):
    out = x @ np.asarray(layer["kernel"], np.float64)
    return out + np.asarray(layer["bias"], np.float64) if "bias" in layer else out


def gelu(x):
    """Gaussian error linear unit in its usual tanh form (Hendrycks and Gimpel)."""
    return 0.5 * x * (1 + np.tanh(math.sqrt(2 / math.pi) * (x + 0.044715 * x**3)))


def encode(params, x, activation=gelu):
    """Mean and log-variance of the posterior."""
    p, x = dense_layers(params), np.asarray(x, np.float64)
    hidden = _dense(p["encoder_2"], activation(_dense(p["encoder_1"], x)))
    hidden = hidden + _dense(p["direct"], x) if "direct" in p else activation(hidden)
    logvar = _dense(p["logvar"], 0.1 * hidden if "direct" in p else hidden)
    return _dense(p["mean"], hidden), np.clip(logvar, -12.0, 6.0)


def decode(params, z, activation=gelu, sent=None, wave=np.sin):
    """Descriptor of a latent of which the first `sent` coordinates came, all by default."""
    p, z = dense_layers(params), np.array(z, np.float64)
    sent = z.shape[-1] if sent is None else sent
    z[..., sent:] = 0.0
    hidden = (wave if "principal" in p else activation)(_dense(p["decoder_1"], z))
    hidden = activation(_dense(p["decoder_2"], hidden))
    if "principal" not in p:
        return _dense(p["descriptor"], hidden)
    coordinates = np.zeros((*z.shape[:-1], len(p["principal"]["kernel"])))
    coordinates[..., : z.shape[-1]] = z
    if "completion" not in p:
        return _dense(p["descriptor"], hidden) + _dense(p["principal"], coordinates)
    coordinates[..., sent:] = _dense(p["completion"], hidden)[..., sent:]
    return _dense(p["principal"], coordinates)


def locate(params, descriptor, activation=gelu):
    """Position from a descriptor."""
    p = dense_layers(params)
    return _dense(p["head_2"], activation(_dense(p["head_1"], np.asarray(descriptor, np.float64))))


def learning_rate(step, peak, warmup, total):
    """Linear warm-up that reaches the peak at step `warmup`, then a straight line to zero at `total`."""
    if step < warmup:
        return peak * (step + 1) / warmup
    return peak * (total - step) / (total - warmup)


def adamw(param, grads, rates, weight_decay, b1=0.9, b2=0.999, eps=1e-8):
    """Every iterate of AdamW (Loshchilov and Hutter) from `param` along the given gradients."""
    param = np.asarray(param, np.float64)
    m, v, path = np.zeros_like(param), np.zeros_like(param), []
    for t, (grad, rate) in enumerate(zip(grads, rates, strict=True), start=1):
        m = b1 * m + (1 - b1) * grad
        v = b2 * v + (1 - b2) * grad**2
        step = (m / (1 - b1**t)) / (np.sqrt(v / (1 - b2**t)) + eps)
        param = param - rate * (step + weight_decay * param)
        path.append(param)
    return path


def code_bits(z, step, mean, width):
    """-log2 of the Gaussian's mass within half a step of z, by complementary error functions."""
    z, step, mean, width = np.broadcast_arrays(*(np.asarray(part, np.float64) for part in (z, step, mean, width)))
    away = np.abs(z - mean)
    upper, lower = ((away + sign * step / 2) / width / math.sqrt(2) for sign in (-1, 1))
    mass = 0.5 * (special.erfc(upper) - special.erfc(lower))
    # In the far tail, where the mass is no float: the density at the near edge, over its logarithmic slope.
    near = upper * math.sqrt(2)
    tail = (
        0.5 * near**2
        + 0.5 * math.log(2 * math.pi)
        + np.log(np.maximum(near, 1))
        + np.log1p(1 / np.maximum(near, 1) ** 2)
    )
    with np.errstate(divide="ignore"):
        return np.where(near > 30, tail, -np.log(mass)) / math.log(2)

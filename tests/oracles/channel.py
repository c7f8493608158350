"""The uplink of the paper in plain float64 or exact arithmetic: rate, gain, fading, traces on a fine grid."""

import itertools
import math
from decimal import Decimal, localcontext
from fractions import Fraction

from scipy import integrate, special, stats


def rate_bps(gain, bandwidth_hz, power_w, noise_w_per_hz):
    """R = B log2(1 + P g / (N0 B)) with 60 digits, so that no SNR is too small for the plain formula."""
    with localcontext() as context:
        context.prec = 60
        g, b, p, n = (Decimal(float(value)) for value in (gain, bandwidth_hz, power_w, noise_w_per_hz))
        return float(b * (1 + p * g / (n * b)).ln() / Decimal(2).ln())


def path_gain_db(distance_m, g0, rho0_m, kappa, shadowing_db, fading_power):
    """The gain as a link budget: every factor of the paper's product is a term in dB."""
    path_db = 10 * math.log10(g0) - 10 * kappa * math.log10(distance_m / rho0_m)
    return path_db + shadowing_db + 10 * math.log10(fading_power)


def fading_distribution(k_factor):
    """|h|^2 of mean 1: a non-central chi-square of two degrees of freedom, exponential without a direct path."""
    scale = 1 / (2 * (1 + k_factor))
    return stats.ncx2(2, 2 * k_factor, scale=scale) if k_factor else stats.expon()


def ergodic_bps_per_hz(snr, k_factor):
    """E[log2(1 + snr |h|^2)] by quadrature over the density of |h|^2, its Bessel function scaled against overflow."""
    k = k_factor

    def integrand(x):
        bell = math.exp(-((math.sqrt(k) - math.sqrt((1 + k) * x)) ** 2))
        density = (1 + k) * bell * special.ive(0, 2 * math.sqrt(k * (1 + k) * x))
        return math.log1p(snr * x) / math.log(2) * density

    # The logarithm bends at 1 / snr, the density stands around 1.
    edges = [0.0, 1e-5, 1e-3, 0.1, 0.5, 0.8, 1.0, 1.2, 1.5, 2.5, 6.0, 60.0]
    parts = [integrate.quad(integrand, a, b, epsabs=1e-12 * snr, epsrel=1e-9)[0] for a, b in itertools.pairwise(edges)]
    return sum(parts)


def profile_rate_bps(fading_power, mean_kb_per_s, snr, k_factor, depth):
    """Constant profile and faded profile of the same mean, mixed by depth."""
    mean_bps = mean_kb_per_s * 1024 * 8
    faded_bps = mean_bps * math.log2(1 + snr * fading_power) / ergodic_bps_per_hz(snr, k_factor)
    return (1 - depth) * mean_bps + depth * faded_bps


def resample(tick_times, rates, slot_ticks, n_slots, start_ticks):
    """Mean rate per slot of a trace whose times and slots are whole ticks, one exact sum over ticks per slot.

    Args:
        tick_times: increasing integers; the rate of a sample holds since the sample before it.
        rates: one per time.
        slot_ticks: ticks in a slot.
        n_slots: number of slots.
        start_ticks: ticks from the first sample to the first slot.

    Returns:
        One float per slot, the trace repeated end to end.
    """
    grid = []
    for before, after, rate in zip(tick_times, tick_times[1:], rates[1:], strict=False):
        grid += [Fraction(rate)] * (after - before)
    means = []
    for slot in range(n_slots):
        begin = start_ticks + slot * slot_ticks
        means.append(float(sum(grid[tick % len(grid)] for tick in range(begin, begin + slot_ticks)) / slot_ticks))
    return means

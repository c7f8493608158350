"""Long random traces against closed forms of queueing theory: mean waits and Little's law."""

import numpy as np
import pytest

from ovibjax.scheduling.replay_grid import run_grid
from ovibjax.scheduling.requests import RequestTrace
from ovibjax.scheduling.rules import default_params
from tests.scheduling.random_requests import stack

RUNS, N = 48, 12_000
WARM = N // 10
"""Requests left out at the start: the queue begins empty."""


def make_trace(seed, arrivals_per_ms, service_ms, deadline_ms):
    """Poisson arrivals; deadlines far longer than any wait make classes of them, for EDF."""
    rng = np.random.default_rng(seed)
    ones = np.ones(N, np.float32)
    return RequestTrace(
        client=np.arange(N, dtype=np.int32) % 16,
        ready_ms=np.cumsum(rng.exponential(1.0 / arrivals_per_ms, N)),
        service_ms=service_ms(rng),
        service_est_ms=10.0 * np.ones(N),
        deadline_ms=deadline_ms(rng),
        voi_m=ones,
        drift_m_per_s=ones,
        risk_m=ones,
        delay_est_ms=ones,
        urgency=ones,
        valid=np.ones(N, bool),
    )


def waits_of(traces, policy):
    found = run_grid(stack(traces), policy, default_params())
    return np.asarray(found, np.float64)[:, 0, WARM:]


def exponential(mean_ms):
    return lambda rng: rng.exponential(mean_ms, N)


@pytest.mark.parametrize("load", [0.3, 0.6])
def test_mean_wait_of_an_m_m_1_queue(load):
    mean_ms = 10.0
    traces = [
        make_trace(seed, load / mean_ms, exponential(mean_ms), lambda rng: np.full(N, 75.0)) for seed in range(RUNS)
    ]
    assert waits_of(traces, "fifo").mean() == pytest.approx(load / (1.0 - load) * mean_ms, rel=0.02)


@pytest.mark.parametrize("policy", ["fifo", pytest.param("edf", marks=pytest.mark.slow)])
def test_little_s_law(policy):
    """Requests found waiting by a Poisson arrival = arrival rate x mean wait, counted from the start times."""
    arrivals_per_ms = 0.06
    traces = [
        make_trace(seed, arrivals_per_ms, exponential(10.0), lambda rng: rng.uniform(20.0, 400.0, N))
        for seed in range(8)
    ]
    ready_ms = np.stack([trace.ready_ms for trace in traces])[:, WARM:]
    waits_ms = waits_of(traces, policy)
    found = []
    for ready, wait in zip(ready_ms, waits_ms, strict=True):
        begun = np.searchsorted(np.sort(ready + wait), ready, side="right")
        found.append(np.arange(len(ready)) - begun + (wait == 0.0))  # its own start is not another's
    assert np.max(found) > 10
    assert np.mean(found) == pytest.approx(arrivals_per_ms * waits_ms.mean(), rel=0.02)


@pytest.mark.long
def test_two_classes_with_non_preemptive_priority():
    """Cobham: W_1 = R / (1 - rho_1), W_2 = R / ((1 - rho_1)(1 - rho_1 - rho_2)), R = lambda E[S^2] / 2.

    EDF with deadlines of 1 ms and an hour: the urgent class always goes first, first come first served within it.
    """
    arrivals_per_ms, share, fixed_ms, mean_ms = 0.06, 0.4, 8.0, 12.0
    far_ms = 3.6e6

    def urgent_of(seed):
        return np.random.default_rng(1000 + seed).random(N) < share

    def one(seed):
        urgent = urgent_of(seed)
        return make_trace(
            seed,
            arrivals_per_ms,
            lambda rng: np.where(urgent, fixed_ms, rng.exponential(mean_ms, N)),
            lambda rng: np.where(urgent, 1.0, far_ms),
        )

    found = waits_of([one(seed) for seed in range(RUNS)], "edf")
    urgent = np.stack([urgent_of(seed)[WARM:] for seed in range(RUNS)])
    first, second = arrivals_per_ms * share, arrivals_per_ms * (1 - share)
    rho_1, rho_2 = first * fixed_ms, second * mean_ms
    residual_ms = (first * fixed_ms**2 + second * 2.0 * mean_ms**2) / 2.0
    assert found[urgent].mean() == pytest.approx(residual_ms / (1 - rho_1), rel=0.02)
    assert found[~urgent].mean() == pytest.approx(residual_ms / ((1 - rho_1) * (1 - rho_1 - rho_2)), rel=0.02)

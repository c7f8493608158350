"""Stationary randomized policies, the benchmark of the scheduler's theorem (paper, Theorem "voi_scheduler").

Request attributes are independent across slots: each slot draws one of S equally likely joint states. Then the best
stationary randomized policy is a linear program over pairs of a state and a subset that fits.
"""

from typing import Any, NamedTuple

import jax
import numpy as np
import numpy.typing as npt
from jax.typing import ArrayLike
from scipy import sparse
from scipy.optimize import OptimizeResult, linprog
from scipy.special import ndtri

from ovibjax.control.actions import CONTROL_PREFIXES
from ovibjax.link.payload import request_bytes
from ovibjax.views import MODES

Array = jax.Array | npt.NDArray[Any]


class SlottedSystem(NamedTuple):
    """Joint states of all clients' head-of-line requests, equally likely in every slot, and the budgets of a slot.

    Attributes:
        payload: [S, N] int32, bytes.
        service: [S, N] int32, microseconds; integers, so that program and optimizer agree on what fits.
        voi: [S, N] float32, metres, positive.
        payload_budget: int32, bytes.
        service_budget: int32, microseconds.
    """

    payload: Array
    service: Array
    voi: Array
    payload_budget: ArrayLike
    service_budget: ArrayLike


class Benchmark(NamedTuple):
    """The best stationary randomized policy for given arrival rates.

    Attributes:
        utility: expected utility, metres per slot.
        price: [N] float64, utility lost per unit of a client's arrival rate, metres per request.
    """

    utility: float
    price: npt.NDArray[np.float64]


def draw_system(
    key: jax.Array, states: int, clients: int, payload_budget: int = 400, service_budget: int = 100_000
) -> SlottedSystem:
    """Random joint states: a request has any mode and prefix, and richer ones are worth more on average.

    Args:
        key: random key.
        states: number of states S.
        clients: number of clients N.
        payload_budget: bytes per slot.
        service_budget: microseconds per slot.

    Returns:
        The system, on the host.
    """
    # One draw, the rest in NumPy: each further kind of random number would be a program of its own to compile.
    uniform = np.asarray(jax.random.uniform(key, (4 * states + 1, clients)), np.float64)
    u_mode, u_prefix, u_jitter, u_voi = uniform[:-1].reshape(4, states, clients)
    view_counts = np.array(sorted(map(len, MODES.values())))
    n_views = view_counts[(len(view_counts) * u_mode).astype(int)]
    prefixes = np.array(CONTROL_PREFIXES)
    payload = request_bytes(prefixes[(len(prefixes) * u_prefix).astype(int)], n_views)
    least, most = (int(request_bytes(int(end(prefixes)), end(view_counts))) for end in (min, max))
    richness = (payload - least) / (most - least)
    scale_m = 4.0 + 4.0 * uniform[-1]
    voi = scale_m * (0.05 + richness) * (1.0 - u_voi)
    # The replay's decoding, retrieval, runtime and lognormal jitter; 4 ms per view stand for computing.
    jitter_ms = 2.2 * np.exp(0.5 * ndtri(1.0 - u_jitter))
    service_us = 1000.0 * (3.1 + 5.2 + 4.0 + np.minimum(jitter_ms, 10.0) + 4.0 * n_views)
    return SlottedSystem(
        payload.astype(np.int32),
        service_us.round().astype(np.int32),
        voi.astype(np.float32),
        np.int32(payload_budget),
        np.int32(service_budget),
    )


def best_stationary(system: SlottedSystem, rate: npt.ArrayLike, exactly: bool) -> Benchmark:
    """Largest expected utility of a policy that serves each client at least, or exactly, at its arrival rate.

    Args:
        system: the system.
        rate: [N] requests per slot.
        exactly: whether rates are met exactly, the most that policies can have which serve pending requests only.

    Returns:
        Utility and prices.

    Raises:
        ValueError: rates outside the capacity region.
    """
    program = _Program(system)
    rate = np.asarray(rate, np.float64)
    gain = -(program.members * np.asarray(system.voi, np.float64)[program.state]).sum(axis=1) / program.states
    if exactly:
        found = linprog(gain, A_eq=sparse.vstack([program.once, program.rates]), b_eq=np.r_[program.ones, rate])
    else:
        found = linprog(gain, A_ub=-program.rates, b_ub=-rate, A_eq=program.once, b_eq=program.ones)
    _check(found, f"no policy serves arrivals at {rate.round(3).tolist()} requests per slot")
    price = found.eqlin.marginals[program.states :] if exactly else -found.ineqlin.marginals
    return Benchmark(-float(found.fun), np.asarray(price, np.float64))


def capacity(system: SlottedSystem, direction: npt.ArrayLike) -> float:
    """Edge of the capacity region: the largest multiple of some arrival rates that a policy can serve.

    Args:
        system: the system.
        direction: [N] positive rates.

    Returns:
        The multiple.
    """
    program = _Program(system)
    load = sparse.csr_matrix(np.asarray(direction, np.float64)[:, None])
    none = sparse.csr_matrix((program.states, 1))
    found = linprog(
        np.r_[np.zeros(len(program.state)), -1.0],
        A_ub=sparse.hstack([-program.rates, load]),
        b_ub=np.zeros(load.shape[0]),
        A_eq=sparse.hstack([program.once, none]),
        b_eq=program.ones,
    )
    _check(found, "the capacity program failed")
    return -float(found.fun)


def least_growth(system: SlottedSystem, rate: npt.ArrayLike) -> float:
    """Requests per slot by which the total backlog grows under any policy: the least sum of unserved rates.

    Args:
        system: the system.
        rate: [N] requests per slot.

    Returns:
        Zero inside the capacity region, positive outside.
    """
    program = _Program(system)
    clients = program.members.shape[1]
    found = linprog(
        np.r_[np.zeros(len(program.state)), np.ones(clients)],
        A_ub=sparse.hstack([-program.rates, -sparse.eye(clients)]),
        b_ub=-np.asarray(rate, np.float64),
        A_eq=sparse.hstack([program.once, sparse.csr_matrix((program.states, clients))]),
        b_eq=program.ones,
    )
    _check(found, "the growth program failed")
    return float(found.fun)


def drift_constant(system: SlottedSystem, rate: npt.ArrayLike) -> float:
    """C_0 of eq. "drift", explicitly: half the expected sum of A^2 + x^2, with as many served as fit.

    Args:
        system: the system.
        rate: [N] requests per slot.

    Returns:
        The constant; the theorem's utility gap is at most C_0 / V.
    """
    program = _Program(system)
    served = np.zeros(program.states)
    np.maximum.at(served, program.state, program.members.sum(axis=1))
    return 0.5 * (float(np.sum(rate)) + float(served.mean()))


class _Program:
    """Variables of all programs, one per state and subset that fits: the probability of the subset in that state."""

    def __init__(self, system: SlottedSystem) -> None:
        payload, service = np.asarray(system.payload, np.int64), np.asarray(system.service, np.int64)
        self.states, clients = payload.shape
        subsets = (np.arange(2**clients)[:, None] >> np.arange(clients)) & 1
        fits = (payload @ subsets.T <= system.payload_budget) & (service @ subsets.T <= system.service_budget)
        self.state, subset = np.nonzero(fits)
        self.members = subsets[subset]
        at = (self.state, np.arange(len(self.state)))
        self.once = sparse.csr_matrix((np.ones(len(self.state)), at))  # probabilities of a state add up to one
        self.ones = np.ones(self.states)
        self.rates = sparse.csr_matrix(self.members.T / self.states)  # service rate of each client


def _check(found: OptimizeResult, text: str) -> None:
    if found.status != 0:
        raise ValueError(f"{text}: {found.message}")

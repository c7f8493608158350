"""Readings of the scheduler's theorem, and what it promises of each, in numbers (paper, Theorem "voi_scheduler").

The paper's proof compares, in every slot, with a policy that may choose any client, also one without pending requests,
and the utility counts its value. Eq. "voi_scheduler" chooses within R_t, the clients with pending requests, so the
comparison lacks the values of the others: stability and an O(V) backlog survive this, the utility bound does not in
general. It does again if no value is positive, because then nothing is gained by an empty queue.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np
import numpy.typing as npt

from ovibjax.scheduling.slotted_replay import Case
from ovibjax.scheduling.stationary import SlottedSystem, best_stationary, drift_constant

READINGS = ("proof", "pending", "shifted")
_SLACKS = (0.1, 0.99)


@dataclass(frozen=True)
class Setting:
    """One reading of the theorem at one load.

    Attributes:
        reading: `proof`, empty queues may be chosen and count, and the benchmark serves each client at least at its
            arrival rate; `pending`, eq. "voi_scheduler" with R_t, and the benchmark serves exactly at the arrival
            rates, the most that any stabilizing policy can have which serves pending requests only; `shifted`, as
            `pending`, but the optimizer sees each value less the client's largest.
        load: arrival rates as a share of the largest that can be served.
    """

    reading: str
    load: float

    @property
    def name(self) -> str:
        """Label of the setting."""
        return f"{self.reading}_{self.load:g}"


class Promise(NamedTuple):
    """What the theorem says about one setting of one system.

    Attributes:
        best: [V] utility of the benchmark, metres per slot.
        gap_bound: [V] bound of the utility gap, metres per slot.
        backlog_bound: [V] bound of the total backlog.
    """

    best: npt.NDArray[np.float64]
    gap_bound: npt.NDArray[np.float64]
    backlog_bound: npt.NDArray[np.float64]


def make_case(
    system: SlottedSystem, edge: npt.NDArray[np.float64], setting: Setting, vs: npt.NDArray[np.float64]
) -> tuple[Case, Promise]:
    """One setting of one system, and what the theorem promises of it.

    The gap is at most C_0 / V. The bound of the backlog follows from comparing with a policy that serves each client by
    a slack above its rate, (C_0 + V (utility - its utility)) / slack, and with R_t (C_0 + V utility) / slack.

    Args:
        system: the system.
        edge: [N] arrival rates at the edge of its capacity region.
        setting: reading and load.
        vs: [V] values of V.

    Returns:
        The case to run, its queues starting where they settle, and the promise.

    Raises:
        ValueError: an unknown reading, or a load of 1 or more.
    """
    if setting.reading not in READINGS or not 0 < setting.load < 1:
        raise ValueError(f"{setting} is not one of {', '.join(READINGS)} at a load between 0 and 1")
    rate = setting.load * edge
    benchmark = best_stationary(system, rate, exactly=setting.reading != "proof")
    constant = drift_constant(system, rate)
    voi = np.asarray(system.voi)
    offset = voi.max(axis=0) if setting.reading == "shifted" else np.zeros_like(voi[0])
    scored = system._replace(voi=voi - offset)
    bounds = []
    for share in _SLACKS:
        slack = share * (edge - rate)
        lost = benchmark.utility
        if setting.reading != "pending":
            lost -= float(offset @ rate) + best_stationary(scored, rate + slack, exactly=False).utility
        bounds.append((constant + vs * lost) / slack.min())
    # From empty queues the way to where they settle takes several V slots.
    start = np.maximum(benchmark.price + offset, 0.0)
    case = _case(rate, setting.reading == "proof", offset, start, benchmark.price)
    return case, Promise(np.full(len(vs), benchmark.utility), constant / vs, np.min(bounds, axis=0))


def empty_case(rate: npt.NDArray[np.float64]) -> Case:
    """Eq. "voi_scheduler" with R_t from empty queues, without a benchmark.

    Args:
        rate: [N] arrival rates.

    Returns:
        The case; gaps of its runs mean nothing.
    """
    nothing = np.zeros(len(rate))
    return _case(rate, False, nothing, nothing, nothing)


def stack(cases: Sequence[Case]) -> Case:
    """Cases with a leading axis."""
    return jax.tree.map(lambda *leaves: np.stack(leaves), *cases)


def _case(rate: npt.NDArray, serve_empty: bool, *vectors: npt.NDArray) -> Case:
    rate, offset, start, price = (vector.astype(np.float32) for vector in (rate, *vectors))
    return Case(rate, np.array(serve_empty), offset, start, price)

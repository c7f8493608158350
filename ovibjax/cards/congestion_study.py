"""Scheduling rules under congestion: the paper's three levels by how ties are broken, other loads, phase spreads."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.cards.scheduling_study import PAPER_TIES, metric_of, paper_cases
from ovibjax.control.protocols import seeds_to_keys
from ovibjax.runtime.progress import console
from ovibjax.scheduling.clients import PHASE_SPREAD_S, default_trace_params
from ovibjax.scheduling.congestion import LEVELS, Case, compare
from ovibjax.scheduling.events import Events
from ovibjax.scheduling.replay_metrics import ReplayMetrics
from ovibjax.scheduling.rules import default_params
from ovibjax.scheduling.ties import TIES

SPREADS_S = tuple(PHASE_SPREAD_S * factor for factor in (0.5, 1.0, 2.0, 4.0, 8.0))
LOADS = (10, 20, 30, 45)


@dataclass(frozen=True)
class Congestion:
    """Metrics of the rules under congestion, on the host.

    Attributes:
        levels: [levels, seeds, ties] by rule, at the paper's V.
        equal_urgency: the same where every mission is equally urgent.
        own_times: the same where every client asks at the times of its own replay.
        varied: [spreads x loads, seeds, 1] by rule, at 4 KB/s and `PAPER_TIES`.
        requests: requests per client.
    """

    levels: dict[str, ReplayMetrics]
    equal_urgency: dict[str, ReplayMetrics]
    own_times: dict[str, ReplayMetrics]
    varied: dict[str, ReplayMetrics]
    requests: int

    def at(
        self,
        rule: str,
        scope: str,
        metric: str,
        level: str = "high",
        ties: str = PAPER_TIES,
        of: dict[str, ReplayMetrics] | None = None,
    ) -> np.ndarray:
        """[seeds] a metric of a rule; of `levels` unless said."""
        metrics = (self.levels if of is None else of)[rule]
        return metric_of(metrics, scope, metric)[list(LEVELS).index(level), :, TIES.index(ties)]

    def cut_percent(self, levels: dict[str, ReplayMetrics]) -> np.ndarray:
        """[seeds] by how much VOI-Lyapunov cuts Base-DPP's edge p95 of the top decile at high congestion."""
        voi, base = (self.at(rule, "top10", "edge_p95_ms", of=levels) for rule in ("voi_lyapunov", "base_dpp"))
        return 100.0 * (base - voi) / base


def replay_congestion(events: Events, seeds: list[int], sensitivity_seeds: int) -> Congestion:
    """Replay every rule at the paper's congestion levels under all ties, and some at other loads and phase spreads.

    Args:
        events: requests of recorded replays, [S, E].
        seeds: scheduler seeds.
        sensitivity_seeds: how many of them, from the first, the other loads and spreads are replayed with.

    Returns:
        Metrics on the host.
    """
    params, trace = default_params(PAPER_TIES), default_trace_params()
    keys, by_ties = seeds_to_keys(seeds), params._replace(ties=jnp.arange(len(TIES), dtype=jnp.int32))
    most = max(clients for clients, _ in LEVELS.values())
    places = [(load, spread) for spread in SPREADS_S for load in LOADS]
    cases = Case(
        jnp.array([load for load, _ in places]),
        jnp.full(len(places), LEVELS["high"][1], jnp.float32),
        jnp.array([spread for _, spread in places], jnp.float32),
    )
    rivals = ("voi_lyapunov", "base_dpp", "fifo")
    with console.status("replaying the schedulers"):
        levels = compare(keys, events, paper_cases(*LEVELS), trace, by_ties, most)
        alike = trace._replace(urgency_low=jnp.float32(1.0), urgency_high=jnp.float32(1.0))
        equal_urgency = compare(keys, events, paper_cases(*LEVELS), alike, by_ties, most)
        own_times = compare(
            keys, events, paper_cases(*LEVELS), trace._replace(own_times=jnp.array(True)), by_ties, most
        )
        varied = compare(keys[:sensitivity_seeds], events, cases, trace, params, max(LOADS), rivals)
        found = jax.device_get((levels, equal_urgency, own_times, varied))
        levels, equal_urgency, own_times, varied = found
        return Congestion(levels, equal_urgency, own_times, varied, int(events.valid[0].sum()))

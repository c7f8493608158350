"""The search of VOI-Lyapunov's weights and of Base-DPP's V: tried on tuning seeds, judged on held-out ones."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.cards.scheduling_study import PAPER_TIES, VS, metric_of, paper_cases
from ovibjax.control.protocols import seeds_to_keys
from ovibjax.runtime.progress import console
from ovibjax.scheduling.clients import default_trace_params
from ovibjax.scheduling.congestion import LEVELS, compare, search
from ovibjax.scheduling.events import Events
from ovibjax.scheduling.replay_metrics import ReplayMetrics
from ovibjax.scheduling.rules import SchedulerParams, Weights, default_params

SETTINGS = ("paper", "tuned_top10", "tuned_all")
"""The paper's weights, and the best of those tried for the cost of the top decile and of all requests."""


@dataclass(frozen=True)
class WeightSearch:
    """What was tried, chosen and found, on the host.

    Attributes:
        tried: [candidates, 6] weights; the first are the paper's.
        tuning: [candidates, 4] mean objectives on tuning seeds, see `congestion.objectives`.
        chosen: candidate of each of `SETTINGS`.
        held_out: [1, seeds, settings] metrics of VOI-Lyapunov.
        base_dpp: [1, seeds, V] metrics of Base-DPP.
        best_v: position in `VS` of the V with the lowest top-decile cost on tuning seeds.
    """

    tried: np.ndarray
    tuning: np.ndarray
    chosen: tuple[int, ...]
    held_out: ReplayMetrics
    base_dpp: ReplayMetrics
    best_v: int

    def of(self, setting: str, scope: str, metric: str) -> np.ndarray:
        """[seeds] a held-out metric of a setting."""
        return metric_of(self.held_out, scope, metric)[0, :, SETTINGS.index(setting)]


def candidates(count: int) -> Weights:
    """Weight vectors: the paper's first, then log-uniform between 0.03 and 10."""
    key = jax.random.key(0)
    draws = jax.vmap(lambda i: jax.random.uniform(jax.random.fold_in(key, i), (6,)))(jnp.arange(count))
    table = 10.0 ** (2.5 * draws - 1.5)
    table = table.at[0].set(jnp.stack(default_params().weights))
    return Weights(*table.T)


def search_weights(events: Events, count: int, tuning_seeds: list[int], seeds: list[int]) -> WeightSearch:
    """Search on tuning seeds, judge on held-out ones, at high congestion.

    Args:
        events: requests of recorded replays, [S, E].
        count: weight vectors tried.
        tuning_seeds: seeds they are tried on.
        seeds: held-out seeds.

    Returns:
        What was tried, chosen and found, on the host.
    """
    n, case = LEVELS["high"][0], paper_cases("high")
    trace, params = default_trace_params(), default_params(PAPER_TIES)
    tuning_keys, held_keys = seeds_to_keys(tuning_seeds), seeds_to_keys(seeds)
    tried = candidates(count)
    by_v: SchedulerParams = params._replace(V=jnp.array(VS, jnp.float32))
    with console.status("searching the weights"):
        objectives = np.asarray(search(tuning_keys, events, case, trace, params._replace(weights=tried), n))
        tuning = objectives[0].mean(axis=0)
        chosen = (0, int(np.argmin(tuning[:, 0])), int(np.argmin(tuning[:, 2])))
        picked = Weights(*(leaf[np.array(chosen)] for leaf in tried))
        tuned_v = compare(tuning_keys, events, case, trace, by_v, n, ("base_dpp",))["base_dpp"]
        best_v = int(np.argmin(metric_of(jax.device_get(tuned_v), "top10", "cost")[0].mean(axis=0)))
        shaped = compare(held_keys, events, case, trace, params._replace(weights=picked), n, ("voi_lyapunov",))
        base = compare(held_keys, events, case, trace, by_v, n, ("base_dpp",))["base_dpp"]
        held_out, base = jax.device_get((shaped["voi_lyapunov"], base))
    return WeightSearch(np.stack([np.asarray(w) for w in tried], axis=1), tuning, chosen, held_out, base, best_v)

"""Low, medium and high congestion at the edge: every scheduling rule on every case and seed, in one program."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.scheduling.clients import TraceParams, Workload, make_trace
from ovibjax.scheduling.events import Events
from ovibjax.scheduling.replay_grid import run_grid, run_rules
from ovibjax.scheduling.replay_metrics import ReplayMetrics, metrics
from ovibjax.scheduling.rules import POLICIES, SchedulerParams

LEVELS = {"low": (10, 12.0), "medium": (20, 8.0), "high": (30, 4.0)}
"""Congestion: clients N, and the weak-link profile in KB/s (paper, Section "Multi-Client Scheduling")."""


class Case(NamedTuple):
    """One workload; fields [cases].

    Attributes:
        clients: number of clients N.
        rate_kb_per_s: link profile.
        phase_spread_s: each request is shifted uniformly within this time.
    """

    clients: jax.Array
    rate_kb_per_s: jax.Array
    phase_spread_s: jax.Array


def workloads(keys: jax.Array, events: Events, cases: Case, trace: TraceParams, n_max: int) -> Workload:
    """A trace per case and seed, padded to the largest number of clients.

    Args:
        keys: [S] keys of the seeds; cases of one seed share their draws.
        events: requests of recorded replays, [S, E].
        cases: [R] cases.
        trace: urgency, deadlines, service.
        n_max: most clients of any case (static).

    Returns:
        Fields [R, S, J].
    """

    def one(case: Case, key: jax.Array) -> Workload:
        made = make_trace(key, events, n_max, case.rate_kb_per_s, trace._replace(phase_spread_s=case.phase_spread_s))
        requests = made.requests
        return made._replace(requests=requests._replace(valid=requests.valid & (requests.client < case.clients)))

    return jax.vmap(jax.vmap(one, (None, 0)), (0, None))(cases, keys)


@partial(jax.jit, static_argnames=("n_max", "rules"))
def compare(
    keys: jax.Array,
    events: Events,
    cases: Case,
    trace: TraceParams,
    params: SchedulerParams,
    n_max: int,
    rules: tuple[str, ...] = POLICIES,
) -> dict[str, ReplayMetrics]:
    """Replay every rule on every case, seed and setting of the parameters.

    Args:
        keys: [S] keys of the seeds.
        events: requests of recorded replays, [S, E].
        cases: [R] cases.
        trace: urgency, deadlines, service.
        params: leaves scalars or [P].
        n_max: most clients of any case (static).
        rules: names of scheduling rules (static).

    Returns:
        Metrics [R, S, P] by rule.
    """
    made = workloads(keys, events, cases, trace, n_max)
    shape = made.uplink_ms.shape[:2]
    flat: Workload = jax.tree.map(lambda leaf: leaf.reshape(-1, leaf.shape[-1]), made)
    size = max((leaf.shape[0] for leaf in jax.tree.leaves(params) if leaf.ndim), default=1)
    found = run_rules(flat.requests, rules, params, metrics, flat)
    return jax.tree.map(lambda leaf: leaf.reshape(*shape, size), found)


def objectives(workload: Workload, waits_ms: jax.Array, params: SchedulerParams) -> jax.Array:
    """What a search of the weights looks at: cost and edge p95 of the top decile and of all requests.

    Args:
        workload: leaves [J].
        waits_ms: [J] waits of its replay.
        params: scalars.

    Returns:
        [4] top cost, top edge p95 (ms), cost of all, edge p95 of all (ms).
    """
    found = metrics(workload, waits_ms, params)
    return jnp.stack([found.top.cost, found.top.edge_p95_ms, found.every.cost, found.every.edge_p95_ms])


@partial(jax.jit, static_argnames="n_max")
def search(
    keys: jax.Array, events: Events, cases: Case, trace: TraceParams, tried: SchedulerParams, n_max: int
) -> jax.Array:
    """Replay the shaped rule with every candidate of its weights.

    Args:
        keys: [S] keys of the tuning seeds.
        events: requests of recorded replays, [S, E].
        cases: [R] cases.
        trace: urgency, deadlines, service.
        tried: leaves [P].
        n_max: most clients of any case (static).

    Returns:
        [R, S, P, 4] see `objectives`.
    """
    made = workloads(keys, events, cases, trace, n_max)
    shape = made.uplink_ms.shape[:2]
    flat: Workload = jax.tree.map(lambda leaf: leaf.reshape(-1, leaf.shape[-1]), made)
    found = run_grid(flat.requests, "voi_lyapunov", tried, objectives, flat)
    return found.reshape(*shape, *found.shape[1:])

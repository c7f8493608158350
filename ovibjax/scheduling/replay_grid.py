"""Whole grids of queue replays: many parameters on each of many traces, in one compiled program.

Parameter settings that replay the same trace go side by side through the kernel in `lanes`; traces are shared among the
local devices.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jax.sharding import PartitionSpec as P

from ovibjax.errors import InputError
from ovibjax.runtime.computed_once import computed_once
from ovibjax.scheduling.lanes import broadcast_params, lane_waits
from ovibjax.scheduling.queue_replay import served_by, served_order, to_trace_order
from ovibjax.scheduling.requests import Requests, RequestTrace, check
from ovibjax.scheduling.rules import POLICIES, SchedulerParams
from ovibjax.scheduling.stretches import first_come
from ovibjax.scheduling.ticks import SplitTrace, sort_requests, split_on_host, split_times

_LANES = 1024
_FEW_LANES = 16  # fewer settings are replayed one by one, which compiles less

SWEPT = ("base_dpp", "voi_lyapunov")
"""Rules that have numbers of their own, of which grids are large: many settings go side by side."""

Summarize = Callable[[Any, jax.Array, SchedulerParams], Any]


def run_grid(
    traces: RequestTrace,
    policy: str,
    params: SchedulerParams,
    summary: Summarize | None = None,
    context: Any = None,
    lanes: int = _LANES,
) -> Any:
    """Replay every trace with every setting of the parameters.

    Several local devices share the traces. Float64 NumPy traces keep their precision, as in `queue_replay.replay`.

    Args:
        traces: leaves [R, J].
        policy: one of `POLICIES`.
        params: leaves [P] or, where not swept, scalars; P is 1 if none is.
        summary: function of `context` of one trace, waits [J] and one setting of the parameters, such as
            `replay_metrics.metrics`. It is applied inside the program, so that the waits of a large grid are never all
            in memory.
        context: leaves [R, ...] for the summary.
        lanes: settings replayed side by side; their state should fit a core's cache.

    Returns:
        Outputs of `summary`, [R, P, ...]; without it the waits as `queue_replay.waits` gives them, [R, P, J].

    Raises:
        InputError: an unknown policy, shapes that differ, or times out of range.
    """
    return _share(traces, context, params, _Grid(policy, summary, lanes), (policy,))


def run_rules(
    traces: RequestTrace, rules: tuple[str, ...], params: SchedulerParams, summary: Summarize, context: Any
) -> dict[str, Any]:
    """Replay every trace under several rules, in one program that is compiled once for all of them.

    What `run_grid` gives rule by rule, for a few settings: it compiles hardly longer than one rule, and runs slower.

    Args:
        traces: leaves [R, J].
        rules: some of `POLICIES`.
        params: leaves [P] or, where not swept, scalars; P is 1 if none is.
        summary: as in `run_grid`.
        context: leaves [R, ...] for the summary.

    Returns:
        Outputs of `summary` by rule, [R, P, ...]; a rule is replayed once where nothing that is swept concerns it.

    Raises:
        InputError: as in `run_grid`.
    """
    found: dict[str, Any] = _share(traces, context, params, _Rules(rules, summary), rules)
    return found


def _share(traces: RequestTrace, context: Any, params: SchedulerParams, block: Any, policies: tuple[str, ...]) -> Any:
    """Check the input of a grid, and share its traces among the devices."""
    for policy in policies:
        if policy not in POLICIES:
            raise InputError(f"policy {policy!r} is unknown; it must be one of {', '.join(POLICIES)}")
    check(traces)
    if jnp.ndim(traces.valid) != 2:
        raise InputError(f"traces have shape {jnp.shape(traces.valid)}; stack them to [traces, requests]")
    shapes = {jnp.shape(leaf) for leaf in jax.tree.leaves(params)} - {()}
    if len(shapes) > 1 or any(len(shape) != 1 for shape in shapes):
        raise InputError(f"parameters have shapes {sorted(shapes)}; each must be a scalar or of one common length")
    params = jax.tree.map(_as_float32, params)._replace(ties=jnp.asarray(params.ties, jnp.int32))
    # Inside a program that already shares its work among the devices, each has its part.
    shared_already = bool(jax.sharding.get_abstract_mesh().axis_names)
    devices = 1 if shared_already else len(jax.local_devices())
    return _among_devices(split_on_host(traces), context, params, block, devices)


def _as_float32(leaf: Any) -> jax.Array:
    """A float32 array; one that is one already stays as it is, as each conversion costs as much as a small replay."""
    return leaf if isinstance(leaf, jax.Array) and leaf.dtype == jnp.float32 else jnp.asarray(leaf, jnp.float32)


@partial(jax.jit, static_argnames=("block", "devices"))
def _among_devices(
    given: RequestTrace | SplitTrace, context: Any, params: SchedulerParams, block: Any, devices: int
) -> Any:
    """A block of work on all traces, whose outputs have leading axis R, shared among the local devices."""
    traces = split_times(given)
    n_traces = traces.valid.shape[0]
    if devices == 1 or n_traces == 1:
        return block(traces, context, params)
    # Whole traces per device; the last one is repeated to fill them up.
    fill = jnp.minimum(jnp.arange(-(-n_traces // devices) * devices), n_traces - 1)
    traces, context = jax.tree.map(lambda leaf: leaf[fill], (traces, context))
    mesh = Mesh(np.array(jax.local_devices()[:devices]), ("traces",))
    split = jax.shard_map(
        block, mesh=mesh, in_specs=(P("traces"), P("traces"), P()), out_specs=P("traces"), check_vma=False
    )
    return jax.tree.map(lambda leaf: leaf[:n_traces], split(traces, context, params))


@dataclass(frozen=True)
class _Grid:
    """All settings of some traces under one rule, a chunk of settings after another: [R, P, ...]."""

    policy: str
    summary: Summarize | None
    lanes: int

    def __call__(self, traces: SplitTrace, context: Any, params: SchedulerParams) -> Any:
        n_lanes = _settings(params)
        if self.policy == "fifo" and self.summary is None:
            once = jax.vmap(_first_come)(traces)  # traces side by side: no setting concerns them
            return jnp.broadcast_to(once[:, None], (once.shape[0], n_lanes, once.shape[1]))
        width = min(self.lanes, n_lanes)
        chunks = -(-n_lanes // width)
        # Equal chunks, the last setting repeated: a remainder would be a second program inside the first.
        fill = jnp.minimum(jnp.arange(chunks * width), n_lanes - 1).reshape(chunks, width)
        replay = lane_waits if self.policy in SWEPT and width >= _FEW_LANES else _one_by_one
        axes = jax.tree.map(lambda leaf: 0 if leaf.ndim else None, params)

        sorted_once = jax.lax.map(sort_requests, traces)

        def one_chunk(number: jax.Array) -> Any:
            row, index = number // chunks, fill[number % chunks]
            requests, about = jax.tree.map(lambda leaf: leaf[row], (sorted_once, context))
            chosen = _chosen(params, index)
            wait_ms = replay(requests, chosen, self.policy, width)
            if self.summary is None:
                return wait_ms
            by_lane = computed_once(number >= 0, jnp.transpose, wait_ms)
            return jax.vmap(self.summary, (None, 0, axes))(about, by_lane, chosen)

        n_traces = traces.valid.shape[0]
        results = jax.lax.map(one_chunk, jnp.arange(n_traces * chunks, dtype=jnp.int32))
        if self.summary is None:
            results = jnp.swapaxes(results, 1, 2)
        return jax.tree.map(lambda leaf: leaf.reshape(n_traces, chunks * width, *leaf.shape[2:])[:, :n_lanes], results)


@dataclass(frozen=True)
class _Rules:
    """A few settings of some traces under several rules, one replay after another: by rule, [R, P, ...]."""

    rules: tuple[str, ...]
    summary: Summarize

    def __call__(self, traces: SplitTrace, context: Any, params: SchedulerParams) -> dict[str, Any]:
        settings = _settings(params)
        replays = [
            (n, p) for n, rule in enumerate(self.rules) for p in range(settings if _concerns(rule, params) else 1)
        ]
        which, setting = (jnp.array(column, jnp.int32) for column in zip(*replays, strict=True))
        sorted_once = jax.lax.map(sort_requests, traces)

        def one(number: jax.Array) -> Any:
            row, replay = number // len(replays), number % len(replays)
            requests, about = jax.tree.map(lambda leaf: leaf[row], (sorted_once, context))
            chosen = _chosen(params, setting[replay])
            start = served_by(requests, self.rules, which[replay], chosen)
            return self.summary(about, to_trace_order(requests, start), chosen)

        n_traces = traces.valid.shape[0]
        results = jax.lax.map(one, jnp.arange(n_traces * len(replays), dtype=jnp.int32))
        results = jax.tree.map(lambda leaf: leaf.reshape(n_traces, len(replays), *leaf.shape[1:]), results)
        found = {}
        for n, rule in enumerate(self.rules):
            # The only replay of a rule that nothing concerns stands for all settings.
            own = np.resize([i for i, (number, _) in enumerate(replays) if number == n], settings)
            found[rule] = jax.tree.map(lambda leaf, own=own: leaf[:, own], results)
        return found


def _settings(params: SchedulerParams) -> int:
    """Settings P of parameters, 1 if none is swept."""
    return max([leaf.shape[0] for leaf in jax.tree.leaves(params) if leaf.ndim], default=1)


def _chosen(params: SchedulerParams, index: jax.Array) -> SchedulerParams:
    """Settings by their numbers; what is not swept stays as it is."""
    chosen: SchedulerParams = jax.tree.map(lambda leaf: leaf[index] if leaf.ndim else leaf, params)
    return chosen


def _orders(rule: str, params: SchedulerParams) -> bool:
    """Whether the order of service depends on a number that is swept."""
    own = {"fifo": (), "base_dpp": (params.V, params.ties), "voi_lyapunov": (params.weights, params.value, params.ties)}
    return any(leaf.ndim for leaf in jax.tree.leaves(own.get(rule, params.ties)))


def _concerns(rule: str, params: SchedulerParams) -> bool:
    """Whether a replay or its judgement depends on a number that is swept."""
    return _orders(rule, params) or any(leaf.ndim for leaf in params.value)


def _first_come(trace: SplitTrace) -> jax.Array:
    """Waits [J] under FIFO."""
    requests = sort_requests(trace)
    return to_trace_order(requests, first_come(requests))


def _one_by_one(requests: Requests, params: SchedulerParams, policy: str, n_lanes: int) -> jax.Array:
    """Waits [J, L] by the plain replay; once for all lanes where nothing that is swept changes the order."""

    def waits(chosen: SchedulerParams) -> jax.Array:
        return to_trace_order(requests, served_order(requests, policy, chosen))

    every = broadcast_params(params, n_lanes)
    if _orders(policy, params):
        return jax.lax.map(waits, every).T
    once = waits(jax.tree.map(lambda leaf: leaf[0], every))
    return jnp.broadcast_to(once[:, None], (once.size, n_lanes))

"""Replay of a request trace through one edge server (paper, Section "Multi-Client Scheduling").

One work-conserving, non-preemptive server takes one request at a time. When it is free it serves the waiting request of
highest priority (of equals as `ties` says), and when none waits its clock jumps to the next arrival. A request waits
from the tick of its arrival.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.errors import InputError
from ovibjax.scheduling.requests import Numbers, Requests, RequestTrace, check, is_concrete
from ovibjax.scheduling.rules import BY_CLIENT, POLICIES, RULES, Queue, SchedulerParams, default_params
from ovibjax.scheduling.stretches import alone, first_come
from ovibjax.scheduling.ticks import SplitTrace, sort_requests, split_on_host, split_times
from ovibjax.scheduling.ties import served_first

__all__ = ["POLICIES", "ReplayResult", "RequestTrace", "default_params", "replay", "served_order", "waits"]

# Requests from the first unserved one on that are looked at; where more have arrived, all are.
_WINDOW = 64


class ReplayResult(NamedTuple):
    """When each request was served; NaN for padding.

    Attributes:
        start_ms: [J] start of service, on the clock of `ready_ms`.
        finish_ms: [J] end of service.
    """

    start_ms: Numbers
    finish_ms: Numbers


def replay(trace: RequestTrace, policy: str, params: SchedulerParams) -> ReplayResult:
    """Replay one trace of requests through the edge server.

    Exact in ticks (see `ticks`): about 0.24 microseconds for five minutes, 2 for an hour. Services are rounded to
    ticks, so n of them back to back may end n / 2 ticks off. NumPy float64 traces give float64 results; of float32 ones
    the results are float32, and `waits` is finer.

    Args:
        trace: leaves [J], in any order; the caller maps over more traces or parameters.
        policy: one of `POLICIES`.
        params: scalars; `default_params()` has the paper's.

    Returns:
        Start and end of each service, in the order of the trace.

    Raises:
        InputError: an unknown policy, shapes that differ, or times out of range.
    """
    wait_ms = waits(trace, policy, params)
    if isinstance(trace.ready_ms, np.ndarray) and trace.ready_ms.dtype == np.float64 and is_concrete(trace):
        start = trace.ready_ms + np.asarray(wait_ms, np.float64)
        return ReplayResult(start, start + np.asarray(trace.service_ms, np.float64))
    start_ms = jnp.asarray(trace.ready_ms, jnp.float32) + wait_ms
    return ReplayResult(start_ms, start_ms + jnp.asarray(trace.service_ms, jnp.float32))


def waits(trace: RequestTrace, policy: str, params: SchedulerParams) -> jax.Array:
    """Time each request waits for its service, which float32 resolves better than a start on an hour's clock.

    Args:
        trace: leaves [J].
        policy: one of `POLICIES`.
        params: scalars.

    Returns:
        [J] float32 milliseconds; NaN for padding.

    Raises:
        InputError: as in `replay`.
    """
    if policy not in RULES:
        raise InputError(f"policy {policy!r} is unknown; it must be one of {', '.join(POLICIES)}")
    check(trace)
    return _waits(split_on_host(trace), params, policy)


@partial(jax.jit, static_argnames="policy")
def _waits(trace: RequestTrace | SplitTrace, params: SchedulerParams, policy: str) -> jax.Array:
    requests = sort_requests(split_times(trace))
    start = served_order(requests, policy, params)
    return to_trace_order(requests, start)


def to_trace_order(requests: Requests, start: jax.Array) -> jax.Array:
    """Waits [J] in milliseconds, in the order of the trace, from starts [J] in ticks of sorted requests."""
    wait_ms = (start - requests.ready).astype(jnp.float32) * requests.tick_ms
    wait_ms = jnp.where(requests.valid, wait_ms, jnp.nan)
    return jnp.zeros_like(wait_ms).at[requests.position].set(wait_ms, unique_indices=True)


def served_order(requests: Requests, policy: str, params: SchedulerParams) -> jax.Array:
    """Start of each service.

    Args:
        requests: sorted, leaves [J].
        policy: one of `POLICIES`.
        params: scalars.

    Returns:
        [J] int32 ticks.
    """
    return first_come(requests) if policy == "fifo" else served_by(requests, (policy,), jnp.int32(0), params)


class _State(NamedTuple):
    """Between decisions: clock, start of each service (-1 before it), arrivals so far, waiting requests per client."""

    clock: jax.Array
    start: jax.Array
    arrived: jax.Array
    pending: jax.Array


def _choose(
    requests: Requests,
    rules: tuple[str, ...],
    which: jax.Array,
    params: SchedulerParams,
    state: _State,
    offset: jax.Array,
    width: int,
) -> jax.Array:
    """Position of the request to serve, of `width` requests from `offset` on."""

    def part(leaf: jax.Array) -> jax.Array:
        return jax.lax.dynamic_slice_in_dim(leaf, offset, width) if leaf.ndim else leaf

    shown: Requests = jax.tree.map(part, requests)
    waiting = (part(state.start) < 0) & (shown.ready <= state.clock)
    head = waiting & ((shown.previous < 0) | (state.start[shown.previous] >= 0))
    # Rules by client carry a counter for each request, the others none.
    backlog = state.pending[shown.group].astype(jnp.float32)
    queue = Queue(shown, state.clock, waiting, head, backlog, jnp.arange(width, dtype=jnp.int32))
    choices = [RULES[rule] for rule in rules]
    priority = jax.lax.switch(which, choices, queue, params) if len(choices) > 1 else choices[0](queue, params)
    return offset + served_first(priority, shown.client, queue.arrival, params.ties)


def _settled(requests: Requests, in_turn: jax.Array, rules: tuple[str, ...], which: jax.Array) -> jax.Array:
    """[J] bool, requests that are served as under FIFO: those that contend with no other, or all of them."""
    settled = alone(requests, in_turn)
    if "fifo" in rules:
        settled = settled | (requests.valid & (which == rules.index("fifo")))
    return settled


def served_by(requests: Requests, rules: tuple[str, ...], which: jax.Array, params: SchedulerParams) -> jax.Array:
    """Start of each service under one of several rules: one program for all of them.

    What contends with nothing is served as under FIFO; decisions are taken for the rest.

    Args:
        requests: sorted, leaves [J].
        rules: some of `POLICIES` (static).
        which: int32 scalar, the rule.
        params: scalars.

    Returns:
        [J] int32 ticks.
    """
    by_client = any(rule in BY_CLIENT for rule in rules)
    size = requests.ready.size
    window = min(size, _WINDOW)
    in_turn = first_come(requests)
    settled = _settled(requests, in_turn, rules, which)
    choose = partial(_choose, requests, rules, which, params)

    def admit(state: _State) -> _State:
        """Count the request that arrives next."""
        waits = (~settled[state.arrived]).astype(jnp.int32)
        pending = state.pending.at[requests.group[state.arrived]].add(waits) if by_client else state.pending
        return state._replace(arrived=state.arrived + 1, pending=pending)

    def arrives(state: _State) -> jax.Array:
        return (state.arrived < size) & (requests.ready[state.arrived] <= state.clock)

    def step(_: jax.Array, state: _State) -> _State:
        first = jnp.argmax(state.start < 0).astype(jnp.int32)
        # Those before it are served, so the server is free no sooner than under FIFO.
        state = state._replace(clock=jnp.maximum(state.clock, in_turn[first]))
        state = jax.lax.while_loop(arrives, admit, state)
        offset = jnp.minimum(first, size - window)
        chosen = jax.lax.cond(
            state.arrived <= offset + window,
            lambda: choose(state, offset, window),
            lambda: choose(state, jnp.int32(0), size),
        )
        pending = state.pending.at[requests.group[chosen]].add(-1) if by_client else state.pending
        start = state.start.at[chosen].set(state.clock)
        return _State(state.clock + requests.service[chosen], start, state.arrived, pending)

    none = jnp.zeros(size if by_client else 1, jnp.int32)
    state = _State(jnp.int32(0), jnp.where(settled, in_turn, -1), jnp.int32(0), none)
    decisions = requests.total - jnp.sum(settled.astype(jnp.int32))
    return jax.lax.fori_loop(0, decisions, step, state).start

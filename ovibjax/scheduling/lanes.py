"""Whole grids of replays: many parameters on each of many traces, in one compiled program.

Lanes are parameter settings that replay the same trace. They serve different requests, but the requests that any lane
still needs are few, so one short list of them, common to all lanes, is kept sorted by arrival: the fields of a request
are scalars, and a lane carries its clock and one bit per slot of the list. A decision is one fused loop over lanes, of
as many steps as the list has slots, rounded up to one of a few sizes. Where a list outgrows its slots the trace is
replayed by `replay.served_order` instead, so results are exact whatever the load.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jax.sharding import PartitionSpec as P

from ovibjax.errors import InputError
from ovibjax.scheduling.queue_replay import served_order, to_trace_order
from ovibjax.scheduling.requests import NEVER, Requests, RequestTrace, SplitTrace, check, sort_requests, split_times
from ovibjax.scheduling.rules import (
    POLICIES,
    SchedulerParams,
    ValueCoefficients,
    scheduling_value,
    term_scales,
    timing,
    weighted_sum,
)

SLOTS = 32
"""Requests a list can hold: the bits of a word."""

_SIZES = (1, 2, 3, 4, 6, 8, 12, 16, SLOTS)
_LANES = 1024
_FEW_LANES = 16

SWEPT = ("base_dpp", "voi_lyapunov")
"""Policies that have parameters."""

Summary = Callable[[Any, jax.Array, SchedulerParams], Any]


class _Slots(NamedTuple):
    """The list: one int32 table, floats as their bits, so that an admission moves all fields at once."""

    ready: jax.Array
    service: jax.Array
    position: jax.Array
    client: jax.Array
    slack: jax.Array
    per_deadline: jax.Array
    service_est_ms: jax.Array
    value: jax.Array
    density: jax.Array
    voi_m: jax.Array
    drift_m_per_s: jax.Array
    risk_m: jax.Array
    delay_est_ms: jax.Array
    urgency: jax.Array


class _State(NamedTuple):
    """State between decisions: clock and unserved slots of each lane; list, its size, next request to admit."""

    done: jax.Array
    clock: jax.Array
    unserved: jax.Array
    table: jax.Array
    size: jax.Array
    upcoming: jax.Array


_Carry = tuple[_State, jax.Array, jax.Array]
_Admission = tuple[jax.Array, jax.Array, jax.Array]


def run_grid(
    traces: RequestTrace,
    policy: str,
    params: SchedulerParams,
    summary: Summary | None = None,
    context: Any = None,
    lanes: int = _LANES,
) -> Any:
    """Replay every trace with every setting of the parameters.

    Several local devices share the traces. Float64 NumPy traces keep their precision, as in `replay.run`.

    Args:
        traces: leaves [R, J].
        policy: one of `POLICIES`.
        params: leaves [P] or, where not swept, scalars; P is 1 if none is.
        summary: function of `context` of one trace, waits [J] and the parameters of one lane, such as `traces.metrics`.
            It is applied inside the program, so that the waits of a large grid are never all in memory.
        context: leaves [R, ...] for the summary.
        lanes: settings replayed side by side; their state should fit a core's cache.

    Returns:
        Outputs of `summary`, [R, P, ...]; without it the waits as `replay.waits` gives them, [R, P, J].

    Raises:
        InputError: an unknown policy, shapes that differ, or times out of range.
    """
    if policy not in POLICIES:
        raise InputError(f"policy {policy!r} is unknown; it must be one of {', '.join(POLICIES)}")
    check(traces)
    if jnp.ndim(traces.valid) != 2:
        raise InputError(f"traces have shape {jnp.shape(traces.valid)}; stack them to [traces, requests]")
    shapes = {jnp.shape(leaf) for leaf in jax.tree.leaves(params)} - {()}
    if len(shapes) > 1 or any(len(shape) != 1 for shape in shapes):
        raise InputError(f"parameters have shapes {sorted(shapes)}; each must be a scalar or of one common length")
    params = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), params)
    # Inside a program that already shares its work among the devices, each has its part.
    shared_already = bool(jax.sharding.get_abstract_mesh().axis_names)
    devices = 1 if shared_already else len(jax.local_devices())
    return _run_grid(split_times(traces), context, params, policy, summary, lanes, devices)


@partial(jax.jit, static_argnames=("policy", "summary", "lanes", "devices"))
def _run_grid(
    traces: SplitTrace,
    context: Any,
    params: SchedulerParams,
    policy: str,
    summary: Summary | None,
    lanes: int,
    devices: int,
) -> Any:
    n_traces = traces.valid.shape[0]
    block = partial(_block, policy=policy, summary=summary, lanes=lanes)
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


def _block(
    traces: SplitTrace, context: Any, params: SchedulerParams, policy: str, summary: Summary | None, lanes: int
) -> Any:
    """All settings of some traces, a chunk of settings after another."""
    n_lanes = max([leaf.shape[0] for leaf in jax.tree.leaves(params) if leaf.ndim], default=1)
    width = min(lanes, n_lanes)
    chunks = -(-n_lanes // width)
    # Equal chunks, the last setting repeated: a remainder would be a second program inside the first.
    fill = jnp.minimum(jnp.arange(chunks * width), n_lanes - 1).reshape(chunks, width)
    replay = _lanes if policy in SWEPT and width >= _FEW_LANES else _one_by_one
    axes = jax.tree.map(lambda leaf: 0 if leaf.ndim else None, params)

    def one_chunk(number: jax.Array) -> Any:
        row, index = number // chunks, fill[number % chunks]
        trace, about = jax.tree.map(lambda leaf: leaf[row], (traces, context))
        chosen: SchedulerParams = jax.tree.map(lambda leaf: leaf[index] if leaf.ndim else leaf, params)
        wait_ms = replay(sort_requests(trace), chosen, policy, width)
        return wait_ms if summary is None else jax.vmap(summary, (None, 0, axes))(about, wait_ms, chosen)

    n_traces = traces.valid.shape[0]
    results = jax.lax.map(one_chunk, jnp.arange(n_traces * chunks, dtype=jnp.int32))
    return jax.tree.map(lambda leaf: leaf.reshape(n_traces, chunks * width, *leaf.shape[2:])[:, :n_lanes], results)


def _broadcast(params: SchedulerParams, n_lanes: int) -> SchedulerParams:
    broadcast: SchedulerParams = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (n_lanes,)), params)
    return broadcast


def _one_by_one(requests: Requests, params: SchedulerParams, policy: str, n_lanes: int) -> jax.Array:
    """Waits [L, J] by the plain replay; once for all lanes where the policy has no parameter."""

    def waits(chosen: SchedulerParams) -> jax.Array:
        return to_trace_order(requests, served_order(requests, policy, chosen))

    every = _broadcast(params, n_lanes)
    if policy in SWEPT:
        return jax.lax.map(waits, every)
    once = waits(jax.tree.map(lambda leaf: leaf[0], every))
    return jnp.broadcast_to(once[None], (n_lanes, once.size))


def _lanes(requests: Requests, params: SchedulerParams, policy: str, n_lanes: int) -> jax.Array:
    """Waits [L, J] of one trace under L settings."""
    overflow, where, wait_ms = _decisions(requests, params, policy, n_lanes)
    shape = n_lanes, requests.ready.size
    flat = jnp.zeros(n_lanes * requests.ready.size, jnp.float32)
    flat = flat.at[where.ravel()].set(wait_ms.ravel(), unique_indices=True, mode="promise_in_bounds")
    every = _broadcast(params, n_lanes)

    def again(lane: jax.Array, waits: jax.Array) -> jax.Array:
        chosen: SchedulerParams = jax.tree.map(lambda leaf: leaf[lane], every)
        return waits.at[lane].set(to_trace_order(requests, served_order(requests, policy, chosen)))

    # A loop of no turns, not a conditional: it changes the waits in place.
    return jax.lax.fori_loop(0, jnp.where(overflow, n_lanes, 0), again, flat.reshape(shape))


def _decisions(
    requests: Requests, params: SchedulerParams, policy: str, n_lanes: int
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Serve every request in every lane.

    Returns:
        Whether the list overflowed; for each decision and lane the index into waits [L, J] of the request served, and
        its wait in milliseconds, both [J, L]. Padding follows the last decision, with NaN.
    """
    n_requests = requests.ready.size
    # Where the scheduling value is the same in all lanes it is a field of the list.
    common_value = all(leaf.ndim == 0 for leaf in params.value)
    params = _broadcast(params, n_lanes)
    offset = n_requests * jnp.arange(n_lanes, dtype=jnp.int32)
    source = _source(requests, params.value)
    choices = [_choice(policy, size, params, common_value) for size in _SIZES]
    services = [_service(size, offset, requests.tick_ms) for size in _SIZES]

    def cond(carry: _Carry) -> jax.Array:
        return carry[0].done < requests.total

    def body(carry: _Carry) -> _Carry:
        state, wheres, waits = carry
        # Branches of a conditional are materialized: without it the choice would be recomputed by each of its users.
        tier = jnp.sum((state.size > jnp.array(_SIZES, jnp.int32)).astype(jnp.int32))
        chosen = jax.lax.switch(tier, choices, state.clock, state.unserved, state.table)
        # A lane with nothing left waits for a tick before `NEVER`, at which padding does not arrive.
        following = jnp.minimum(source[state.upcoming, 0], NEVER - 1)
        clock, unserved, where, wait_ms = jax.lax.switch(
            tier, services, state.clock, state.unserved, state.table, chosen, following
        )
        wheres = jax.lax.dynamic_update_index_in_dim(wheres, where, state.done, 0)
        waits = jax.lax.dynamic_update_index_in_dim(waits, wait_ms, state.done, 0)
        state = _admit(state._replace(clock=clock, unserved=unserved), source)
        # A list that overflowed ends the replay.
        done = jnp.where(state.size > SLOTS, n_requests + 1, state.done + 1)
        return state._replace(done=done), wheres, waits

    first = _State(
        done=jnp.int32(0),
        clock=jnp.broadcast_to(jnp.where(requests.total > 0, requests.ready[0], 0), (n_lanes,)),
        unserved=jnp.zeros(n_lanes, jnp.int32),
        table=jnp.zeros((len(_Slots._fields), SLOTS), jnp.int32),
        size=jnp.int32(0),
        upcoming=jnp.int32(0),
    )
    wheres = requests.position[:, None] + offset[None]
    carry = (_admit(first, source), wheres, jnp.full(wheres.shape, jnp.nan, jnp.float32))
    state, wheres, waits = jax.lax.while_loop(cond, body, carry)
    return (state.done > n_requests) | (state.size > SLOTS), wheres, waits


def _source(requests: Requests, coefficients: ValueCoefficients) -> jax.Array:
    """Fields of `_Slots` of each request, [J + 1, fields] int32; the last row never arrives."""
    r = requests
    first: ValueCoefficients = jax.tree.map(lambda leaf: leaf[0], coefficients)
    value = scheduling_value(r.voi_m, r.drift_m_per_s, r.risk_m, r.delay_est_ms, r.urgency, first)
    known = {"value": value, "density": value / r.service_est_ms}
    rows = [known[name] if name in known else getattr(r, name) for name in _Slots._fields]
    table = jnp.stack([jax.lax.bitcast_convert_type(row, jnp.int32) for row in rows], axis=1)
    return jnp.concatenate([table, jnp.full((1, len(rows)), NEVER)])


def _bit(slot: int) -> jax.Array:
    return jnp.asarray(np.array(1 << slot, np.uint32).view(np.int32))


def _columns(table: jax.Array, slot: int, shape: tuple[int, ...]) -> _Slots:
    """Fields of one slot, broadcast over lanes."""
    fields = {}
    for row, name in enumerate(_Slots._fields):
        value = table[row, slot]
        if name not in ("ready", "service", "position", "client"):
            value = jax.lax.bitcast_convert_type(value, jnp.float32)
        fields[name] = jnp.broadcast_to(value, shape)
    return _Slots(**fields)


def _choice(policy: str, size: int, params: SchedulerParams, common_value: bool) -> Callable[..., jax.Array]:
    """Function of clock, unserved bits and list that returns each lane's slot to serve."""

    def only(clock: jax.Array, unserved: jax.Array, table: jax.Array) -> jax.Array:
        return jnp.zeros_like(clock)

    def shaped(clock: jax.Array, unserved: jax.Array, table: jax.Array) -> jax.Array:
        slots = [_columns(table, slot, clock.shape) for slot in range(size)]
        nothing = jnp.full(clock.shape, jnp.nan, jnp.float32)
        infinite = jnp.full(clock.shape, jnp.inf, jnp.float32)
        low, high, terms = [infinite] * 6, [-infinite] * 6, []
        for number, slot in enumerate(slots):
            waiting = (unserved & _bit(number) != 0) & (slot.ready <= clock)
            age = jax.lax.select(waiting, (clock - slot.ready).astype(jnp.float32), nothing)
            fixed = (slot.density, slot.value, slot.service_est_ms)
            if not common_value:
                value = scheduling_value(
                    slot.voi_m, slot.drift_m_per_s, slot.risk_m, slot.delay_est_ms, slot.urgency, params.value
                )
                fixed = (value / slot.service_est_ms, value, slot.service_est_ms)
            density, worth, length = (jax.lax.select(waiting, term, nothing) for term in fixed)
            timed = timing(age, slot.slack, slot.per_deadline)
            # Not the minimum function: a comparison with NaN is false, so slots that do not wait leave no trace.
            for i, term in enumerate((density, worth, *timed, length)):
                low[i] = jax.lax.select(term < low[i], term, low[i])
                high[i] = jax.lax.select(term > high[i], term, high[i])
            terms.append((fixed[0], fixed[1], *timed, fixed[2]))
        scales = term_scales(low, high, params.weights)
        return _first_best([weighted_sum(term, scales) for term in terms])

    def heads(clock: jax.Array, unserved: jax.Array, table: jax.Array) -> jax.Array:
        slots = [_columns(table, slot, clock.shape) for slot in range(size)]
        waiting = jnp.zeros_like(clock)
        for number, slot in enumerate(slots):
            waiting = waiting | jax.lax.select(slot.ready <= clock, jnp.full_like(clock, _bit(number)), waiting * 0)
        waiting = waiting & unserved
        client = table[_Slots._fields.index("client")]
        bits = jnp.array([_bit(number) for number in range(SLOTS)])
        same = jnp.sum(jnp.where(client[:, None] == client[None, :], bits, 0), axis=1, dtype=jnp.int32)
        priorities = []
        for number, slot in enumerate(slots):
            pending = waiting & same[number]
            earlier = pending & (_bit(number) - 1)
            backlog = jax.lax.population_count(pending).astype(jnp.float32)
            eligible = (pending & _bit(number) != 0) & (earlier == 0)
            priorities.append(jnp.where(eligible, backlog + params.V * slot.voi_m, -jnp.inf))
        return _first_best(priorities)

    if size == 1:
        return only
    return shaped if policy == "voi_lyapunov" else heads


def _first_best(priorities: list[jax.Array]) -> jax.Array:
    """First slot of the largest priority; NaN never wins."""
    best = jnp.full_like(priorities[0], -jnp.inf)
    chosen = jnp.zeros(best.shape, jnp.int32)
    for number, priority in enumerate(priorities):
        better = priority > best
        best = jax.lax.select(better, priority, best)
        chosen = jax.lax.select(better, jnp.full_like(chosen, number), chosen)
    return chosen


def _service(size: int, offset: jax.Array, tick_ms: jax.Array) -> Callable[..., tuple[jax.Array, ...]]:
    """Function that serves the chosen slot: the next decision's clock and bits, the request's index and its wait."""

    def serve(
        clock: jax.Array, unserved: jax.Array, table: jax.Array, chosen: jax.Array, following: jax.Array
    ) -> tuple[jax.Array, ...]:
        slots = [_columns(table, slot, clock.shape) for slot in range(size)]
        service, position, ready = slots[0].service, slots[0].position, slots[0].ready
        for number, slot in enumerate(slots[1:], start=1):
            hit = chosen == number
            service = jax.lax.select(hit, slot.service, service)
            position = jax.lax.select(hit, slot.position, position)
            ready = jax.lax.select(hit, slot.ready, ready)
        left = unserved & ~jax.lax.shift_left(jnp.ones_like(chosen), chosen)
        earliest = jnp.broadcast_to(following, clock.shape)
        for number, slot in reversed(list(enumerate(slots))):
            earliest = jax.lax.select(left & _bit(number) != 0, slot.ready, earliest)
        wait_ms = (clock - ready).astype(jnp.float32) * tick_ms
        return jnp.maximum(clock + service, earliest), left, position + offset, wait_ms

    return serve


def _admit(state: _State, source: jax.Array) -> _State:
    """Append every request that has arrived in some lane; drop those that all lanes have served.

    A size beyond `SLOTS` says that the list is full.
    """
    now = jnp.max(state.clock)
    needed = jax.lax.reduce(state.unserved, jnp.int32(0), jax.lax.bitwise_or, (0,))
    slot = jnp.arange(SLOTS, dtype=jnp.int32)

    def cond(carry: _Admission) -> jax.Array:
        size, upcoming, needed = carry[2]
        return ((source[upcoming, 0] <= now) | (_first_gap(needed) < size)) & (size <= SLOTS)

    def body(carry: _Admission) -> _Admission:
        unserved, table, (size, upcoming, needed) = carry
        gap = _first_gap(needed)
        drop = gap < size
        below = jax.lax.shift_left(jnp.int32(1), gap) - 1

        def close_gap(bits: jax.Array) -> jax.Array:
            moved = (bits & below) | (jax.lax.shift_right_logical(bits, jnp.ones_like(bits)) & ~below)
            return jnp.where(drop, moved, bits)

        shifted = jnp.concatenate([table[:, 1:], table[:, -1:]], axis=1)
        table = jnp.where((drop & (slot >= gap))[None], shifted, table)
        last = jnp.where(drop, size - 1, size)
        # Without an arrival the slot that is written stays outside the list.
        row = jax.lax.dynamic_index_in_dim(source, upcoming, 0, keepdims=False)
        arrival = (source[upcoming, 0] <= now).astype(jnp.int32)
        mark = jax.lax.shift_left(arrival, last)
        table = jax.lax.dynamic_update_slice(table, row[:, None], (jnp.int32(0), last))
        numbers = jnp.stack([last + arrival, upcoming + arrival, close_gap(needed) | mark])
        return close_gap(unserved) | mark, table, numbers

    numbers = jnp.stack([state.size, state.upcoming, needed])
    unserved, table, (size, upcoming, _) = jax.lax.while_loop(cond, body, (state.unserved, state.table, numbers))
    return state._replace(unserved=unserved, table=table, size=size, upcoming=upcoming)


def _first_gap(bits: jax.Array) -> jax.Array:
    """Position of the lowest zero bit."""
    return jax.lax.population_count((~bits & -~bits) - 1)

"""One trace under many parameter settings, side by side: the compiled kernel of grids of queue replays.

A decision is one fused loop over lanes, of as many steps as their common list of requests has slots, rounded up to one
of a few sizes, see `lane_list`. Where a list outgrows its slots the trace is replayed by `queue_replay.served_order`
instead, so results are exact whatever the load.
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp

from ovibjax.scheduling.lane_list import SLOTS, LaneState, ListedRequests, admit, bit, listed_table, slot_fields
from ovibjax.scheduling.queue_replay import served_order, to_trace_order
from ovibjax.scheduling.requests import NEVER, Requests
from ovibjax.scheduling.rules import SchedulerParams, scheduling_value, term_scales, timing, weighted_sum
from ovibjax.scheduling.ties import tie_order

_SIZES = (1, 2, 3, 4, 6, 8, 12, 16, SLOTS)

_Carry = tuple[LaneState, jax.Array, jax.Array]


def lane_waits(requests: Requests, params: SchedulerParams, policy: str, n_lanes: int) -> jax.Array:
    """Waits [L, J] of one trace under L settings."""
    overflow, where, wait_ms = _decisions(requests, params, policy, n_lanes)
    shape = n_lanes, requests.ready.size
    flat = jnp.zeros(n_lanes * requests.ready.size, jnp.float32)
    flat = flat.at[where.ravel()].set(wait_ms.ravel(), unique_indices=True, mode="promise_in_bounds")
    every = broadcast_params(params, n_lanes)

    def again(lane: jax.Array, waits: jax.Array) -> jax.Array:
        chosen: SchedulerParams = jax.tree.map(lambda leaf: leaf[lane], every)
        return waits.at[lane].set(to_trace_order(requests, served_order(requests, policy, chosen)))

    # A loop of no turns, not a conditional: it changes the waits in place.
    return jax.lax.fori_loop(0, jnp.where(overflow, n_lanes, 0), again, flat.reshape(shape))


def broadcast_params(params: SchedulerParams, n_lanes: int) -> SchedulerParams:
    """Leaves [L], those that are not swept repeated."""
    broadcast: SchedulerParams = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (n_lanes,)), params)
    return broadcast


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
    params = broadcast_params(params, n_lanes)
    offset = n_requests * jnp.arange(n_lanes, dtype=jnp.int32)
    source = listed_table(requests, params.value)
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
        state = admit(state._replace(clock=clock, unserved=unserved), source)
        # A list that overflowed ends the replay.
        done = jnp.where(state.size > SLOTS, n_requests + 1, state.done + 1)
        return state._replace(done=done), wheres, waits

    first = LaneState(
        done=jnp.int32(0),
        clock=jnp.broadcast_to(jnp.where(requests.total > 0, requests.ready[0], 0), (n_lanes,)),
        unserved=jnp.zeros(n_lanes, jnp.int32),
        table=jnp.zeros((len(ListedRequests._fields), SLOTS), jnp.int32),
        size=jnp.int32(0),
        upcoming=jnp.int32(0),
    )
    wheres = requests.position[:, None] + offset[None]
    carry = (admit(first, source), wheres, jnp.full(wheres.shape, jnp.nan, jnp.float32))
    state, wheres, waits = jax.lax.while_loop(cond, body, carry)
    return (state.done > n_requests) | (state.size > SLOTS), wheres, waits


def _choice(policy: str, size: int, params: SchedulerParams, common_value: bool) -> Callable[..., jax.Array]:
    """Function of clock, unserved bits and list that returns each lane's slot to serve."""
    if size == 1:
        return _only_slot
    if policy == "voi_lyapunov":
        return partial(_shaped_choice, size, params, common_value)
    return partial(_head_of_line_choice, size, params)


def _only_slot(clock: jax.Array, unserved: jax.Array, table: jax.Array) -> jax.Array:
    """A list of one slot leaves no choice."""
    return jnp.zeros_like(clock)


def _shaped_choice(
    size: int, params: SchedulerParams, common_value: bool, clock: jax.Array, unserved: jax.Array, table: jax.Array
) -> jax.Array:
    """Slots of the largest score of eq. "voi_scheduler_impl", as `rules.voi_lyapunov` has it."""
    slots = [slot_fields(table, slot, clock.shape) for slot in range(size)]
    nothing = jnp.full(clock.shape, jnp.nan, jnp.float32)
    infinite = jnp.full(clock.shape, jnp.inf, jnp.float32)
    low, high, terms = [infinite] * 6, [-infinite] * 6, []
    for number, slot in enumerate(slots):
        waiting = (unserved & bit(number) != 0) & (slot.ready <= clock)
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
    return _first_best([weighted_sum(term, scales) for term in terms], slots, params.ties)


def _head_of_line_choice(
    size: int, params: SchedulerParams, clock: jax.Array, unserved: jax.Array, table: jax.Array
) -> jax.Array:
    """Slots of the largest Q + V nu among the heads of line, as `rules.base_dpp` has it."""
    slots = [slot_fields(table, slot, clock.shape) for slot in range(size)]
    waiting = jnp.zeros_like(clock)
    for number, slot in enumerate(slots):
        waiting = waiting | jax.lax.select(slot.ready <= clock, jnp.full_like(clock, bit(number)), waiting * 0)
    waiting = waiting & unserved
    client = table[ListedRequests._fields.index("client")]
    bits = jnp.array([bit(number) for number in range(SLOTS)])
    same = jnp.sum(jnp.where(client[:, None] == client[None, :], bits, 0), axis=1, dtype=jnp.int32)
    priorities = []
    for number, slot in enumerate(slots):
        pending = waiting & same[number]
        earlier = pending & (bit(number) - 1)
        backlog = jax.lax.population_count(pending).astype(jnp.float32)
        eligible = (pending & bit(number) != 0) & (earlier == 0)
        priorities.append(jnp.where(eligible, backlog + params.V * slot.voi_m, -jnp.inf))
    return _first_best(priorities, slots, params.ties)


def _first_best(priorities: list[jax.Array], slots: list[ListedRequests], ties: jax.Array) -> jax.Array:
    """Slot of the largest priority, among equals as `ties.served_first` has it; NaN never wins."""
    best = jnp.full_like(priorities[0], -jnp.inf)
    chosen, least = jnp.zeros(best.shape, jnp.int32), jnp.zeros(best.shape, jnp.int32)
    for number, (priority, slot) in enumerate(zip(priorities, slots, strict=True)):
        # Slots are in the order of arrival.
        order = tie_order(slot.client, number, ties)
        better = (priority > best) | ((priority == best) & (order < least))
        best = jax.lax.select(better, priority, best)
        least = jax.lax.select(better, order, least)
        chosen = jax.lax.select(better, jnp.full_like(chosen, number), chosen)
    return chosen


def _service(size: int, offset: jax.Array, tick_ms: jax.Array) -> Callable[..., tuple[jax.Array, ...]]:
    """Function that serves the chosen slot: the next decision's clock and bits, the request's index and its wait."""

    def serve(
        clock: jax.Array, unserved: jax.Array, table: jax.Array, chosen: jax.Array, following: jax.Array
    ) -> tuple[jax.Array, ...]:
        slots = [slot_fields(table, slot, clock.shape) for slot in range(size)]
        service, position, ready = slots[0].service, slots[0].position, slots[0].ready
        for number, slot in enumerate(slots[1:], start=1):
            hit = chosen == number
            service = jax.lax.select(hit, slot.service, service)
            position = jax.lax.select(hit, slot.position, position)
            ready = jax.lax.select(hit, slot.ready, ready)
        left = unserved & ~jax.lax.shift_left(jnp.ones_like(chosen), chosen)
        earliest = jnp.broadcast_to(following, clock.shape)
        for number, slot in reversed(list(enumerate(slots))):
            earliest = jax.lax.select(left & bit(number) != 0, slot.ready, earliest)
        wait_ms = (clock - ready).astype(jnp.float32) * tick_ms
        return jnp.maximum(clock + service, earliest), left, position + offset, wait_ms

    return serve

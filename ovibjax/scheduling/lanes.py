"""One trace under many parameter settings, side by side: the compiled kernel of grids of queue replays.

Requests that contend with no other start when they would under FIFO. The others are replayed stretch by stretch, see
`stretches`, in all lanes. A decision is one fused loop over lanes, of as many steps as their common list of requests
has slots, rounded up to one of a few sizes, see `lane_list`. Where a list outgrows its slots the stretch is replayed by
`wide_lanes` instead, so results are exact whatever the load.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.scheduling.lane_list import SLOTS, Slot, bit, drop, request_table, slots_of
from ovibjax.scheduling.lane_rules import better, nothing_yet, shaped_terms, unbounded, widened
from ovibjax.scheduling.queue_replay import to_trace_order
from ovibjax.scheduling.requests import Requests
from ovibjax.scheduling.rules import SchedulerParams, term_scales, weighted_sum
from ovibjax.scheduling.stretches import Stretches, contended, first_come
from ovibjax.scheduling.wide_lanes import wide_waits

_SIZES = (1, 2, 3, 4, 6, 8, 12, 16, 24, SLOTS)


class _State(NamedTuple):
    """Lanes between two decisions of a stretch.

    Attributes:
        left: int32 requests of the stretch that are still to be served.
        clock: [L] int32 ticks.
        served: [L] int32, the slots that the lane has served, as bits.
        listed: [SLOTS + 1] int32 sorted positions of the requests that some lane has not served, in order.
        longest: int32 longest list of the stretch so far.
        waits: [J, L] milliseconds, in the order of the trace.
    """

    left: jax.Array
    clock: jax.Array
    served: jax.Array
    listed: jax.Array
    longest: jax.Array
    waits: jax.Array


def lane_waits(requests: Requests, params: SchedulerParams, policy: str, n_lanes: int) -> jax.Array:
    """Waits [J, L] of one trace under L settings, in the order of the trace."""
    # Where the scheduling value is the same in all lanes it is a field of the list.
    common_value = all(leaf.ndim == 0 for leaf in params.value)
    ties = params.ties  # one number for all lanes costs them nothing
    params = broadcast_params(params, n_lanes)._replace(ties=ties)
    table = request_table(requests, params.value)
    start = first_come(requests)
    stretches = contended(requests, start)
    waits = jnp.broadcast_to(to_trace_order(requests, start)[:, None], (start.size, n_lanes))
    given = (requests, table, params)
    overflows, waits = _decisions(given, policy, common_value, stretches, waits)

    def again(_: jax.Array, waits: jax.Array) -> jax.Array:
        return wide_waits(given, policy, common_value, stretches, overflows, waits)

    # A loop of one turn or none, not a conditional: it changes the waits in place.
    return jax.lax.fori_loop(0, jnp.any(overflows).astype(jnp.int32), again, waits)


def broadcast_params(params: SchedulerParams, n_lanes: int) -> SchedulerParams:
    """Leaves [L], those that are not swept repeated."""
    broadcast: SchedulerParams = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (n_lanes,)), params)
    return broadcast


def _decisions(
    given: tuple[Requests, jax.Array, SchedulerParams],
    policy: str,
    common_value: bool,
    stretches: Stretches,
    waits: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Which stretches overflowed, [J // 2], and the waits [J, L] with those of the others written."""
    requests, table, params = given
    n_lanes = waits.shape[1]
    choices = [_choice(policy, size, params, common_value) for size in _SIZES]
    services = [partial(_serve, size) for size in _SIZES]

    def one_decision(state: _State) -> _State:
        arrived = table[state.listed, 0] <= jnp.max(state.clock)
        size = jnp.sum(arrived.astype(jnp.int32))
        tier = jnp.sum((size > jnp.array(_SIZES[:-1], jnp.int32)).astype(jnp.int32))
        shown = table[state.listed[:SLOTS]]
        # Branches of a conditional are materialized: without it the choice would be recomputed by each of its users.
        chosen = jax.lax.switch(tier, choices, state.left, state.clock, state.served, shown)[0]
        waits = _note(state, chosen, requests)
        clock, served = jax.lax.switch(tier, services, state.clock, state.served, shown, chosen)
        listed, served = drop(state.listed, served)
        return _State(state.left - 1, clock, served, listed, jnp.maximum(state.longest, size), waits)

    def one_stretch(number: jax.Array, carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        overflows, waits = carry
        state = _State(
            left=stretches.length[number],
            clock=jnp.broadcast_to(stretches.begin[number], (n_lanes,)),
            served=jnp.zeros(n_lanes, jnp.int32),
            listed=stretches.first[number] + jnp.arange(SLOTS + 1, dtype=jnp.int32),
            longest=jnp.int32(0),
            waits=waits,
        )
        state = jax.lax.while_loop(lambda s: (s.left > 0) & (s.longest <= SLOTS), one_decision, state)
        return overflows.at[number].set(state.longest > SLOTS), state.waits

    none = jnp.zeros(stretches.first.shape, bool)
    return jax.lax.fori_loop(0, stretches.number, one_stretch, (none, waits))


def _choice(policy: str, size: int, params: SchedulerParams, common_value: bool) -> Callable[..., jax.Array]:
    """Function of requests left, clock, served bits and list that returns each lane's slot to serve, [2, L].

    An update in place is not divided among threads, which would cost more than it gains: the second row is not used.
    """
    rule = _shaped_choice if policy == "voi_lyapunov" else _head_of_line_choice

    def choose(left: jax.Array, clock: jax.Array, served: jax.Array, shown: jax.Array) -> jax.Array:
        rows = jnp.zeros((2, clock.size), jnp.int32)
        if size == 1:
            return rows
        chosen = rule(clock, served, shown[:size], params, common_value)
        first = jnp.minimum(left, 0)  # zero, which the compiler must not know
        return jax.lax.dynamic_update_slice(rows, chosen[None], (first, jnp.int32(0)))

    return choose


def _serve(
    size: int, clock: jax.Array, served: jax.Array, shown: jax.Array, chosen: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Clock and served bits after the chosen slots, of the first `size` ones, are served."""
    slots = slots_of(shown[:size], clock.shape)
    service = slots[0].service
    for number, slot in enumerate(slots[1:], start=1):
        service = jax.lax.select(chosen == number, slot.service, service)
    return clock + service, served | jax.lax.shift_left(jnp.ones_like(chosen), chosen)


def _note(state: _State, chosen: jax.Array, requests: Requests) -> jax.Array:
    """Write the waits of the requests that some lane has chosen, a request at a time."""
    bits = jax.lax.shift_left(jnp.ones_like(chosen), chosen)

    def one_request(carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        rest, waits = carry
        slot = jax.lax.population_count((rest & -rest) - 1)
        request = state.listed[slot]
        at = (requests.position[request], jnp.int32(0))
        wait_ms = (state.clock - requests.ready[request]).astype(jnp.float32) * requests.tick_ms
        before = jax.lax.dynamic_slice(waits, at, (1, chosen.size))[0]
        after = jnp.where(chosen == slot, wait_ms, before)
        return rest & (rest - 1), jax.lax.dynamic_update_slice(waits, after[None], at)

    anywhere = jax.lax.reduce(bits, jnp.int32(0), jax.lax.bitwise_or, (0,))
    return jax.lax.while_loop(lambda carry: carry[0] != 0, one_request, (anywhere, state.waits))[1]


def _shaped_choice(
    clock: jax.Array, served: jax.Array, shown: jax.Array, params: SchedulerParams, common_value: bool
) -> jax.Array:
    """Slots of the largest score of eq. "voi_scheduler_impl", as `rules.voi_lyapunov` has it."""
    slots = slots_of(shown, clock.shape)
    low, high = unbounded(clock.shape)
    terms = []
    for number, slot in enumerate(slots):
        waiting = (served & bit(number) == 0) & (slot.ready <= clock)
        terms.append(shaped_terms(slot, waiting, clock, params, common_value))
        low, high = widened(low, high, terms[-1])
    scales = term_scales(low, high, params.weights)
    return _first_best([weighted_sum(term, scales) for term in terms], slots, params.ties)


def _head_of_line_choice(
    clock: jax.Array, served: jax.Array, shown: jax.Array, params: SchedulerParams, common_value: bool
) -> jax.Array:
    """Slots of the largest Q + V nu among the heads of line, as `rules.base_dpp` has it."""
    slots = slots_of(shown, clock.shape)
    waiting = jnp.zeros_like(clock)
    for number, slot in enumerate(slots):
        waiting = waiting | jax.lax.select(slot.ready <= clock, jnp.full_like(clock, bit(number)), waiting * 0)
    waiting = waiting & ~served
    client = shown[:, Slot._fields.index("client")]
    bits = jnp.array([bit(number) for number in range(len(shown))])
    same = jnp.sum(jnp.where(client[:, None] == client[None, :], bits, 0), axis=1, dtype=jnp.int32)
    priorities = []
    for number, slot in enumerate(slots):
        pending = waiting & same[number]
        earlier = pending & (bit(number) - 1)
        backlog = jax.lax.population_count(pending).astype(jnp.float32)
        eligible = (pending & bit(number) != 0) & (earlier == 0)
        priorities.append(jnp.where(eligible, backlog + params.V * slot.voi_m, -jnp.inf))
    return _first_best(priorities, slots, params.ties)


def _first_best(priorities: list[jax.Array], slots: list[Slot], ties: jax.Array) -> jax.Array:
    """Slot of the largest priority."""
    best = nothing_yet(priorities[0].shape)
    for number, (priority, slot) in enumerate(zip(priorities, slots, strict=True)):
        best = better(best, priority, slot, number, ties)
    return best.slot

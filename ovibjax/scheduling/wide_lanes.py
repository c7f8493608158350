"""Stretches in which more requests wait at once than a short list holds: lanes whose list is gone through in parts.

What `lanes` does with bits is done here with rows over lanes, one per request, and with a list as long as the trace. A
decision costs what its waiting requests cost, however many they are.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.runtime.computed_once import computed_once
from ovibjax.scheduling.lane_list import Slot, slots_of
from ovibjax.scheduling.lane_rules import Best, better, nothing_yet, shaped_terms, unbounded, widened
from ovibjax.scheduling.requests import Requests
from ovibjax.scheduling.rules import SchedulerParams, term_scales, weighted_sum
from ovibjax.scheduling.stretches import Stretches

_PART = 4  # slots that one fused loop over lanes goes through
_WORD = 32


class _State(NamedTuple):
    """Lanes between two decisions of a stretch.

    Attributes:
        left: int32 requests of the stretch that are still to be served.
        clock: [L] int32 ticks.
        served: [J + 1, L] int8, one where the lane has served the request.
        backlog: [J, L] int16 waiting requests of a client, in the row of its first request; no rows if not needed.
        admitted: int32 sorted position before which every request has arrived in all lanes.
        listed: [J + PART] int32 sorted positions of the requests that some lane has not served, in order.
        dropped: int32 requests of the stretch that are no longer listed.
        waits: [J, L] milliseconds, in the order of the trace.
    """

    left: jax.Array
    clock: jax.Array
    served: jax.Array
    backlog: jax.Array
    admitted: jax.Array
    listed: jax.Array
    dropped: jax.Array
    waits: jax.Array


class _Given(NamedTuple):
    """What no decision changes: sorted requests, their table (see `lane_list`), parameters [L]."""

    requests: Requests
    table: jax.Array
    params: SchedulerParams


def wide_waits(
    given: tuple[Requests, jax.Array, SchedulerParams],
    policy: str,
    common_value: bool,
    stretches: Stretches,
    chosen: jax.Array,
    waits: jax.Array,
) -> jax.Array:
    """Waits after some stretches are replayed with lists of any length.

    Args:
        given: sorted requests, leaves [J]; their table of slots; parameters, leaves [L].
        policy: a rule whose grids go by lanes.
        common_value: whether the scheduling value is the same in all lanes.
        stretches: of the trace.
        chosen: [J // 2] bool, which of them to replay.
        waits: [J, L] milliseconds, in the order of the trace.

    Returns:
        The waits, those of the chosen stretches written.
    """
    known = _Given(*given)
    size, n_lanes = waits.shape
    by_client = policy == "base_dpp"
    choose = partial(_heads_of_line if by_client else _shaped, known, common_value)

    def one_stretch(number: jax.Array, carry: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        served, backlog, waits = carry
        first = stretches.first[number]
        length = jnp.where(chosen[number], stretches.length[number], 0)  # nothing to do in the others
        end = first + length
        begin = jnp.broadcast_to(stretches.begin[number], (n_lanes,))
        listed = first + jnp.arange(size + _PART, dtype=jnp.int32)
        state = _State(length, begin, served, backlog, first, listed, jnp.int32(0), waits)
        admit = partial(_admit, known, by_client, end)
        state = admit(state, jnp.full(n_lanes, -1))

        def one_decision(state: _State) -> _State:
            arrived = jnp.max(state.clock)
            waiting = jnp.searchsorted(known.requests.ready, arrived, side="right").astype(jnp.int32)
            slots = jnp.minimum(waiting, end) - first - state.dropped
            before = state.clock
            return admit(_serve(known, by_client, state, slots, choose(state, slots, first)), before)

        state = jax.lax.while_loop(lambda state: state.left > 0, one_decision, state)
        return state.served, state.backlog, state.waits

    served = jnp.zeros((size + 1, n_lanes), jnp.int8)
    backlog = jnp.zeros((size, n_lanes) if by_client else (0, n_lanes), jnp.int16)
    return jax.lax.fori_loop(0, stretches.number, one_stretch, (served, backlog, waits))[2]


def _admit(given: _Given, by_client: bool, end: jax.Array, state: _State, before: jax.Array) -> _State:
    """Count the requests that arrived after the clocks `before`, up to those of now."""
    if not by_client:
        return state
    ready, group = given.requests.ready, given.requests.group
    last = jnp.max(state.clock)

    def count(carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        request, backlog = carry
        arrives = (ready[request] > before) & (ready[request] <= state.clock)
        return request + 1, backlog.at[group[request]].add(arrives.astype(jnp.int16))

    def more(carry: tuple[jax.Array, jax.Array]) -> jax.Array:
        return (carry[0] < end) & (ready[jnp.minimum(carry[0], ready.size - 1)] <= last)

    backlog = jax.lax.while_loop(more, count, (state.admitted, state.backlog))[1]
    in_all = jnp.searchsorted(ready, jnp.min(state.clock), side="right").astype(jnp.int32)
    return state._replace(backlog=backlog, admitted=jnp.minimum(in_all, end))


def _part(given: _Given, state: _State, number: jax.Array) -> tuple[list[Slot], jax.Array, list[jax.Array]]:
    """Slots of one part of the list, their sorted positions, and whether each waits, [L]."""
    places = jax.lax.dynamic_slice_in_dim(state.listed, number * _PART, _PART)
    slots = slots_of(given.table[places], state.clock.shape)
    rows = [jax.lax.dynamic_index_in_dim(state.served, place, keepdims=False) for place in places]
    return slots, places, [(row == 0) & (slot.ready <= state.clock) for row, slot in zip(rows, slots, strict=True)]


def _shaped(given: _Given, common_value: bool, state: _State, n_slots: jax.Array, first: jax.Array) -> jax.Array:
    """[L] slots of the largest score of eq. "voi_scheduler_impl"."""
    del first
    parts = (n_slots + _PART - 1) // _PART

    def terms_of(number: jax.Array) -> tuple[list[Slot], list[tuple[jax.Array, ...]]]:
        slots, _, waiting = _part(given, state, number)
        pairs = zip(slots, waiting, strict=True)
        return slots, [shaped_terms(slot, waits, state.clock, given.params, common_value) for slot, waits in pairs]

    def widen(number: jax.Array, bounds: tuple[list[jax.Array], list[jax.Array]]) -> Any:
        for terms in terms_of(number)[1]:
            bounds = widened(*bounds, terms)
        return bounds

    low, high = jax.lax.fori_loop(0, parts, widen, unbounded(state.clock.shape))
    scales = term_scales(low, high, given.params.weights)

    def priorities(number: jax.Array) -> jax.Array:
        return jnp.stack([weighted_sum(terms, scales) for terms in terms_of(number)[1]])

    return _best_of_parts(given, state, parts, priorities)


def _heads_of_line(given: _Given, common_value: bool, state: _State, n_slots: jax.Array, first: jax.Array) -> jax.Array:
    """[L] slots of the largest Q + V nu among the heads of line."""
    del common_value
    r = given.requests

    def priorities(number: jax.Array) -> jax.Array:
        slots, places, waiting = _part(given, state, number)
        rows = []
        for place, slot, waits in zip(places, slots, waiting, strict=True):
            before = r.previous[place]
            head = (before < first) | (state.served[before] != 0)
            backlog = state.backlog[r.group[place]].astype(jnp.float32)
            rows.append(jnp.where(waits & head, backlog + given.params.V * slot.voi_m, -jnp.inf))
        return jnp.stack(rows)

    return _best_of_parts(given, state, (n_slots + _PART - 1) // _PART, priorities)


def _best_of_parts(
    given: _Given, state: _State, parts: jax.Array, priorities: Callable[[jax.Array], jax.Array]
) -> jax.Array:
    """[L] slots of the largest of the priorities [PART, L] of each part."""

    def improve(number: jax.Array, best: Best) -> Best:
        slots = _part(given, state, number)[0]
        # Once: a number that is rounded in one way here and in another there is not equal to itself.
        rows = computed_once(number >= 0, priorities, number)
        for i, (slot, priority) in enumerate(zip(slots, rows, strict=True)):
            best = better(best, priority, slot, number * _PART + i, given.params.ties)
        return best

    return jax.lax.fori_loop(0, parts, improve, nothing_yet(state.clock.shape)).slot


def _serve(given: _Given, by_client: bool, state: _State, n_slots: jax.Array, chosen: jax.Array) -> _State:
    """Serve the chosen slots [L], a request that some lane has chosen at a time."""
    r = given.requests
    clock = state.clock
    bits = jax.lax.shift_left(jnp.ones_like(chosen), chosen & (_WORD - 1))

    def one_request(carry: tuple[jax.Array, jax.Array, jax.Array, _State]) -> Any:
        word, rest, gone, state = carry
        slot = word * _WORD + jax.lax.population_count((rest & -rest) - 1)
        request = state.listed[slot - gone]
        here = chosen == slot
        served = jnp.where(here, jnp.int8(1), state.served[request])
        wait_ms = (clock - r.ready[request]).astype(jnp.float32) * r.tick_ms
        waits = jnp.where(here, wait_ms, state.waits[r.position[request]])
        backlog = state.backlog
        if by_client:
            backlog = backlog.at[r.group[request]].add(-here.astype(jnp.int16))
        done = jnp.min(served).astype(jnp.int32)  # one if in all lanes: off the list
        kept = jnp.arange(state.listed.size) < jnp.where(done > 0, slot - gone, state.listed.size)
        later = jnp.concatenate([state.listed[1:], state.listed[-1:] + 1])
        state = state._replace(
            clock=jnp.where(here, clock + r.service[request], state.clock),
            served=state.served.at[request].set(served),
            backlog=backlog,
            listed=jnp.where(kept, state.listed, later),
            dropped=state.dropped + done,
            waits=state.waits.at[r.position[request]].set(waits),
        )
        return word, rest & (rest - 1), gone + done, state

    def one_word(word: jax.Array, carry: tuple[jax.Array, _State]) -> tuple[jax.Array, _State]:
        gone, state = carry
        mine = jnp.where(chosen // _WORD == word, bits, 0)
        anywhere = jax.lax.reduce(mine, jnp.int32(0), jax.lax.bitwise_or, (0,))
        carried = (word, anywhere, gone, state)
        _, _, gone, state = jax.lax.while_loop(lambda carry: carry[1] != 0, one_request, carried)
        return gone, state

    words = (n_slots + _WORD - 1) // _WORD
    state = jax.lax.fori_loop(0, words, one_word, (jnp.int32(0), state._replace(left=state.left - 1)))[1]
    return state

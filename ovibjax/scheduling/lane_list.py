"""The requests that some lane still has to serve: one short list, sorted by arrival, common to all lanes.

Lanes are parameter settings that replay the same trace. They serve different requests, but the requests that any lane
still needs are few: the fields of a request are scalars, and a lane carries its clock and one bit per slot of the list.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.scheduling.requests import NEVER, Requests
from ovibjax.scheduling.rules import ValueCoefficients, scheduling_value

SLOTS = 32
"""Requests a list can hold: the bits of a word."""


class ListedRequests(NamedTuple):
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


class LaneState(NamedTuple):
    """State between decisions: clock and unserved slots of each lane; list, its size, next request to admit."""

    done: jax.Array
    clock: jax.Array
    unserved: jax.Array
    table: jax.Array
    size: jax.Array
    upcoming: jax.Array


_Admission = tuple[jax.Array, jax.Array, jax.Array]


def listed_table(requests: Requests, coefficients: ValueCoefficients) -> jax.Array:
    """Fields of `ListedRequests` of each request, [J + 1, fields] int32; the last row never arrives."""
    r = requests
    first: ValueCoefficients = jax.tree.map(lambda leaf: leaf[0], coefficients)
    value = scheduling_value(r.voi_m, r.drift_m_per_s, r.risk_m, r.delay_est_ms, r.urgency, first)
    known = {"value": value, "density": value / r.service_est_ms}
    rows = [known[name] if name in known else getattr(r, name) for name in ListedRequests._fields]
    table = jnp.stack([jax.lax.bitcast_convert_type(row, jnp.int32) for row in rows], axis=1)
    return jnp.concatenate([table, jnp.full((1, len(rows)), NEVER)])


def bit(slot: int) -> jax.Array:
    """The int32 in which one slot's bit is set."""
    return jnp.asarray(np.array(1 << slot, np.uint32).view(np.int32))


def slot_fields(table: jax.Array, slot: int, shape: tuple[int, ...]) -> ListedRequests:
    """Fields of one slot, broadcast over lanes."""
    fields = {}
    for row, name in enumerate(ListedRequests._fields):
        value = table[row, slot]
        if name not in ("ready", "service", "position", "client"):
            value = jax.lax.bitcast_convert_type(value, jnp.float32)
        fields[name] = jnp.broadcast_to(value, shape)
    return ListedRequests(**fields)


def admit(state: LaneState, source: jax.Array) -> LaneState:
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

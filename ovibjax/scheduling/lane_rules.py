"""Priorities of the rules whose grids go by lanes, a request at a time: a request's fields are the same for all lanes.

What `rules` computes over a queue, written as loops that keep the least, the most and the best so far, so that a list
of any length can be gone through in parts.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.scheduling.lane_list import Slot
from ovibjax.scheduling.rules import SchedulerParams, scheduling_value, timing
from ovibjax.scheduling.ties import tie_order

TERMS = 6
"""Terms of the shaped rule's score."""


class Best(NamedTuple):
    """What each lane would serve so far: [L] priority, order among equals, and slot."""

    priority: jax.Array
    order: jax.Array
    slot: jax.Array


def nothing_yet(shape: tuple[int, ...]) -> Best:
    """Nothing found; the slot is 0."""
    none = jnp.zeros(shape, jnp.int32)
    return Best(jnp.full(shape, -jnp.inf, jnp.float32), none, none)


def better(best: Best, priority: jax.Array, slot: Slot, number: int | jax.Array, ties: jax.Array) -> Best:
    """The best after one more slot, among equals as `ties.served_first` has it; NaN never wins.

    Args:
        best: of the slots before.
        priority: [L], -inf or NaN where the request may not be served.
        slot: the request.
        number: its slot; slots are in the order of arrival.
        ties: int32 index into `TIES`, scalar or [L].

    Returns:
        The best of both.
    """
    shape = best.priority.shape
    order = jnp.broadcast_to(tie_order(slot.client, number, ties), shape)
    wins = (priority > best.priority) | ((priority == best.priority) & (order < best.order))
    return Best(
        jax.lax.select(wins, priority, best.priority),
        jax.lax.select(wins, order, best.order),
        jax.lax.select(wins, jnp.broadcast_to(jnp.int32(number), shape), best.slot),
    )


def shaped_terms(
    slot: Slot, waiting: jax.Array, clock: jax.Array, params: SchedulerParams, common_value: bool
) -> tuple[jax.Array, ...]:
    """Terms of the score of eq. "voi_scheduler_impl": v / G, v, laxity, age, overrun, G.

    Args:
        slot: the request, fields [L].
        waiting: [L] bool.
        clock: [L] int32 ticks.
        params: leaves [L].
        common_value: whether the scheduling value is the same in all lanes, and in the slot.

    Returns:
        Six terms [L], NaN where the request does not wait.
    """
    nothing = jnp.full(clock.shape, jnp.nan, jnp.float32)
    age = jax.lax.select(waiting, (clock - slot.ready).astype(jnp.float32), nothing)
    fixed = (slot.density, slot.value, slot.service_est_ms)
    if not common_value:
        value = scheduling_value(
            slot.voi_m, slot.drift_m_per_s, slot.risk_m, slot.delay_est_ms, slot.urgency, params.value
        )
        fixed = (value / slot.service_est_ms, value, slot.service_est_ms)
    density, worth, length = (jax.lax.select(waiting, term, nothing) for term in fixed)
    return (density, worth, *timing(age, slot.slack, slot.per_deadline), length)


def widened(
    low: Sequence[jax.Array], high: Sequence[jax.Array], terms: Sequence[jax.Array]
) -> tuple[list[jax.Array], list[jax.Array]]:
    """Least and most of each term after one more request; NaN leaves no trace."""
    # Not the minimum function: a comparison with NaN is false.
    least = [jax.lax.select(term < bound, term, bound) for term, bound in zip(terms, low, strict=True)]
    most = [jax.lax.select(term > bound, term, bound) for term, bound in zip(terms, high, strict=True)]
    return least, most


def unbounded(shape: tuple[int, ...]) -> tuple[list[jax.Array], list[jax.Array]]:
    """Least and most of each term over no request."""
    infinite = jnp.full(shape, jnp.inf, jnp.float32)
    return [infinite] * TERMS, [-infinite] * TERMS

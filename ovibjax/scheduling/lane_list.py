"""The requests of a stretch that some lane still has to serve: one short list, sorted by arrival, common to all lanes.

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


class Slot(NamedTuple):
    """What lanes see of one request."""

    ready: jax.Array
    service: jax.Array
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


def request_table(requests: Requests, coefficients: ValueCoefficients) -> jax.Array:
    """Fields of `Slot` of each request, floats as their bits, [J + SLOTS + 1, fields] int32; the last never arrive."""
    r = requests
    first: ValueCoefficients = jax.tree.map(lambda leaf: leaf[0], coefficients)
    value = scheduling_value(r.voi_m, r.drift_m_per_s, r.risk_m, r.delay_est_ms, r.urgency, first)
    known = {"value": value, "density": value / r.service_est_ms}
    rows = [known[name] if name in known else getattr(r, name) for name in Slot._fields]
    table = jnp.stack([jax.lax.bitcast_convert_type(row, jnp.int32) for row in rows], axis=1)
    return jnp.concatenate([table, jnp.full((SLOTS + 1, len(rows)), NEVER)])


def bit(slot: int) -> jax.Array:
    """The int32 in which one slot's bit is set."""
    return jnp.asarray(np.array(1 << slot, np.uint32).view(np.int32))


def slots_of(shown: jax.Array, shape: tuple[int, ...]) -> list[Slot]:
    """Slots of a part [W, fields] of the table, each field broadcast over lanes."""
    slots = []
    for row in shown:
        fields = {}
        for name, value in zip(Slot._fields, row, strict=True):
            whole = name in ("ready", "service", "client")
            number = value if whole else jax.lax.bitcast_convert_type(value, jnp.float32)
            fields[name] = jnp.broadcast_to(number, shape)
        slots.append(Slot(**fields))
    return slots


def drop(listed: jax.Array, served: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Take the first request that all lanes have served, if there is one, off the list, and put the next one on it.

    Args:
        listed: [SLOTS + 1] int32 sorted positions.
        served: [L] int32 bits.

    Returns:
        Both without that slot.
    """
    common = jax.lax.reduce(served, jnp.int32(-1), jax.lax.bitwise_and, (0,))
    below = (common & -common) - 1  # all ones where there is none
    gap = jnp.where(common == 0, SLOTS + 1, jax.lax.population_count(below))
    longer = jnp.concatenate([listed, listed[-1:] + 1])
    listed = jnp.where(jnp.arange(SLOTS + 1) < gap, longer[:-1], longer[1:])
    later = jax.lax.shift_right_logical(served, jnp.ones_like(served))
    return listed, (served & below) | (later & ~below)

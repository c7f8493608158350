"""Where along a trace a server has a choice: stretches of requests that contend with each other and with no others.

A server that never idles while a request waits is done with the first m requests at the same time in whatever order it
serves them, as long as it serves no later one before. What a rule decides is therefore local: a stretch ends before a
request that arrives while the last of those before is served. Its start is known without a replay, and stretches do not
depend on each other. First come, first served is the closed form that all of this follows from.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.scheduling.requests import NEVER, Requests


class Stretches(NamedTuple):
    """Stretches of two or more requests.

    Attributes:
        first: [J // 2] int32 sorted position of the first request.
        length: [J // 2] int32 number of requests.
        begin: [J // 2] int32 ticks at which the first of them is served.
        number: int32 number of stretches; the rest of the fields means nothing.
    """

    first: jax.Array
    length: jax.Array
    begin: jax.Array
    number: jax.Array


def first_come(requests: Requests) -> jax.Array:
    """Start of each service under FIFO: each request when it has arrived and those before are done.

    Args:
        requests: sorted, leaves [J].

    Returns:
        [J] int32 ticks.
    """
    # A CPU adds up a trace in microseconds, and many traces side by side; an accelerator would wait at every request.
    return jax.lax.platform_dependent(requests.ready, requests.service, cpu=one_by_one, default=in_closed_form)


def one_by_one(ready: jax.Array, service: jax.Array) -> jax.Array:
    """`first_come`, a request after another."""

    def step(free: jax.Array, request: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        start = jnp.maximum(free, request[0])
        return start + request[1], start

    return jax.lax.scan(step, jnp.int32(0), (ready, service))[1]


def in_closed_form(ready: jax.Array, service: jax.Array) -> jax.Array:
    """`first_come` with S_j the services up to j added up: S_{j-1} + max over i <= j of (ready_i - S_{i-1})."""
    before = jnp.cumsum(service) - service
    return before + jax.lax.cummax(ready - before)


def openings(requests: Requests, start: jax.Array) -> jax.Array:
    """Which requests are the first of a stretch.

    Args:
        requests: sorted, leaves [J].
        start: [J] ticks, from `first_come`.

    Returns:
        [J] bool; true for padding.
    """
    shortest = jnp.min(jnp.where(requests.valid, requests.service, NEVER))
    # In whatever order, the service that ends a stretch begins at least the shortest service before its end.
    done = jnp.concatenate([jnp.full(1, -1, jnp.int32), (start + requests.service)[:-1]])
    return requests.ready > done - shortest


def alone(requests: Requests, start: jax.Array) -> jax.Array:
    """[J] bool, which requests contend with no other; arguments as in `openings`."""
    opens = openings(requests, start)
    return opens & jnp.concatenate([opens[1:], jnp.ones(1, bool)]) & requests.valid


def contended(requests: Requests, start: jax.Array) -> Stretches:
    """Stretches of a trace in which the order of service is open; arguments as in `openings`."""
    size = start.size
    place = jnp.arange(size, dtype=jnp.int32)
    opens = openings(requests, start)
    following = jnp.concatenate([jnp.where(opens, place, size)[1:], jnp.full(1, size, jnp.int32)])
    length = jnp.where(opens & requests.valid, jax.lax.cummin(following, reverse=True) - place, 0)
    first = jnp.nonzero(length > 1, size=size // 2, fill_value=0)[0].astype(jnp.int32)
    return Stretches(first, length[first], start[first], jnp.sum((length > 1).astype(jnp.int32)))

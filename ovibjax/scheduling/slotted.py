"""Which clients to serve in a slot: the exact optimizer (paper, eqs. "voi_scheduler" and "queue").

A slot has few clients, so all 2^N subsets are compared. Their sums are those of two halves of the clients, added as
rows and columns of a table: what each problem keeps alive under `vmap` is little more than one vector of 2^N numbers.
"""

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

MAX_CLIENTS = 16
"""Clients of the largest problem that is solved: 65,536 subsets."""


def solve(
    backlog: ArrayLike,
    voi: ArrayLike,
    payload: ArrayLike,
    service: ArrayLike,
    V: ArrayLike,
    payload_budget: ArrayLike,
    service_budget: ArrayLike,
) -> jax.Array:
    """Clients that eq. "voi_scheduler" serves in one slot: the largest sum of Q + V nu within both budgets.

    Args:
        backlog: [N] pending requests Q; only clients with at least one (the set R_t) are eligible.
        voi: [N] net VOI nu of the head-of-line request, metres.
        payload: [N] payload b, bytes.
        service: [N] estimated service time G, any unit.
        V: weight of utility against delay.
        payload_budget: budget of the slot, bytes.
        service_budget: budget of the slot, the unit of `service`.

    Returns:
        [N] int32 x in {0, 1}; ties and rounding as in `best_subset`.

    Raises:
        ValueError: more than `MAX_CLIENTS` clients, or shapes that differ.
    """
    queue = jnp.asarray(backlog, jnp.float32)
    weight = queue + jnp.asarray(V, jnp.float32) * jnp.asarray(voi, jnp.float32)
    return best_subset(jnp.where(queue > 0, weight, 0.0), payload, service, payload_budget, service_budget)


def best_subset(
    weight: ArrayLike,
    payload: ArrayLike,
    service: ArrayLike,
    payload_budget: ArrayLike,
    service_budget: ArrayLike,
) -> jax.Array:
    """The subset of clients with the largest total weight within two budgets, by enumeration.

    A client whose weight is not positive is never chosen, nor is one with weight NaN. Among equal totals the subset
    with the lowest number sum_i x_i 2^i is taken. A budget whose costs and limit are integers is kept exactly; float32
    sums round (lower half of the clients, upper half, each in client order, then their sum), so fractions that should
    fill a budget to the brim are better given as integers of a smaller unit.

    Args:
        weight: [N] weights.
        payload: [N] first cost, not negative; integers or floats.
        service: [N] second cost, not negative; integers or floats.
        payload_budget: limit of the sum of the first cost.
        service_budget: limit of the sum of the second cost.

    Returns:
        [N] int32 x in {0, 1}; all zero where even the empty subset breaks a budget (negative or NaN).

    Raises:
        ValueError: more than `MAX_CLIENTS` clients, or shapes that differ.
    """
    value = jnp.asarray(weight, jnp.float32)
    costs, limits = zip(_comparable(payload, payload_budget), _comparable(service, service_budget), strict=True)
    if value.ndim != 1 or any(cost.shape != value.shape for cost in costs):
        shapes = ", ".join(str(array.shape) for array in (value, *costs))
        raise ValueError(f"weight, payload and service hold one number per client; their shapes are {shapes}")
    (n,) = value.shape
    if n > MAX_CLIENTS:
        raise ValueError(f"{n} clients are more than the {MAX_CLIENTS} whose subsets can be enumerated")
    value = jnp.where(value > 0, value, 0.0)  # a NaN compares false
    total, *used = (_subset_sums(array) for array in (value, *costs))
    fits = (used[0] <= limits[0]) & (used[1] <= limits[1])
    score = jnp.where(fits, total, -1.0)
    # Row by row: a maximum is several times faster than an argmax. The first of equals has no member of weight zero,
    # because without it the number would be lower.
    row = jnp.argmax(score.max(axis=1))
    chosen = row * score.shape[1] + jnp.argmax(score[row])
    return (chosen.astype(jnp.int32) >> jnp.arange(n, dtype=jnp.int32)) & 1


def update_queue(backlog: ArrayLike, x: ArrayLike, arrivals: ArrayLike) -> jax.Array:
    """Queues at the next slot, [Q - x]^+ + A (paper, eq. "queue").

    Args:
        backlog: [...] pending requests, integers or floats.
        x: [...] 1 where a request was served.
        arrivals: [...] 1 (or True) where a request is admitted.

    Returns:
        [...] pending requests, of the type of `backlog`.
    """
    queue = jnp.asarray(backlog)
    return jnp.maximum(queue - jnp.asarray(x, queue.dtype), 0) + jnp.asarray(arrivals, queue.dtype)


def _comparable(cost: ArrayLike, limit: ArrayLike) -> tuple[jax.Array, jax.Array]:
    """Costs and their budget in one type: int32 where both are integers, else float32."""
    whole = all(jnp.issubdtype(jnp.asarray(value).dtype, jnp.integer) for value in (cost, limit))
    kind = jnp.int32 if whole else jnp.float32
    return jnp.asarray(cost, kind), jnp.asarray(limit, kind)


def _subset_sums(values: jax.Array) -> jax.Array:
    """Sums of values [N] over all subsets; reshaped to [2^N], entry sum_i x_i 2^i is that of x."""
    half = len(values) // 2
    return _doubling(values[:half])[None, :] + _doubling(values[half:])[:, None]


def _doubling(values: jax.Array) -> jax.Array:
    sums = jnp.zeros(1, values.dtype)
    for value in values:
        sums = jnp.concatenate([sums, sums + value])
    return sums

"""The exact slotted optimizer in the setting of its theorem (paper, Section "VOI-Weighted Edge Scheduling").

Arrivals are independent of everything, request attributes are a random state per slot. Queues, utility, and the
distance from the best stationary policy are what the theorem is about.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from ovibjax.scheduling.slotted import best_subset, update_queue
from ovibjax.scheduling.stationary import Array, SlottedSystem


@dataclass(frozen=True)
class Horizon:
    """Length of a run.

    Attributes:
        blocks: blocks that are reported.
        slots: slots per block.
    """

    blocks: int
    slots: int


class Case(NamedTuple):
    """How the optimizer is run, and what it is compared with.

    Attributes:
        rate: [N] arrival rates, requests per slot, at most 1.
        serve_empty: whether clients without pending requests may be chosen too, as in the proof; False is R_t.
        offset: [N] metres subtracted from the values that the optimizer sees; zero in the paper.
        start: [N] queues at the first slot, in multiples of V.
        price: [N] prices of the benchmark.
    """

    rate: Array
    serve_empty: Array
    offset: Array
    start: Array
    price: Array


class Trace(NamedTuple):
    """Block means of a run.

    Attributes:
        utility: [B] predicted VOI of what was chosen, metres per slot.
        gap: [B] utility below the benchmark, metres per slot, with the benchmark's prices as control variate.
        backlog: [B] pending requests of all clients.
        left: [B] pending requests at the end of the block.
    """

    utility: jax.Array
    gap: jax.Array
    backlog: jax.Array
    left: jax.Array


def simulate(key: jax.Array, V: ArrayLike, case: Case, system: SlottedSystem, horizon: Horizon) -> Trace:
    """Run eq. "voi_scheduler", solved exactly in every slot, and the queues of eq. "queue".

    The gap is not a difference of two large noisy numbers. With prices theta and m(w) the largest sum of
    x (nu + theta) in state w, duality gives the benchmark as E[m(w)] - theta E[A], and x - A is the service of empty
    queues less the growth of the queue, which averages to zero in a stable queue. So the gap is the mean of
    m(w) - sum x (nu + theta), never negative, plus theta times the rate at which empty queues are served.

    Args:
        key: random key; runs with equal keys see the same states and arrivals.
        V: weight of utility against delay.
        case: arrivals, rule and benchmark.
        system: the system.
        horizon: length (static).

    Returns:
        Block means.
    """
    system = jax.tree.map(jnp.asarray, system)
    case = jax.tree.map(jnp.asarray, case)
    v = jnp.asarray(V, jnp.float32)
    states, clients = system.voi.shape

    def choose(weight: jax.Array, state: jax.Array) -> jax.Array:
        costs = system.payload[state], system.service[state]
        return best_subset(weight, *costs, system.payload_budget, system.service_budget)

    def dual(state: jax.Array) -> jax.Array:
        worth = system.voi[state] + case.price
        return jnp.sum(worth * choose(worth, state).astype(jnp.float32))

    most = jax.vmap(dual)(jnp.arange(states))

    def slot(carry: tuple[jax.Array, jax.Array], draw: tuple[jax.Array, jax.Array]) -> tuple[Any, None]:
        backlog, sums = carry
        state, uniform = draw
        queue, voi = backlog.astype(jnp.float32), system.voi[state]
        eligible = (backlog > 0) | case.serve_empty
        served = choose(jnp.where(eligible, queue + v * (voi - case.offset), 0.0), state)
        x = served.astype(jnp.float32)
        empty = x * (backlog == 0).astype(jnp.float32)
        gap = most[state] - jnp.sum(x * (voi + case.price)) + jnp.sum(empty * case.price)
        sums = sums + jnp.stack([jnp.sum(x * voi), gap, jnp.sum(queue)])
        return (update_queue(backlog, served, uniform < case.rate), sums), None

    def block(backlog: jax.Array, key: jax.Array) -> tuple[jax.Array, Trace]:
        key_state, key_arrival = jax.random.split(key)
        drawn = jax.random.randint(key_state, (horizon.slots,), 0, states)
        uniform = jax.random.uniform(key_arrival, (horizon.slots, clients))
        (backlog, sums), _ = jax.lax.scan(slot, (backlog, jnp.zeros(3)), (drawn, uniform))
        utility, gap, mean_backlog = sums / horizon.slots
        return backlog, Trace(utility, gap, mean_backlog, jnp.sum(backlog))

    start = jnp.round(v * case.start).astype(jnp.int32)
    return jax.lax.scan(block, start, jax.random.split(key, horizon.blocks))[1]


@dataclass(frozen=True)
class RunCases:
    """Member function of a sweep over `V`, `case` and `seed`.

    Attributes:
        horizon: length of a run.
    """

    horizon: Horizon

    def __call__(
        self, key: jax.Array, point: dict[str, jax.Array], shared: tuple[SlottedSystem, Case]
    ) -> dict[str, jax.Array]:
        """Run one case of one system; `shared` has a leading axis of cases."""
        system, cases = shared
        case = jax.tree.map(lambda leaf: leaf[point["case"]], cases)
        return simulate(key, point["V"], case, system, self.horizon)._asdict()

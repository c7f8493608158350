"""The queue of a coupled replay against the plain event loop, within one slot."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.scheduling.requests import RequestTrace
from ovibjax.scheduling.rules import POLICIES, default_params
from ovibjax.scheduling.shared_queue import Mission, Pool, serve_slot
from ovibjax.scheduling.ties import TIES
from tests.oracles import scheduling as oracle
from tests.scheduling.random_requests import CERTAIN, random_trace

CLIENTS, SLOT_MS = 24, 4000.0

serve = jax.jit(serve_slot, static_argnames="scheduler")


def one_each(seed: int, kind: str) -> RequestTrace:
    """A trace of one request per client."""
    return random_trace(seed, CLIENTS, kind)._replace(client=np.arange(CLIENTS, dtype=np.int32))


def pool_of(trace: RequestTrace) -> tuple[Pool, Mission]:
    leaves = {name: jnp.asarray(getattr(trace, name), jnp.float32) for name in RequestTrace._fields}
    made = {name: leaves[name] for name in Pool._fields if name in leaves}
    pool = Pool(waiting=jnp.asarray(trace.valid), sent_ms=jnp.zeros(CLIENTS, jnp.float32), **made)
    return pool, Mission(leaves["urgency"], leaves["deadline_ms"])


@pytest.mark.parametrize("policy", POLICIES)
def test_a_slot_is_served_as_by_the_event_loop(policy: str) -> None:
    orders = {ties: [] for ties in TIES}
    for seed in range(12):
        trace = one_each(seed, ("ties", "twins", "deadlines", "burst")[seed % 4])
        pool, mission = pool_of(trace)
        for ties in TIES:
            starts, order, gap = oracle.replay(trace, policy, ties=ties)
            assert gap > CERTAIN, "rounding decides: choose another seed"
            found, left, _ = serve(pool, jnp.float32(0.0), jnp.float32(SLOT_MS), mission, policy, default_params(ties))
            expected = [starts.get(i, np.nan) + trace.service_ms[i] for i in range(CLIENTS)]
            np.testing.assert_array_equal(found, np.array(expected, np.float32), err_msg=f"{ties} {seed}")
            assert not np.asarray(left.waiting).any()
            orders[ties].append(order)
    # Scores tie only where ages do, and equal arrivals go by client here.
    assert (orders["arrival"] != orders["client"]) == (policy not in ("fifo", "voi_lyapunov"))
    assert (orders["arrival"] != orders["last"]) == (policy != "fifo")

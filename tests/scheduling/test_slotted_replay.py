"""Runs of the slotted optimizer against a slot-by-slot Python one, and the estimator of the utility gap."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.scheduling.slotted_replay import Case, Horizon, RunCases, simulate
from ovibjax.scheduling.stationary import SlottedSystem, best_stationary, capacity, draw_system
from ovibjax.scheduling.theorem import stack
from tests.oracles import slotted as oracle

SYSTEM = draw_system(jax.random.key(3), states=8, clients=3, payload_budget=250, service_budget=70_000)
HORIZON = Horizon(blocks=4, slots=50)
run = jax.jit(simulate, static_argnums=4)


def case(rate, serve_empty=False, offset=0.0, start=0.0, price=0.0, clients=3):
    vectors = [np.broadcast_to(np.float32(value), clients) for value in (rate, offset, start, price)]
    return Case(vectors[0], np.array(serve_empty), *vectors[1:])


CASES = [
    case(0.4),
    case([0.2, 0.5, 0.6], serve_empty=True, price=[0.0, 1.5, 2.0]),
    case(0.5, offset=[4.0, 5.0, 6.0], start=[1.0, 2.0, 0.3], price=[-1.0, -2.0, 0.5]),
]


def draws(key, horizon, system):
    """The random numbers of a run, per block."""
    for key_block in jax.random.split(key, horizon.blocks):
        key_state, key_arrival = jax.random.split(key_block)
        states, clients = np.shape(system.voi)
        state = jax.random.randint(key_state, (horizon.slots,), 0, states)
        yield list(zip(state.tolist(), jax.random.uniform(key_arrival, (horizon.slots, clients)), strict=True))


@pytest.mark.parametrize("number", range(3))
def test_equals_slot_by_slot(number):
    key, v, made = jax.random.key(7), 3.0, CASES[number]
    trace = run(key, v, made, SYSTEM, HORIZON)
    backlog = [round(v * float(s)) for s in made.start]
    rate, offset, price = (np.asarray(leaf).tolist() for leaf in (made.rate, made.offset, made.price))
    for i, block in enumerate(draws(key, HORIZON, SYSTEM)):
        block = [(state, np.asarray(uniforms)) for state, uniforms in block]
        *sums, backlog = oracle.simulate(block, backlog, v, rate, bool(made.serve_empty), offset, price, SYSTEM)
        found = np.array([trace.utility[i], trace.gap[i], trace.backlog[i]])
        np.testing.assert_allclose(found, np.array(sums) / HORIZON.slots, rtol=1e-5, atol=1e-5)
        assert int(trace.left[i]) == sum(backlog)


def test_members_of_a_sweep_equal_single_runs():
    shared = (jax.tree.map(jnp.asarray, SYSTEM), jax.tree.map(jnp.asarray, stack(CASES)))
    points = {"case": jnp.array([0, 1, 2, 1]), "V": jnp.array([1.0, 3.0, 8.0, 20.0])}
    member = RunCases(HORIZON)
    key = jax.random.key(1)
    together = jax.jit(jax.vmap(member, (None, 0, None)))(key, points, shared)
    for i in range(4):
        alone = run(key, float(points["V"][i]), CASES[int(points["case"][i])], SYSTEM, HORIZON)
        for name, values in alone._asdict().items():
            np.testing.assert_allclose(together[name][i], values, rtol=1e-5, atol=1e-5, err_msg=name)
    assert len(np.unique(np.asarray(together["utility"]).sum(axis=1))) == 4


def test_one_client_in_closed_form():
    # Worth 1 or 10 metres: the optimizer serves a pending request at once, whatever it is worth and whatever V.
    ones = np.ones((2, 1), np.int32)
    system = SlottedSystem(ones, ones, np.array([[1.0], [10.0]], np.float32), np.int32(1), np.int32(1))
    horizon, key = Horizon(20, 1000), jax.random.key(0)
    exact = best_stationary(system, [0.1], exactly=True)
    for v in (1.0, 1000.0):
        pending = run(key, v, case(0.1, price=exact.price, clients=1), system, horizon)
        assert float(pending.utility.mean()) == pytest.approx(0.55, abs=0.06)
        assert float(pending.gap.mean()) == pytest.approx(exact.utility - 0.55, abs=0.06)
        assert float(pending.left.max()) <= 1
    empty = run(key, 1.0, case(0.1, serve_empty=True, clients=1), system, horizon)
    assert float(empty.utility.mean()) == pytest.approx(5.5, abs=0.1)
    assert float(jnp.abs(empty.gap).max()) == 0.0
    # With the values lowered by 10 it waits for a slot worth 10, at the price of a queue.
    made = case(0.1, offset=10.0, price=exact.price, clients=1)
    waits = run(key, 30.0, made._replace(start=made.price + 10.0), system, horizon)
    assert float(waits.gap.mean()) == pytest.approx(0.0, abs=0.02)
    assert float(waits.utility.mean()) == pytest.approx(1.0, abs=0.15)


def test_the_estimator_of_the_gap_is_unbiased():
    system = draw_system(jax.random.key(5), states=16, clients=4)
    rate = np.full(4, 0.85 * capacity(system, np.ones(4)))
    runs = jax.jit(jax.vmap(lambda key, made: simulate(key, 2.0, made, system, Horizon(20, 500)), (0, None)))
    for serve_empty in (False, True):
        benchmark = best_stationary(system, rate, exactly=not serve_empty)
        made = case(rate, serve_empty, price=benchmark.price, start=np.maximum(benchmark.price, 0.0), clients=4)
        trace = jax.device_get(runs(jax.random.split(jax.random.key(1), 24), made))
        plain = benchmark.utility - np.float64(trace.utility[:, 4:]).mean(axis=1)
        controlled = np.float64(trace.gap[:, 4:]).mean(axis=1)
        assert trace.gap.min() > -1e-4
        error = (plain - controlled).std(ddof=1) / np.sqrt(24)
        assert abs((plain - controlled).mean()) < 4 * error and error < 0.02
        assert controlled.std() < 0.8 * plain.std()

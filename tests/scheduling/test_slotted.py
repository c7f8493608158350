"""The slotted optimizer against brute force: exact on numbers that float32 holds exactly, close on others."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.scheduling.slotted import MAX_CLIENTS, best_subset, solve, update_queue
from tests.oracles import slotted as oracle

single, batched = jax.jit(solve), jax.jit(jax.vmap(solve))
choose = jax.jit(best_subset)
N = 5
whole = st.integers(-3, 4)
NUMBERS = st.tuples(
    *(st.lists(numbers, min_size=N, max_size=N) for numbers in (st.integers(0, 3), whole, *[st.integers(0, 4)] * 2)),
    *(st.integers(0, 3), st.integers(-1, 8), st.integers(-1, 8)),
)


def instances(n, count, seed):
    """Eighths everywhere: ties are frequent and every sum is exact in float32."""
    rng = np.random.default_rng(seed)

    def eighths(low, high, *shape):
        return (rng.integers(8 * low, 8 * high, (count, *shape)) / 8).astype(np.float32)

    backlog = rng.integers(0, 5, (count, n)).astype(np.float32)
    budgets = [np.where(rng.random(count) < 0.1, 0, eighths(0, 1 + n)).astype(np.float32) for _ in range(2)]
    v = rng.choice(np.float32([0, 0.5, 1, 8]), count)
    few = rng.random((count, 1)) < 0.3  # coarse values, so that subsets tie
    voi = np.where(few, np.round(eighths(-2, 3, n)), eighths(-2, 3, n)).astype(np.float32)
    payload = np.where(few, 1, eighths(0, 3, n)).astype(np.float32)
    return backlog, voi, payload, eighths(0, 3, n), v, *budgets


@pytest.mark.parametrize("n", [1, 2, 5, 8])
def test_equals_brute_force(n):
    columns = instances(n, 250, seed=n)
    found = np.asarray(batched(*columns))
    assert found.dtype == np.int32
    nothing = several = 0
    for row, x in zip(zip(*columns, strict=True), found, strict=True):
        backlog, voi, payload, service, v, *budgets = (value.tolist() for value in row)
        assert x.tolist() == oracle.solve(backlog, voi, payload, service, v, *budgets), row
        assert oracle.fits(x, payload, service, *budgets)
        assert not np.any(x[(np.array(backlog) == 0) | (np.array(backlog) + v * np.array(voi) <= 0)])
        nothing, several = nothing + (x.sum() == 0), several + (x.sum() > 1)
    assert nothing > 10 and (several > 50 or n < 3)  # the instances are not all alike


def test_real_numbers_reach_the_best_value_and_keep_the_budgets():
    rng = np.random.default_rng(0)
    count, n = 200, 7
    backlog = rng.poisson(1.5, (count, n)).astype(np.float32)
    voi, payload, service = (rng.lognormal(1.0, 1.0, (count, n)).astype(np.float32) for _ in range(3))
    v, payload_budget, service_budget = (rng.uniform(1.0, 10.0, count).astype(np.float32) for _ in range(3))
    columns = (backlog, voi, payload, service, v, payload_budget, service_budget)
    for row, x in zip(zip(*columns, strict=True), np.asarray(batched(*columns)), strict=True):
        q, nu, b, g, weight, *budgets = (np.asarray(value, np.float64) for value in row)
        best = oracle.solve(q, nu, b, g, weight, *budgets)
        value = (q + weight * nu) * (q > 0)
        np.testing.assert_allclose(value @ x, value @ best, rtol=1e-6)
        assert b @ x <= budgets[0] * (1 + 1e-6) and g @ x <= budgets[1] * (1 + 1e-6)


@settings(deadline=None, max_examples=100)
@given(NUMBERS)
def test_whole_numbers_of_any_kind(numbers):
    *vectors, v, payload_budget, service_budget = numbers
    backlog, voi, payload, service = (jnp.array(vector, jnp.int32) for vector in vectors)
    x = single(backlog, voi, payload, service, v, payload_budget, service_budget)
    assert x.tolist() == oracle.solve(*vectors, v, payload_budget, service_budget)


def test_the_largest_problem():
    rng = np.random.default_rng(1)
    backlog, voi, payload, service = (rng.integers(1, 9, MAX_CLIENTS) for _ in range(4))
    x = single(backlog, voi, payload, service, 2, 20, 20)
    weight = backlog + 2 * voi
    table = (np.arange(2**MAX_CLIENTS)[:, None] >> np.arange(MAX_CLIENTS)) & 1
    value = np.where((table @ payload <= 20) & (table @ service <= 20), table @ weight, -1)
    np.testing.assert_array_equal(x, table[value.argmax()])
    np.testing.assert_array_equal(single(backlog, voi, payload, service, 2, 1000, 1000), np.ones(MAX_CLIENTS))


def test_more_clients_and_other_shapes_are_refused():
    ones = jnp.ones(MAX_CLIENTS + 1)
    with pytest.raises(ValueError, match="17 clients are more than the 16"):
        solve(ones, ones, ones, ones, 1.0, 9.0, 9.0)
    with pytest.raises(ValueError, match=r"shapes are \(3,\), \(3,\), \(2,\)"):
        best_subset(ones[:3], ones[:3], ones[:2], 9.0, 9.0)
    assert solve([], [], [], [], 1.0, 0.0, 0.0).shape == (0,)


def test_the_budgets_of_integers_are_kept_to_the_last_unit():
    # Beyond 2^24 float32 has only even numbers: 16777216 + 1 would seem to fit.
    payload, service = jnp.array([2**24, 1]), jnp.array([0, 0])
    assert choose(jnp.ones(2), payload, service, 2**24, 0).tolist() == [1, 0]
    assert choose(jnp.ones(2), payload, service, 2**24 + 1, 0).tolist() == [1, 1]
    # Seven tenths exceed 0.7 in float32; counted in tenths they fill the budget.
    ones, zeros = jnp.ones(7), jnp.zeros(7)
    assert choose(ones, jnp.full(7, 0.1), zeros, 0.7, 0.0).tolist() == [1, 1, 1, 1, 1, 1, 0]
    assert choose(ones, jnp.full(7, 1), zeros, 7, 0.0).tolist() == [1] * 7


def test_a_small_weight_lost_in_a_large_sum_still_breaks_no_rule():
    # 2^25 + 1 rounds to 2^25: equal totals, so the lower number; a lost negative weight is not taken either.
    big = 2.0**25
    assert choose(jnp.array([big, 1.0]), jnp.zeros(2), jnp.zeros(2), 0.0, 0.0).tolist() == [1, 0]
    assert choose(jnp.array([-1.0, big]), jnp.zeros(2), jnp.zeros(2), 0.0, 0.0).tolist() == [0, 1]


def test_numbers_that_are_none():
    ones, zeros = jnp.ones(3), jnp.zeros(3)
    assert single(ones, jnp.array([1.0, jnp.nan, 2.0]), ones, zeros, 1.0, 3.0, 0.0).tolist() == [1, 0, 1]
    assert single(ones, ones, jnp.array([jnp.inf, 1.0, jnp.nan]), zeros, 1.0, 3.0, 0.0).tolist() == [0, 1, 0]
    assert single(ones, ones, ones, zeros, 1.0, jnp.nan, 0.0).tolist() == [0, 0, 0]
    assert single(ones, ones, ones, zeros, 1.0, -1.0, 0.0).tolist() == [0, 0, 0]
    assert single(ones, ones, ones, zeros, 1.0, jnp.inf, jnp.inf).tolist() == [1, 1, 1]


@pytest.mark.parametrize("axis", range(7))
def test_every_argument_can_be_mapped(axis):
    columns = instances(4, 6, seed=3)
    fixed = [column[0] for column in columns]
    arguments = [columns[i] if i == axis else fixed[i] for i in range(7)]
    mapped = jax.jit(jax.vmap(solve, [0 if i == axis else None for i in range(7)]))(*arguments)
    loop = [single(*(columns[i][j] if i == axis else fixed[i] for i in range(7))) for j in range(6)]
    np.testing.assert_array_equal(mapped, loop)


def test_queues():
    backlog, x, arrivals = jnp.array([0, 0, 1, 3, 3]), jnp.array([0, 1, 1, 1, 0]), jnp.array([1, 0, 0, 1, 0])
    for kind in (jnp.int32, jnp.float32):
        found = update_queue(backlog.astype(kind), x, arrivals.astype(bool))
        assert found.dtype == kind
        np.testing.assert_array_equal(found, oracle.update_queue(backlog.tolist(), x.tolist(), arrivals.tolist()))
        np.testing.assert_array_equal(found, [1, 0, 0, 3, 3])

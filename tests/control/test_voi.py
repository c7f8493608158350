"""Gross and net value of information: closed forms, the oracle, and what no price can buy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.control import voi
from ovibjax.control.voi import Prices
from tests.oracles import control as oracle

net, gross = jax.jit(voi.net_voi), jax.jit(voi.gross_voi)
money = st.floats(0.0, 20.0, width=32)


def prices(*values):
    return Prices(*map(jnp.float32, values))


def test_gross_voi_is_the_positive_part():
    np.testing.assert_array_equal(gross(jnp.array([5.0, 2.0, 3.0]), jnp.array([2.0, 5.0, 3.0])), [3.0, 0.0, 0.0])


def test_worked_example():
    # 96 bytes at 8 KB/s take 11.7 ms; risk 6 m, residual 2.5 m, 30 ms of delay, 0.2 J.
    value = net(*map(jnp.float32, (6.0, 2.5, 96.0, 65_536.0, 0.03, 0.2)), prices(10.0, 5.0, 2.0))
    assert float(value) == pytest.approx(3.5 - 10 * 96 / 8192 - 5 * 0.2 - 2 * 0.03, abs=1e-6)


@settings(max_examples=200, deadline=None)
@given(
    st.tuples(money, money, st.sampled_from([88.0, 96.0, 168.0]), st.floats(100.0, 1e6, width=32), money, money),
    st.tuples(money, money, money),
)
def test_net_voi_equals_the_oracle(numbers, price):
    found = net(*map(jnp.float32, numbers), prices(*price))
    want = oracle.net_voi(*numbers, price)
    assert float(found) == pytest.approx(want, rel=1e-5, abs=1e-4 + 1e-6 * abs(want))
    # Each price can only lower it, and free requests are worth the gross value.
    free = net(*map(jnp.float32, numbers), prices(0, 0, 0))
    assert float(free) == float(gross(*map(jnp.float32, numbers[:2]))) >= float(found)


@pytest.mark.parametrize("price", [0.0, 2.0])
def test_a_dead_link_has_no_value_at_any_price(price):
    rates = jnp.array([0.0, -1.0, 1e5])
    found = net(*map(jnp.float32, (9.0, 1.0, 96.0)), rates, *map(jnp.float32, (0.0, 0.0)), prices(price, 0.0, 0.0))
    np.testing.assert_array_equal(np.isneginf(found), [True, True, False])
    assert not np.isnan(found).any()


def test_vmap_equals_loop_over_prices():
    rng = np.random.default_rng(0)
    rows = Prices(*(jnp.asarray(rng.uniform(0, 5, 6), jnp.float32) for _ in range(3)))
    numbers = tuple(map(jnp.float32, (6.0, 2.0, 96.0, 3e4, 0.1, 0.3)))
    mapped = jax.vmap(lambda p: voi.net_voi(*numbers, p))(rows)
    one_by_one = [net(*numbers, jax.tree.map(lambda x, i=i: x[i], rows)) for i in range(6)]
    np.testing.assert_allclose(mapped, one_by_one, rtol=1e-6)

"""One signature for every policy, and the choice among actions."""

import inspect

import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.control import policies
from ovibjax.control.actions import ACTIONS
from ovibjax.control.policies import POLICIES, VARIANTS, Observation
from ovibjax.link.latency import transmit_s
from tests.control.cases import controller
from tests.oracles import control as oracle


def seen(
    risk=9.0, predicted=2.0, realised=1.0, rate=65_536.0, since=100.0, waiting=False, scheduled=True, allowed=True
):
    def per_action(value):
        return jnp.broadcast_to(jnp.asarray(value, jnp.float32), (8,))

    return Observation(
        risk_m=jnp.float32(risk),
        predicted_m=per_action(predicted),
        realised_m=per_action(realised),
        rate_bps=jnp.float32(rate),
        transmit_s=transmit_s(jnp.asarray(ACTIONS.payload_bytes), jnp.float32(rate)),
        delay_s=per_action(0.05),
        since_s=jnp.float32(since),
        waiting=jnp.asarray(waiting),
        scheduled=jnp.asarray(scheduled),
        allowed=tuple(jnp.asarray(a) for a in np.broadcast_to(allowed, 8)),
    )


FREE = {"prices": {"bandwidth_m_per_s": 0.0, "delay_m_per_s": 0.0}, "threshold_m": 0.0}


def ask(policy, control=None, **changes):
    decision = POLICIES[policy](seen(**changes), control or controller(), ACTIONS)
    return (bool(decision.send), ACTIONS.names[int(decision.action)])


def test_the_papers_seven_policies_have_one_signature():
    assert tuple(name for name in POLICIES if name not in VARIANTS) == (
        *("voi", "periodic", "budgeted_periodic", "fixed_front", "random", "uncertainty", "oracle_action"),
    )
    signatures = {str(inspect.signature(policy)) for policy in POLICIES.values()}
    assert len(signatures) == 1
    for policy in POLICIES.values():
        decision = policy(seen(), controller(), ACTIONS)
        assert (decision.send.shape, decision.send.dtype) == ((), bool)
        assert (decision.action.shape, decision.action.dtype) == ((), jnp.int32)


def test_equal_values_go_to_the_first_action():
    free = controller(**FREE)
    assert ask("voi", free) == (True, "F-C")
    assert ask("voi", free, allowed=[False, False, True, True, True, False, False, True]) == (True, "FS-C")
    assert ask("voi", free, predicted=[5, 5, 5, 2, 5, 2, 2, 5]) == (True, "FS-R")
    # Priced, the smaller of two equally good payloads wins: FS-R is 160, H4-C 100 and A5-C 104 bytes.
    assert ask("voi", predicted=[5, 5, 5, 2, 2, 5, 2, 5]) == (True, "H4-C")


def test_voi_control_asks_wherever_the_net_value_is_positive():
    free = controller(**FREE, min_gap_s=2.0)
    assert not ask("voi", free, risk=2.0)[0]  # no gain at all
    assert ask("voi", free, risk=2.001, since=0.5)[0]
    assert ask("voi", controller(**(FREE | {"threshold_m": 7.0})))[0]  # a threshold is not its own
    assert not ask("voi", free, waiting=True)[0]
    assert not ask("voi", free, allowed=False)[0]
    assert not ask("voi", free, rate=0.0)[0]


def test_the_variant_has_a_threshold_and_a_gap():
    assert not ask("voi_gap", controller(**(FREE | {"threshold_m": -5.0})), risk=2.0)[0]  # never at a loss
    assert not ask("voi_gap", controller(**(FREE | {"threshold_m": 7.0})))[0]
    assert ask("voi_gap", controller(**(FREE | {"threshold_m": 6.99})))[0]
    assert not ask("voi_gap", controller(**FREE), waiting=True)[0]
    assert [ask("voi_gap", controller(**FREE, min_gap_s=2.0), since=s)[0] for s in (1.5, 2.0)] == [False, True]


def test_fixed_rules():
    assert ask("fixed_front", risk=8.01, since=1.0) == (True, "F-C")
    assert ask("uncertainty", risk=6.01, since=6.0) == (True, "FS-C")
    assert ask("periodic", risk=0.0) == (True, "FS-C")
    quiet = ({"risk": 8.0}, {"since": 0.5}, {"waiting": True}, {"allowed": False})
    assert not any(ask("fixed_front", **{"risk": 9.0, "since": 9.0, **change})[0] for change in quiet)
    quiet = ({"risk": 6.0}, {"since": 5.5}, {"waiting": True}, {"allowed": False})
    assert not any(ask("uncertainty", **{"risk": 9.0, "since": 9.0, **change})[0] for change in quiet)
    for policy in ("periodic", "budgeted_periodic", "random", "oracle_action"):
        assert ask(policy)[0] and not ask(policy, scheduled=False)[0] and not ask(policy, allowed=False)[0]


def test_the_bound_takes_the_lowest_realised_residual_after_penalties():
    assert ask("oracle_action", realised=[5, 5, 5, 5, 5, 5, 5, 4]) == (True, "A5-R")
    # 72 bytes more at 1 KB/s and a price of 100 m/s are 7 m: the smaller request wins despite its residual.
    dear = controller(prices={"bandwidth_m_per_s": 100.0})
    assert ask("oracle_action", dear, realised=[5, 5, 5, 5, 5, 5, 5, 4], rate=8192.0) == (True, "F-C")
    # The order is the same where no residual is below the risk.
    assert ask("oracle_action", risk=1.0, realised=[5, 5, 5, 5, 5, 5, 5, 4]) == (True, "A5-R")


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(st.sampled_from([np.inf, 1.0, 0.0, -2.0]), st.booleans()), min_size=1, max_size=6))
def test_lowest(items):
    values, allowed = zip(*items, strict=True)
    index, value = policies.lowest([jnp.float32(v) for v in values], [jnp.asarray(a) for a in allowed])
    want = oracle.best([-v for v in values], allowed)
    assert float(value) == (np.inf if want is None else values[want])
    if want is not None:
        assert int(index) == want
        assert float(policies.chosen([jnp.float32(v) for v in values], index)) == values[want]


@settings(max_examples=100, deadline=None)
@given(
    st.floats(0.0, 12.0, width=32),
    st.lists(st.floats(0.0, 12.0, width=32), min_size=8, max_size=8),
    st.tuples(*[st.floats(0.0, 30.0, width=32)] * 3),
    st.sampled_from([0.0, 800.0, 65_536.0]),
)
def test_the_lowest_worthwhile_risk_is_the_highest_net_value(risk, predicted, prices, rate):
    control = controller(energy_j=np.linspace(0.0, 1.0, 8))
    control = control._replace(prices=type(control.prices)(*map(jnp.float32, prices)))
    look = seen(risk=risk, predicted=np.float32(predicted), rate=rate)
    index, worthwhile = policies.lowest(
        policies.worthwhile_m(look, look.predicted_m, control, ACTIONS), [jnp.asarray(True)] * 8
    )
    numbers = zip(predicted, ACTIONS.payload_bytes, np.linspace(0.0, 1.0, 8), strict=True)
    values = [oracle.net_voi(risk, g, float(b), rate, 0.05, e, prices) for g, b, e in numbers]
    slack = 1e-5 * (1.0 + abs(float(worthwhile))) if np.isfinite(worthwhile) else 0.0
    if max(values) > slack:
        assert values[int(index)] >= max(values) - slack and risk > worthwhile - slack
    elif max(values) < -slack:
        assert not risk > worthwhile

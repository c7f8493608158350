"""Four numbers in four bytes: how far off they may be, what is exact, and that forms do not mix."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ovibjax.link.payload import pack
from ovibjax.live import messages as m
from ovibjax.live.framing import WireError
from ovibjax.live.small_state import MARK, ROUNDING, SMALL_STATE_BYTES
from tests.live.cases import a_packet, patient, requests
from tests.oracles.scheduling import PAPER_VALUE, scheduling_value

STATES = ((1.0, 20.0), (0.1, 8.0), (5.0, 500.0), (0.5, 2.0))
"""Risk, drift, delay and urgency as robots have them."""

inside = st.floats(2.0**-8, 2.0**15)


@patient
@given(requests, st.tuples(inside, inside, inside, inside))
def test_states_come_back_within_the_rounding(request, numbers):
    packet, state = pack(request), m.RobotState(*numbers)
    body = m.pack_request(packet, state, small=True)
    assert len(body) == len(packet) + SMALL_STATE_BYTES + 1 < len(m.pack_request(packet, state))
    found, received = m.unpack_request(body)
    assert found == request and ROUNDING < 0.033
    for one, other in zip(state, received, strict=True):
        assert abs(math.log(other / one)) <= math.log1p(ROUNDING) + 1e-9


@patient
@given(inside, inside)
def test_order_is_kept(one, other):
    few, many = sorted((one, other))
    received = [m.unpack_request(m.pack_request(a_packet(), m.RobotState(x), small=True))[1] for x in (few, many)]
    assert received[0].risk_m <= received[1].risk_m


def test_zero_and_one_are_exact_and_what_is_beyond_saturates():
    state = m.RobotState(0.0, 1.0, 1e6, 1e-9)
    _, received = m.unpack_request(m.pack_request(a_packet(), state, small=True))
    assert received[:2] == (0.0, 1.0) and 3e4 < received.delay_est_ms < 4e4 and received.urgency == 2.0**-8


@patient
@given(st.floats(0, 9, width=32), st.tuples(*(st.floats(low, high) for low, high in STATES)))
def test_scheduling_values_differ_by_the_rounding_of_their_terms(voi_m, numbers):
    """Eq. "scheduler_value": urgency times VOI, drift, risk and delay by their weights."""
    state = m.RobotState(*numbers)
    _, received = m.unpack_request(m.pack_request(a_packet(), state, small=True))
    names = ("risk_m", "drift_m_per_s", "delay_est_ms", "urgency")
    sent, seen = (
        scheduling_value({"voi_m": voi_m} | dict(zip(names, each, strict=True))) for each in (state, received)
    )
    _, drift, risk, delay = PAPER_VALUE
    terms = drift * state.drift_m_per_s + risk * state.risk_m + delay * state.delay_est_ms
    off = (1 + ROUNDING) * ROUNDING * terms + ROUNDING * (voi_m + terms)
    assert abs(seen - sent) <= state.urgency * off + 1e-6


def test_a_state_without_urgency_and_other_lengths_are_refused():
    with pytest.raises(WireError, match="beyond"):
        m.unpack_request(m.pack_request(a_packet(), m.RobotState(urgency=0.0), small=True))
    with pytest.raises(WireError, match="a state has 6"):
        m.unpack_request(MARK + m.pack_request(a_packet(), m.RobotState()))
    with pytest.raises(WireError):
        m.unpack_request(MARK + a_packet())

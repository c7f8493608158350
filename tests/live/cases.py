"""Requests and answers to make frames of, and a small edge to send them to."""

import math

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from ovibjax.link.payload import Request, pack
from ovibjax.live.exporting import make_edge
from ovibjax.live.messages import STATUSES, VALUE_LIMIT, Answer, RobotState
from ovibjax.views import MODES
from tests.control.cases import TINY, drive

patient = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
"""Making examples may take its time on a busy machine."""

uint16 = st.integers(0, 0xFFFF)
metres = st.floats(-VALUE_LIMIT, VALUE_LIMIT, width=32)
not_negative = st.floats(0, VALUE_LIMIT, width=32)
finite32 = st.floats(width=32, allow_nan=False, allow_infinity=False)

requests = st.builds(
    Request,
    mode=st.sampled_from(list(MODES)),
    prefix=st.lists(finite32, min_size=1, max_size=256),
    voi_m=metres,
    deadline_ms=uint16,
    client=uint16,
    sequence=uint16,
)
states = st.builds(
    RobotState,
    not_negative,
    not_negative,
    not_negative,
    st.floats(2.0**-20, VALUE_LIMIT, width=32),
)
finite64 = st.floats(allow_nan=False, allow_infinity=False)
answers = st.builds(
    Answer,
    st.sampled_from(STATUSES),
    uint16,
    uint16,
    *[finite32] * 4,
    position_m=st.tuples(finite64, finite64, finite64),
)


def a_packet(sequence=1, client=3, mode="FS", k=16, deadline_ms=500, voi_m=2.0):
    """The bytes of a plain request."""
    prefix = [math.sin(i) for i in range(k)]
    return pack(Request(mode, prefix, voi_m=voi_m, deadline_ms=deadline_ms, client=client, sequence=sequence))


def tiny_edge():
    """An edge of synthetic drives, made in seconds."""
    return make_edge([drive(0), drive(1), drive(2)], 1, TINY)

"""Every message comes back as it went; bytes that were changed are refused; no bytes raise anything but WireError."""

import contextlib
import math
import struct
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ovibjax.link.payload import pack
from ovibjax.live import messages as m
from ovibjax.live.framing import WireError
from tests.live.cases import a_packet, answers, patient, requests, states, uint16

nonces = st.binary(min_size=32, max_size=32)
PARSERS = (m.unpack_greeting, m.unpack_hello, m.unpack_welcome, m.unpack_request, m.unpack_answer)
STATE = m.RobotState(3.0, 0.5, 20.0, 1.5)


def messages():
    """One message of each kind, with its parser."""
    nonce, proof = bytes(range(32)), bytes(range(32, 64))
    return [
        (m.pack_greeting(m.Greeting(True, bytes(16), nonce, 2.5)), m.unpack_greeting),
        (m.pack_hello(m.Hello(7, nonce, proof)), m.unpack_hello),
        (m.pack_welcome(proof), m.unpack_welcome),
        (m.pack_request(a_packet()), m.unpack_request),
        (m.pack_request(a_packet(), STATE), m.unpack_request),
        (m.pack_request(a_packet(), STATE, small=True), m.unpack_request),
        (m.pack_answer(m.Answer("ok", 7, 9, 1.5, 2.0, 3.0, 4.0, (1.0, 2.0, 3.0))), m.unpack_answer),
    ]


@patient
@given(requests, states | st.none())
def test_requests_come_back(request, state):
    packet = pack(request)
    body = m.pack_request(packet, state)
    assert body.startswith(packet)
    assert len(body) == len(packet) + (0 if state is None else m.STATE_BYTES) <= m.REQUEST_LIMIT_BYTES
    assert m.unpack_request(body) == (request, m.RobotState() if state is None else state)


@patient
@given(answers)
def test_answers_come_back(answer):
    body = m.pack_answer(answer)
    assert len(body) <= m.ANSWER_LIMIT_BYTES
    assert m.unpack_answer(body) == answer


@patient
@given(st.booleans(), st.binary(min_size=16, max_size=16), nonces, st.floats(0, 1e6, width=32))
def test_greetings_come_back(wants_key, fingerprint, nonce, service_ms):
    greeting = m.Greeting(wants_key, fingerprint, nonce, service_ms)
    assert m.unpack_greeting(m.pack_greeting(greeting)) == greeting


@patient
@given(uint16, nonces, nonces)
def test_hellos_and_welcomes_come_back(client, nonce, proof):
    hello = m.Hello(client, nonce, proof)
    assert m.unpack_hello(m.pack_hello(hello)) == hello
    assert m.unpack_welcome(m.pack_welcome(proof)) == proof


@pytest.mark.parametrize("at", range(len(messages())))
def test_any_bit_that_is_changed_is_noticed(at):
    body, parse = messages()[at]
    parse(body)
    for bit in range(8 * len(body)):
        changed = bytearray(body)
        changed[bit // 8] ^= 1 << bit % 8
        with pytest.raises(WireError):
            parse(bytes(changed))


@pytest.mark.parametrize("at", range(len(messages())))
def test_a_message_that_is_cut_or_goes_on_is_refused(at):
    body, parse = messages()[at]
    cut_to_packet = len(a_packet()) if parse is m.unpack_request and len(body) > len(a_packet()) else -1
    for size in range(len(body)):
        if size != cut_to_packet:  # a request without its state is one
            with pytest.raises(WireError):
                parse(body[:size])
    with pytest.raises(WireError):
        parse(body + b"\0")


@patient
@given(st.binary(max_size=200) | st.sampled_from([body for body, _ in messages()]))
def test_no_bytes_raise_anything_else(body):
    for parse in PARSERS:
        with contextlib.suppress(WireError):
            parse(body)


@pytest.mark.parametrize("version", [0, 2, 255])
def test_another_version_is_named(version):
    for body, parse in messages():
        changed = bytearray(body)
        changed[2] = version
        with pytest.raises(WireError, match="version"):
            parse(bytes(changed))


@pytest.mark.parametrize(
    "state",
    [
        m.RobotState(math.nan),
        m.RobotState(math.inf),
        m.RobotState(risk_m=-1.0),
        m.RobotState(drift_m_per_s=2e6),
        m.RobotState(delay_est_ms=-math.inf),
        m.RobotState(urgency=0.0),
    ],
)
def test_states_that_nobody_can_mean_are_refused(state):
    with pytest.raises(WireError, match="beyond"):
        m.unpack_request(m.pack_request(a_packet(), state))


def test_a_voi_that_nobody_can_mean_is_refused():
    with pytest.raises(WireError, match="voi_m"):
        m.unpack_request(a_packet(voi_m=1e30))


def test_the_checksum_of_a_state_binds_it_to_its_packet():
    one, other = (m.pack_request(a_packet(sequence), STATE) for sequence in (1, 2))
    with pytest.raises(WireError, match="checksum"):
        m.unpack_request(one[: -m.STATE_BYTES] + other[-m.STATE_BYTES :])


def test_a_position_that_is_no_number_is_no_answer():
    with pytest.raises(WireError, match="finite"):
        m.unpack_answer(m.pack_answer(m.Answer("ok", 1, 1)))
    assert m.unpack_answer(m.pack_answer(m.Answer("expired", 1, 1))).status == "expired"


@patient
@given(uint16, st.integers(1, 32767))
def test_sequence_numbers_wrap(last, step):
    assert m.follows((last + step) % 65536, last)
    assert not m.follows(last, (last + step) % 65536)
    assert not m.follows(last, last)


def test_layouts_are_those_of_the_table():
    """The table of the module, written out again."""
    nonce, proof = bytes(range(32)), bytes(range(32, 64))
    head = b"OC" + struct.pack("<BBHH", 1, 0, 7, 0) + nonce + proof
    crc = struct.pack("<I", zlib.crc32(head))
    assert m.pack_hello(m.Hello(7, nonce, proof)) == head + crc
    numbers = struct.pack("<4f", *STATE)
    packet = a_packet()
    assert m.pack_request(packet, STATE) == packet + numbers + struct.pack("<I", zlib.crc32(packet + numbers))
    answer = struct.pack("<2sBBHH4f3d", b"OA", 1, 0, 7, 9, 1.5, 2.0, 3.0, 4.0, 1.0, 2.0, 3.0)
    sealed = answer + struct.pack("<I", zlib.crc32(answer))
    assert m.pack_answer(m.Answer("ok", 7, 9, 1.5, 2.0, 3.0, 4.0, (1.0, 2.0, 3.0))) == sealed

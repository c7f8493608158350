"""What edge and robots say to each other, as bytes; every parser is safe on any bytes.

A connection begins with the edge's greeting. Where that asks for a key, the robot says hello with a proof that it has
it, and the edge welcomes it with one of its own (`trust`). From then on the robot sends requests and the edge answers.
All numbers are little-endian; each message is one frame (`framing`) and ends with the CRC-32 of what is before it.

| message  | layout                                                                                            |
|----------|---------------------------------------------------------------------------------------------------|
| greeting | `OG`, version, 1 if a key is wanted, 16 bytes that name the edge file, nonce 32, service ms f32     |
| hello    | `OC`, version, 0, client u16, 0 u16, nonce 32, proof 32                                             |
| welcome  | `OW`, version, 0, proof 32                                                                        |
| request  | a packet of `link.payload` or `link.coded_packets`, and optionally the state of the robot         |
| state    | risk m, drift m/s, predicted delay ms, urgency, each f32; or a byte each, see `small_state`        |
| answer   | `OA`, version, status, client u16, sequence u16, residual m, queue, service and backlog ms f32, |
|          | position 3 f64                                                                                     |

The header of a packet holds mode, VOI, size and deadline. The scheduling value of the paper (eq. "scheduler_value")
needs four numbers more, and how the edge gets them is not said: they are the state, 20 bytes with their checksum, which
covers the packet too. A request without it is one without drift, risk and delay, of urgency 1; behind a compact header,
which does not tell where the packet ends, it may not be missing. In the small form it takes 7 bytes, rounded.
"""

import math
import struct
import zlib
from collections.abc import Mapping
from typing import NamedTuple

from ovibjax.link.codes.coder import Coder
from ovibjax.link.payload import PayloadError, Request, request_bytes
from ovibjax.live.coded_requests import PLAIN, read_packet
from ovibjax.live.framing import WireError
from ovibjax.live.small_state import MARK, SMALL_STATE_BYTES, small_state_of, with_small_state
from ovibjax.views import MODES

VERSION = 1
NONCE_BYTES, PROOF_BYTES, FINGERPRINT_BYTES = 32, 32, 16
STATE_BYTES = 20
STATUSES = ("ok", "expired", "busy", "unsupported", "closing")
"""What becomes of a request: answered; past its deadline before it was served; more than the client or the edge may
have waiting; a mode or prefix that the edge does not serve; the edge is about to stop."""

VALUE_LIMIT = 1e6
"""Largest number taken for a VOI, a risk, a drift rate, a delay or an urgency."""

_PACKET_MAX = request_bytes(256, max(map(len, MODES.values()))) + 1  # version 2, whose length has two bytes
REQUEST_LIMIT_BYTES = _PACKET_MAX + STATE_BYTES
"""Longest frame that an edge accepts."""

_CRC, _STATE = struct.Struct("<I"), struct.Struct("<4f")
_GREETING = struct.Struct(f"<2sBB{FINGERPRINT_BYTES}s{NONCE_BYTES}sf")
_HELLO = struct.Struct(f"<2sBBHH{NONCE_BYTES}s{PROOF_BYTES}s")
_WELCOME = struct.Struct(f"<2sBB{PROOF_BYTES}s")
_ANSWER = struct.Struct("<2sBBHHffffddd")
ANSWER_LIMIT_BYTES = max(s.size for s in (_GREETING, _WELCOME, _ANSWER)) + _CRC.size
"""Longest frame that a robot accepts."""


class Greeting(NamedTuple):
    """The first message of an edge.

    Attributes:
        wants_key: whether the robot must prove that it has the shared key.
        fingerprint: 16 bytes that name the edge file: codes of another encoder mean nothing here.
        nonce: 32 random bytes.
        service_ms: how long a request takes to serve.
    """

    wants_key: bool
    fingerprint: bytes
    nonce: bytes
    service_ms: float


class Hello(NamedTuple):
    """A robot's proof that it has the key.

    Attributes:
        client: its number; its requests must bear it.
        nonce: 32 random bytes of its own.
        proof: see `trust.client_proof`.
    """

    client: int
    nonce: bytes
    proof: bytes


class RobotState(NamedTuple):
    """What a scheduling rule asks of a robot beside its packet.

    Attributes:
        risk_m: local risk.
        drift_m_per_s: fitted drift rate.
        delay_est_ms: predicted latency.
        urgency: mission urgency, positive.
    """

    risk_m: float = 0.0
    drift_m_per_s: float = 0.0
    delay_est_ms: float = 0.0
    urgency: float = 1.0


class Answer(NamedTuple):
    """What the edge answers.

    Attributes:
        status: one of `STATUSES`; the fields below mean something where it is `ok`, times always.
        client: that of the request.
        sequence: likewise.
        residual_m: how far off the position is expected to be.
        queue_ms: time it waited.
        service_ms: time it was served.
        backlog_ms: predicted work that is left in the queue.
        position_m: x, y, z.
    """

    status: str
    client: int
    sequence: int
    residual_m: float = math.nan
    queue_ms: float = 0.0
    service_ms: float = 0.0
    backlog_ms: float = 0.0
    position_m: tuple[float, float, float] = (math.nan, math.nan, math.nan)


def pack_greeting(greeting: Greeting) -> bytes:
    """The bytes of a greeting."""
    wants_key, fingerprint, nonce, service_ms = greeting
    return _sealed(_GREETING.pack(b"OG", VERSION, wants_key, fingerprint, nonce, service_ms))


def unpack_greeting(body: bytes) -> Greeting:
    """Parse a greeting; raises `WireError` where the bytes are none."""
    wants_key, fingerprint, nonce, service_ms = _opened(body, _GREETING, b"OG")
    if wants_key > 1 or not 0 <= service_ms < math.inf:
        raise WireError("greeting with a flag or a service time that it cannot have")
    return Greeting(bool(wants_key), fingerprint, nonce, service_ms)


def pack_hello(hello: Hello) -> bytes:
    """The bytes of a hello."""
    return _sealed(_HELLO.pack(b"OC", VERSION, 0, hello.client, 0, hello.nonce, hello.proof))


def unpack_hello(body: bytes) -> Hello:
    """Parse a hello; raises `WireError` where the bytes are none."""
    flag, client, zero, nonce, proof = _opened(body, _HELLO, b"OC")
    if flag or zero:
        raise WireError("hello with bytes that are not zero where they must be")
    return Hello(client, nonce, proof)


def pack_welcome(proof: bytes) -> bytes:
    """The bytes of a welcome with the edge's proof."""
    return _sealed(_WELCOME.pack(b"OW", VERSION, 0, proof))


def unpack_welcome(body: bytes) -> bytes:
    """The edge's proof of a welcome; raises `WireError` where the bytes are none."""
    flag, proof = _opened(body, _WELCOME, b"OW")
    if flag:
        raise WireError("welcome with bytes that are not zero where they must be")
    return proof


def pack_request(packet: bytes, state: RobotState | None = None, small: bool = False) -> bytes:
    """A packet, unchanged, with or without the robot's state behind it, which may have the small form."""
    if state is None:
        return packet
    if small:
        return with_small_state(packet, state)
    numbers = _STATE.pack(*state)
    return packet + numbers + _CRC.pack(zlib.crc32(packet + numbers))


def unpack_request(body: bytes, coders: Mapping[str, Coder] = PLAIN) -> tuple[Request, RobotState]:
    """Parse a request.

    Args:
        body: one frame.
        coders: what prefixes may be coded with, by the name of the code.

    Returns:
        The packet with its prefix decoded, and the robot's state; the default state where it sent none.

    Raises:
        WireError: the bytes are no request, or hold numbers that nobody can mean.
    """
    small = body[: len(MARK)] == MARK
    size = SMALL_STATE_BYTES if small else STATE_BYTES
    try:
        request, rest = read_packet(body[len(MARK) :] if small else body, coders, size)
    except PayloadError as error:
        raise WireError(str(error)) from error
    if abs(request.voi_m) > VALUE_LIMIT:
        raise WireError(f"voi_m {request.voi_m:g} is beyond {VALUE_LIMIT:g}")
    if not rest and not small:
        return request, RobotState()
    if len(rest) != size:
        raise WireError(f"{len(rest)} bytes behind the packet; a state has {size}")
    numbers = small_state_of(body) if small else _state_of(body)
    if numbers is None:
        raise WireError("checksum of the state is wrong")
    state = RobotState(*numbers)
    if not all(0 <= value <= VALUE_LIMIT for value in state) or state.urgency <= 0:
        raise WireError(f"state {tuple(state)} is beyond what it may be")
    return request, state


def _state_of(body: bytes) -> tuple[float, ...] | None:
    """The state at the end of a frame; None if its checksum is wrong."""
    rest = body[-STATE_BYTES:]
    if zlib.crc32(body[: -_CRC.size]) != _CRC.unpack_from(rest, STATE_BYTES - _CRC.size)[0]:
        return None
    return _STATE.unpack_from(rest)


def pack_answer(answer: Answer) -> bytes:
    """The bytes of an answer."""
    status, client, sequence, *numbers, position_m = answer
    head = (b"OA", VERSION, STATUSES.index(status), client, sequence)
    return _sealed(_ANSWER.pack(*head, *numbers, *position_m))


def unpack_answer(body: bytes) -> Answer:
    """Parse an answer; raises `WireError` where the bytes are none, or promise a position that is no number."""
    status, client, sequence, *numbers = _opened(body, _ANSWER, b"OA")
    residual_m, queue_ms, service_ms, backlog_ms, *place = numbers
    if status >= len(STATUSES):
        raise WireError(f"status {status} is none of {len(STATUSES)}")
    if STATUSES[status] == "ok" and not all(map(math.isfinite, numbers)):
        raise WireError("an answer whose numbers are not finite")
    position_m = (place[0], place[1], place[2])
    return Answer(STATUSES[status], client, sequence, residual_m, queue_ms, service_ms, backlog_ms, position_m)


def follows(sequence: int, last: int) -> bool:
    """Whether a sequence number is newer than another; they wrap at 65,536 (as in RFC 1982)."""
    return 0 < (sequence - last) % 65536 < 32768


def _sealed(head: bytes) -> bytes:
    return head + _CRC.pack(zlib.crc32(head))


def _opened(body: bytes, layout: struct.Struct, magic: bytes) -> tuple:
    """Fields of a message after magic and version."""
    if len(body) != layout.size + _CRC.size:
        raise WireError(f"{len(body)} bytes; {magic.decode()} has {layout.size + _CRC.size}")
    found, version, *fields = layout.unpack_from(body)
    if found != magic:
        raise WireError(f"magic {found!r} is not {magic!r}")
    if version != VERSION:
        raise WireError(f"version {version} is not {VERSION}")
    if zlib.crc32(body[: layout.size]) != _CRC.unpack_from(body, layout.size)[0]:
        raise WireError(f"checksum of {magic.decode()} is wrong")
    return tuple(fields)

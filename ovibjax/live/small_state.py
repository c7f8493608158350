"""The state of a robot in four bytes, for requests that are meant to be small: each number by its logarithm.

A byte is 0 for zero, or a step on a scale of eleven to the octave from 1/256 up to some 32,000: the nearest is at most
3.2 % off (`ROUNDING`), which is what priorities that are proportional to a number may differ by. One is exact. Behind
the four bytes stands a checksum of two over the whole frame, whose packet has one of its own. A frame in which a state
of this form follows begins with `MARK`, which no packet begins with.
"""

import binascii
import math
import struct
from collections.abc import Sequence

MARK = b"S"
SMALL_STATE_BYTES = 6
"""Four numbers and the checksum; with the mark, a frame is longer by one more."""

_PER_OCTAVE, _LOWEST_OCTAVE, _MOST = 11, -8, 255
ROUNDING = 2 ** (0.5 / _PER_OCTAVE) - 1
"""Share by which a number within the scale is off at most."""

_CHECK = struct.Struct("<H")


def with_small_state(packet: bytes, numbers: Sequence[float]) -> bytes:
    """A frame with a packet and four numbers, none of them negative."""
    body = MARK + packet + bytes(map(_byte_of, numbers))
    return body + _CHECK.pack(binascii.crc_hqx(body, 0))


def small_state_of(body: bytes) -> list[float] | None:
    """The four numbers at the end of a frame that begins with `MARK`; None if its checksum is wrong."""
    if len(body) < len(MARK) + SMALL_STATE_BYTES:
        return None
    if binascii.crc_hqx(body[: -_CHECK.size], 0) != _CHECK.unpack_from(body, len(body) - _CHECK.size)[0]:
        return None
    return [_number_of(code) for code in body[-SMALL_STATE_BYTES : -_CHECK.size]]


def _byte_of(number: float) -> int:
    """Zero stays zero; what is beyond the scale saturates."""
    if not number > 0:
        return 0
    step = round(_PER_OCTAVE * (math.log2(min(number, 1e9)) - _LOWEST_OCTAVE))
    return min(max(step, 0), _MOST - 1) + 1


def _number_of(code: int) -> float:
    return 2.0 ** ((code - 1) / _PER_OCTAVE + _LOWEST_OCTAVE) if code else 0.0

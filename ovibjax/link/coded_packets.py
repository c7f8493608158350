"""Requests whose prefix is coded (`link.codes`): packet version 2, and a compact header (neither is in the paper).

Version 2 is version 1 (`link.payload`) with the code's kind and, in place of the packet's size, the length of the code:

| offset      | bytes | type    | field                                                  |
|-------------|-------|---------|--------------------------------------------------------|
| 0           | 2     | char    | magic, `OV`                                            |
| 2           | 1     | uint8   | version (2) in the high nibble, mode in the low nibble |
| 3           | 1     | uint8   | k - 1, for k = 1..256                                  |
| 4           | 1     | uint8   | kind of the code, its position in `CODES`              |
| 5           | 4     | float32 | predicted VOI in metres, finite                        |
| 9           | 2     | uint16  | deadline in milliseconds                               |
| 11          | 2     | uint16  | client                                                 |
| 13          | 2     | uint16  | sequence number                                        |
| 15          | 4     | uint32  | CRC-32 of every byte of the packet except these four   |
| 19          | v     | varint  | length of the code in bytes; 1 byte below 128          |
| 19 + v      | 4 n   | uint32  | view indices, exactly `MODES[mode]`                    |
| 19 + v + 4n |       |         | the code                                               |

A code of 10 bytes needs no header of 20, nor view indices that the mode implies. The compact form is a byte with 1 1 in
front, two bits of kind and, at the end, two of mode; k - 1 in a byte; client, sequence, deadline in milliseconds and
VOI in centimetres, with its sign in the lowest bit, as varints; the code; the CRC-32 of all that. Its length is that of
its frame: 6 bytes and from 4 to 12 of varints (mostly 6) more than the code.

Varints hold seven bits a byte, the lowest first, and the high bit where another byte follows. As in version 1, what a
parser accepts, packing turns back into the same bytes.
"""

import math
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ovibjax.link.codes.tables import CODES
from ovibjax.link.payload import K_MAX, MODE_NAMES, PayloadError, as_bytes, as_uint16
from ovibjax.views import MODES

_VERSION = 2
_COMPACT, _COMPACT_BITS = 0b11000000, 0b11001100
_HEAD, _CRC = struct.Struct("<2sBBBfHHH"), struct.Struct("<I")
_VOI_LIMIT_M = 1e4  # of a compact header; centimetres within float32


@dataclass(frozen=True)
class CodedRequest:
    """One edge request whose prefix is coded; ranges are checked when it is packed.

    Attributes:
        mode: view mode, a key of `views.MODES`.
        code: one of `CODES`.
        k: coordinates in the prefix, 1..256.
        data: the coded prefix, of `codes.Coder.encode`.
        voi_m: predicted value of information in metres, float32; in a compact header to the centimetre.
        deadline_ms: response deadline in milliseconds, 0..65535.
        client: client number, 0..65535.
        sequence: sequence number of the request at its client, 0..65535.
    """

    mode: str
    code: str
    k: int
    data: bytes
    voi_m: float
    deadline_ms: int
    client: int
    sequence: int


def pack_coded(request: CodedRequest) -> bytes:
    """The packet of a request, version 2.

    Args:
        request: the request.

    Returns:
        20 + 4 n bytes and the code, in the layout of the module's table; one byte more for a code of 128 or more.

    Raises:
        PayloadError: a field is out of range, or the code has a length that it cannot have.
    """
    mode, kind = _checked(request)
    with np.errstate(over="ignore"):
        voi_m = float(np.float32(request.voi_m))
    if not math.isfinite(voi_m):
        raise PayloadError(f"voi_m must be a finite float32, not {request.voi_m}")
    head = _HEAD.pack(b"OV", _VERSION << 4 | mode, request.k - 1, kind, voi_m, *_numbers(request))
    views = MODES[request.mode]
    body = varint(len(request.data)) + struct.pack(f"<{len(views)}I", *views) + request.data
    return head + _CRC.pack(zlib.crc32(head + body)) + body


def pack_compact(request: CodedRequest) -> bytes:
    """The packet of a request under a compact header.

    Args:
        request: the request; its VOI is rounded to centimetres.

    Returns:
        10 to 18 bytes and the code, mostly 12.

    Raises:
        PayloadError: a field is out of range, or the code has a length that it cannot have.
    """
    mode, kind = _checked(request)
    if not abs(request.voi_m) <= _VOI_LIMIT_M:
        raise PayloadError(f"voi_m {request.voi_m} is beyond the {_VOI_LIMIT_M:g} m of a compact header")
    deadline_ms, client, sequence = _numbers(request)
    voi_cm = round(100 * request.voi_m)
    signed = 2 * voi_cm if voi_cm >= 0 else -2 * voi_cm - 1
    numbers = b"".join(map(varint, (client, sequence, deadline_ms, signed)))
    packet = bytes([_COMPACT | kind << 4 | mode, request.k - 1]) + numbers + request.data
    return packet + _CRC.pack(zlib.crc32(packet))


def unpack_coded(data: bytes | bytearray | memoryview) -> CodedRequest:
    """Parse a packet of version 2 or one with a compact header; safe on arbitrary bytes.

    Args:
        data: exactly one packet.

    Returns:
        The request; packing it again in the same form gives `data`.

    Raises:
        PayloadError: `data` is neither; bytes cannot make it raise anything else.
    """
    raw = as_bytes(data)
    form: Callable[[bytes], CodedRequest] = _full if raw[:1] == b"O" else _compact
    request = form(raw)
    # Whatever has more than one spelling (a varint with zeros behind, a view that is not the mode's) is refused here.
    if (pack_coded if form is _full else pack_compact)(request) != raw:
        raise PayloadError("packet is not as it would have been packed")
    return request


def leading_packet(data: bytes) -> bytes:
    """The packet of version 2 that bytes begin with, where others follow it in a frame.

    Args:
        data: arbitrary bytes.

    Returns:
        As many of them as its length says, or fewer where there are no more; nothing of it is checked but the mode.

    Raises:
        PayloadError: they are too short to hold a length, or of a mode that there is not.
    """
    begin = _HEAD.size + _CRC.size
    if len(data) <= begin:
        raise PayloadError(f"packet of {len(data)} bytes is shorter than its header")
    length, at = _read_varint(data, begin)
    return data[: at + 4 * len(MODES[_named(MODE_NAMES, "mode", data[2] & 15)]) + length]


def varint(number: int) -> bytes:
    """A number, zero or more, seven bits a byte."""
    found = bytearray()
    while number > 127:
        found.append(number & 127 | 128)
        number >>= 7
    return bytes([*found, number])


def _full(raw: bytes) -> CodedRequest:
    begin = _HEAD.size + _CRC.size
    if len(raw) <= begin:
        raise PayloadError(f"packet of {len(raw)} bytes is shorter than its header")
    magic, version_mode, k_minus_1, kind, voi_m, deadline_ms, client, sequence = _HEAD.unpack_from(raw)
    if magic != b"OV" or version_mode >> 4 != _VERSION:
        raise PayloadError(f"magic {magic!r} and version {version_mode >> 4} are not b'OV' and {_VERSION}")
    if _CRC.unpack_from(raw, _HEAD.size)[0] != zlib.crc32(raw[: _HEAD.size] + raw[begin:]):
        raise PayloadError("CRC field is not the checksum")
    mode, code = _named(MODE_NAMES, "mode", version_mode & 15), _named(CODES, "kind", kind)
    length, at = _read_varint(raw, begin)
    at += 4 * len(MODES[mode])
    if len(raw) != at + length:
        raise PayloadError(f"packet has {len(raw)} bytes, not {at} and a code of {length}")
    return CodedRequest(mode, code, k_minus_1 + 1, raw[at:], voi_m, deadline_ms, client, sequence)


def _compact(raw: bytes) -> CodedRequest:
    if len(raw) < 2 + 4 + _CRC.size:
        raise PayloadError(f"packet of {len(raw)} bytes is shorter than any header")
    if raw[0] & _COMPACT_BITS != _COMPACT:
        raise PayloadError(f"first byte {raw[0]:#04x} begins no packet")
    packet, crc = raw[: -_CRC.size], _CRC.unpack_from(raw, len(raw) - _CRC.size)[0]
    if crc != zlib.crc32(packet):
        raise PayloadError("CRC field is not the checksum")
    at, numbers = 2, []
    for _ in range(4):
        number, at = _read_varint(packet, at)
        numbers.append(number)
    client, sequence, deadline_ms, signed = numbers
    voi_m = (-(signed + 1) // 2 if signed % 2 else signed // 2) / 100
    mode, code = MODE_NAMES[raw[0] & 3], CODES[raw[0] >> 4 & 3]
    return CodedRequest(mode, code, raw[1] + 1, packet[at:], voi_m, deadline_ms, client, sequence)


def _read_varint(raw: bytes, at: int) -> tuple[int, int]:
    """A varint of at most three bytes, and where it ends."""
    number = 0
    for place in range(3):
        if at + place >= len(raw):
            raise PayloadError("packet ends inside a number")
        byte = raw[at + place]
        number |= (byte & 127) << 7 * place
        if byte < 128:
            return number, at + place + 1
    raise PayloadError("a number of more than three bytes")


def _named(names: tuple[str, ...], what: str, number: int) -> str:
    if number >= len(names):
        raise PayloadError(f"{what} number {number} is not in 0..{len(names) - 1}")
    return names[number]


def _checked(request: CodedRequest) -> tuple[int, int]:
    """Numbers of mode and kind of a request whose code has a length that it may have."""
    for value, names, what in ((request.mode, MODE_NAMES, "mode"), (request.code, CODES, "code")):
        if value not in names:
            raise PayloadError(f"{what} {value!r} is not one of {', '.join(names)}")
    if not isinstance(request.k, int) or not 1 <= request.k <= K_MAX:
        raise PayloadError(f"k must be 1 to {K_MAX}, not {request.k!r}")
    if not isinstance(request.voi_m, int | float | np.floating):
        raise PayloadError(f"voi_m must be a number, not {request.voi_m!r}")
    if not isinstance(request.data, bytes):
        raise PayloadError(f"a code is bytes, not {type(request.data).__name__}")
    size = {"float32": 4 * request.k, "int8": request.k, "int4": (request.k + 1) // 2}.get(request.code)
    if len(request.data) != size if size is not None else len(request.data) > 2 * request.k:
        raise PayloadError(f"{len(request.data)} bytes are no code of {request.k} coordinates, {request.code}")
    return MODE_NAMES.index(request.mode), CODES.index(request.code)


def _numbers(request: CodedRequest) -> tuple[int, int, int]:
    """Deadline, client and sequence, each within two bytes."""
    deadline_ms = as_uint16("deadline_ms", request.deadline_ms)
    return deadline_ms, as_uint16("client", request.client), as_uint16("sequence", request.sequence)

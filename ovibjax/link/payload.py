"""What a robot sends: request packets, their size, bytes and parser (paper, Section "Scalable View-Rate Encoding").

A packet is a 20-byte header, one 4-byte identifier per selected view and k float32 latent coordinates,
little-endian without padding. The header carries what the paper lists (view-rate mode, predicted VOI, payload
size, deadline) and what a receiver of datagrams needs (magic, version, client, sequence, checksum).

| offset   | bytes | type    | field                                                         |
|----------|-------|---------|---------------------------------------------------------------|
| 0        | 2     | char    | magic, `OV`                                                   |
| 2        | 1     | uint8   | version (1) in the high nibble, mode in the low nibble        |
| 3        | 1     | uint8   | k - 1, for k = 1..256                                         |
| 4        | 4     | float32 | predicted VOI in metres, finite                               |
| 8        | 2     | uint16  | size of the whole packet in bytes, 4 k + 20 + 4 n             |
| 10       | 2     | uint16  | deadline in milliseconds                                      |
| 12       | 2     | uint16  | client                                                        |
| 14       | 2     | uint16  | sequence number                                               |
| 16       | 4     | uint32  | CRC-32 (zlib) of every byte of the packet except these four   |
| 20       | 4 n   | uint32  | view indices, exactly `MODES[mode]`                           |
| 20 + 4 n | 4 k   | float32 | latent prefix, finite                                         |

The mode number is the position in `MODES`: F 0, FS 1, H4 2, A5 3. A request has one byte string and a byte
string at most one request: whatever `unpack` accepts, `pack` turns back into the same bytes.
"""

import operator
import struct
import zlib
from dataclasses import dataclass
from typing import Any, TypeVar

import jax
import numpy as np
import numpy.typing as npt

from ovibjax.views import MODES

HEADER_BYTES = 20
VIEW_ID_BYTES = 4
FLOAT_BYTES = 4

_MAGIC = b"OV"
_VERSION = 1
K_MAX = 256
_UINT16_MAX = 0xFFFF
MODE_NAMES = tuple(MODES)
_HEAD = struct.Struct("<2sBBfHHHH")  # the header up to the checksum
_CRC = struct.Struct("<I")

Count = TypeVar("Count", int, jax.Array, npt.NDArray[Any])


class PayloadError(ValueError):
    """A request that cannot be packed, or bytes that are not a request; the message names field and value."""


def representation_bytes(k: Count) -> Count:
    """Size of the serialized representation: prefix and header, no view identifiers (what the figures plot).

    Args:
        k: prefix length, an int or an integer array.

    Returns:
        4 k + 20 bytes, of the type and shape of `k`.
    """
    return FLOAT_BYTES * k + HEADER_BYTES


def request_bytes(k: Count, n_views: Count | int) -> Count:
    """Size of the application-layer request, b_i(S, k) (paper, Section "Scalable View-Rate Encoding").

    Args:
        k: prefix length, an int or an integer array.
        n_views: number of selected views |S|, an int or an array that broadcasts against `k`.

    Returns:
        4 k + 20 + 4 n_views bytes.
    """
    return representation_bytes(k) + VIEW_ID_BYTES * n_views


@dataclass(frozen=True, eq=False)
class Request:
    """One edge request, held at wire precision: prefix and VOI are rounded to float32 on construction.

    Ranges are checked by `pack`, not here. Requests are equal when all fields are, floats bit by bit (-0.0
    differs from 0.0): requests that can be packed are equal exactly when their packets are.

    Attributes:
        mode: view mode, a key of `views.MODES`.
        prefix: [k] float32, the latent prefix; a read-only copy of whatever array or sequence was given.
        voi_m: predicted value of information in metres.
        deadline_ms: response deadline in milliseconds, 0..65535.
        client: client number, 0..65535.
        sequence: sequence number of the request at its client, 0..65535; wrapping it is up to the client.

    Raises:
        PayloadError: prefix or VOI is not made of real numbers.
    """

    mode: str
    prefix: npt.NDArray[np.float32]
    voi_m: float
    deadline_ms: int
    client: int
    sequence: int

    def __post_init__(self) -> None:
        prefix = _float32("prefix", self.prefix)
        prefix.setflags(write=False)
        voi_m = _float32("voi_m", self.voi_m)
        if voi_m.ndim:
            raise PayloadError(f"voi_m must be one number, not an array of shape {voi_m.shape}")
        object.__setattr__(self, "prefix", prefix)
        object.__setattr__(self, "voi_m", float(voi_m))

    def _key(self) -> tuple[object, ...]:
        voi_bits = np.float32(self.voi_m).tobytes()
        floats = (self.prefix.shape, self.prefix.tobytes(), voi_bits)
        return (self.mode, *floats, self.deadline_ms, self.client, self.sequence)

    def __eq__(self, other: object) -> bool:
        return self._key() == other._key() if isinstance(other, Request) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key())


def pack(request: Request) -> bytes:
    """The bytes of a request.

    Args:
        request: the request.

    Returns:
        The packet, `request_bytes(k, n_views)` bytes in the layout of the module's table.

    Raises:
        PayloadError: a field is out of range or not finite.
    """
    mode, prefix = request.mode, request.prefix
    if not isinstance(mode, str) or mode not in MODES:
        raise PayloadError(f"mode {mode!r} is not one of {', '.join(MODES)}")
    if prefix.ndim != 1 or not 1 <= prefix.size <= K_MAX:
        raise PayloadError(f"prefix must be one axis of 1 to {K_MAX} values, not shape {prefix.shape}")
    _check_finite(request.voi_m, prefix)
    views, k = MODES[mode], prefix.size
    head = _HEAD.pack(
        _MAGIC,
        _VERSION << 4 | MODE_NAMES.index(mode),
        k - 1,
        request.voi_m,
        request_bytes(k, len(views)),
        *(as_uint16(name, getattr(request, name)) for name in ("deadline_ms", "client", "sequence")),
    )
    body = struct.pack(f"<{len(views)}I", *views) + prefix.astype("<f4").tobytes()
    return head + _CRC.pack(zlib.crc32(head + body)) + body


def unpack(data: bytes | bytearray | memoryview) -> Request:
    """Parse a packet; the inverse of `pack`, safe on arbitrary bytes.

    Args:
        data: exactly one packet.

    Returns:
        The request; packing it again gives `data`.

    Raises:
        PayloadError: `data` is not the packet of a request; bytes cannot make it raise anything else.
    """
    raw = as_bytes(data)
    if len(raw) < HEADER_BYTES:
        raise PayloadError(f"packet of {len(raw)} bytes is shorter than the {HEADER_BYTES}-byte header")
    magic, version_mode, k_minus_1, voi_m, size, deadline_ms, client, sequence = _HEAD.unpack_from(raw)
    version, mode_number, k = version_mode >> 4, version_mode & 0xF, k_minus_1 + 1
    if magic != _MAGIC:
        raise PayloadError(f"magic {magic!r} is not {_MAGIC!r}")
    if version != _VERSION:
        raise PayloadError(f"version {version} is not {_VERSION}")
    if mode_number >= len(MODE_NAMES):
        raise PayloadError(f"mode number {mode_number} is not in 0..{len(MODE_NAMES) - 1}")
    mode = MODE_NAMES[mode_number]
    views = MODES[mode]
    expected = request_bytes(k, len(views))
    if size != expected:
        raise PayloadError(f"size field {size} is not the {expected} bytes of mode {mode} at k = {k}")
    if len(raw) != size:
        raise PayloadError(f"packet has {len(raw)} bytes, its size field says {size}")
    body = raw[HEADER_BYTES:]
    (crc,), actual = _CRC.unpack_from(raw, _HEAD.size), zlib.crc32(raw[: _HEAD.size] + body)
    if crc != actual:
        raise PayloadError(f"CRC field {crc:#010x} is not the checksum {actual:#010x}")
    ids = struct.unpack_from(f"<{len(views)}I", body)
    if ids != views:
        raise PayloadError(f"view ids {ids} are not the views {views} of mode {mode}")
    prefix = np.frombuffer(body, "<f4", offset=VIEW_ID_BYTES * len(views))
    _check_finite(voi_m, prefix)  # before the copy in Request: a conversion may quiet a signalling NaN
    return Request(mode, prefix, voi_m, deadline_ms, client, sequence)


def _float32(name: str, value: object) -> npt.NDArray[np.float32]:
    """A private float32 copy; a value beyond float32 becomes infinite, which `pack` refuses."""
    try:
        array = np.asarray(value)
        if not np.can_cast(array.dtype, np.float32, "same_kind"):
            raise TypeError(array.dtype)
        with np.errstate(all="ignore"):
            return np.array(array, np.float32)
    except (TypeError, ValueError) as error:
        raise PayloadError(f"{name} must hold real numbers, not {value!r}") from error


def as_uint16(name: str, value: object) -> int:
    """A field of two bytes; refused with its name where it is no integer or too large."""
    try:
        number = operator.index(value)  # type: ignore[arg-type]
    except TypeError as error:
        raise PayloadError(f"{name} must be an integer, not {value!r}") from error
    if not 0 <= number <= _UINT16_MAX:
        raise PayloadError(f"{name} {number} is not in 0..{_UINT16_MAX}")
    return number


def _check_finite(voi_m: float, prefix: npt.NDArray[np.float32]) -> None:
    if not np.isfinite(voi_m):
        raise PayloadError(f"voi_m must be a finite float32, not {voi_m}")
    bad = np.flatnonzero(~np.isfinite(prefix))
    if bad.size:
        raise PayloadError(f"prefix[{bad[0]}] must be a finite float32, not {prefix[bad[0]]}")


def as_bytes(data: object) -> bytes:
    """A private copy of a packet; refused where it is no buffer of bytes."""
    if not isinstance(data, bytes | bytearray | memoryview):
        raise PayloadError(f"a packet is bytes, not {type(data).__name__}")
    try:
        return bytes(data)
    except (ValueError, BufferError, NotImplementedError) as error:  # a released or exotic memoryview
        raise PayloadError(f"packet buffer cannot be read: {error}") from error

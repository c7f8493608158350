"""A stream of bytes as frames: four bytes of length, little-endian, and so many bytes after them.

The parser is pure but for the bytes of the one frame that is not complete, and holds no more of it than the limit.
"""

import struct

LENGTH_BYTES = 4

_LENGTH = struct.Struct("<I")


class WireError(ValueError):
    """Bytes that are not what the protocol has in their place; the connection that they came on is of no more use."""


def frame(body: bytes) -> bytes:
    """A message as it goes over the wire: its length, and itself."""
    return _LENGTH.pack(len(body)) + body


class FrameReader:
    """Frames of a stream that arrives in pieces of any size.

    Attributes:
        limit_bytes: longest frame accepted, without its length.
        held: bytes of a frame that is not complete.
    """

    def __init__(self, limit_bytes: int) -> None:
        self.limit_bytes = limit_bytes
        self.held = b""

    def feed(self, data: bytes) -> list[bytes]:
        """Take the next piece of the stream.

        Args:
            data: bytes in the order in which they were received.

        Returns:
            The frames that they complete, in order; what is left over is kept for the next call.

        Raises:
            WireError: a frame of no bytes, or longer than the limit; known from its length, before it is held.
        """
        stream, at, found = self.held + data, 0, []
        while len(stream) - at >= LENGTH_BYTES:
            (length,) = _LENGTH.unpack_from(stream, at)
            if not 1 <= length <= self.limit_bytes:
                raise WireError(f"frame of {length} bytes; there are 1 to {self.limit_bytes}")
            end = at + LENGTH_BYTES + length
            if end > len(stream):
                break
            found.append(stream[at + LENGTH_BYTES : end])
            at = end
        self.held = stream[at:]
        return found

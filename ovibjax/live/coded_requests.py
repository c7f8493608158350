"""Requests of robots whose prefixes are coded, between the packets of `link` and what an edge or a robot works with.

An edge takes any of the three forms of a packet, whatever its robots use: the paper's, version 2, and the compact one.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from ovibjax.control.actions import ActionSet
from ovibjax.link.coded_packets import CodedRequest, leading_packet, pack_coded, pack_compact, unpack_coded
from ovibjax.link.codes.arithmetic import StreamError
from ovibjax.link.codes.coder import Coder
from ovibjax.link.payload import HEADER_BYTES, PayloadError, Request, pack, unpack

PLAIN: Mapping[str, Coder] = MappingProxyType({"float32": Coder("float32")})
"""What can be read without a table."""

_SIZE, _SIZE_OFFSET = struct.Struct("<H"), 8
_SAMPLED = 64  # reference codes that the length of a code is guessed from


@dataclass(frozen=True)
class Sending:
    """How a robot writes its requests.

    Attributes:
        coder: what codes prefixes; None for the paper's packets.
        compact: whether under a compact header.
    """

    coder: Coder | None = None
    compact: bool = False

    def packet(self, request: Request) -> bytes:
        """The packet of a request."""
        if self.coder is None:
            return pack(request)
        numbers = (request.voi_m, request.deadline_ms, request.client, request.sequence)
        data = self.coder.encode(request.prefix)
        coded = CodedRequest(request.mode, self.coder.code, len(request.prefix), data, *numbers)
        return (pack_compact if self.compact else pack_coded)(coded)

    def sizes_bytes(self, actions: ActionSet, codes: np.ndarray) -> tuple[float, ...]:
        """What a request of each action takes, on average over some codes.

        Args:
            actions: modes and prefixes.
            codes: [modes, N, K] codes of frames like those that are asked about.

        Returns:
            [A] bytes.
        """
        some = codes[:, :: max(1, codes.shape[1] // _SAMPLED)]
        requests = (
            [Request(mode, code[:k], 10.0, 500, 64, 4096) for code in some[m]]
            for m, mode in enumerate(actions.modes)
            for k in actions.prefixes
        )
        return tuple(float(np.mean([len(self.packet(one)) for one in each])) for each in requests)


def read_packet(body: bytes, coders: Mapping[str, Coder], behind: int) -> tuple[Request, bytes]:
    """The request at the beginning of a frame, its prefix decoded, and what follows it.

    Args:
        body: one frame.
        coders: what prefixes may be coded with.
        behind: bytes that follow a packet with a compact header, whose length is that of its frame.

    Returns:
        The request and the rest of the frame.

    Raises:
        PayloadError: the frame begins with no packet, or with one of a code that there is no coder for.
    """
    if body[:2] != b"OV":
        packet, rest = body[:-behind], body[-behind:]
    elif body[2:3] and body[2] >> 4 == 2:
        packet = leading_packet(body)
        rest = body[len(packet) :]
    else:
        if len(body) < HEADER_BYTES:
            raise PayloadError(f"frame of {len(body)} bytes is shorter than any request")
        size = _SIZE.unpack_from(body, _SIZE_OFFSET)[0]
        return unpack(body[:size]), body[size:]
    coded = unpack_coded(packet)
    if coded.code not in coders:
        raise PayloadError(f"code {coded.code} is not one of {', '.join(coders)}")
    try:
        prefix = coders[coded.code].decode(coded.data, coded.k)
    except StreamError as error:
        raise PayloadError(str(error)) from error
    if not np.isfinite(prefix).all():
        raise PayloadError("prefix must be finite")
    return Request(coded.mode, prefix, coded.voi_m, coded.deadline_ms, coded.client, coded.sequence), rest

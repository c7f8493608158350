"""What a parser of datagrams must survive: malformed packets, one for each check, and 10,000 mutated ones."""

import struct
import zlib
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.link.payload import PayloadError, pack, unpack
from ovibjax.views import MODES
from tests.link.cases import WIRE_MODES, sample


def repaired(packet):
    """The same bytes with the checksum made right, so that the checks behind it decide."""
    crc = zlib.crc32(packet[:16] + packet[20:])
    return packet[:16] + struct.pack("<I", crc) + packet[20:]


@pytest.mark.parametrize("data", [None, 3, "OV", [79, 86], np.zeros(36, np.uint8), object()])
def test_unpack_refuses_what_is_not_bytes(data):
    with pytest.raises(PayloadError, match="bytes, not"):
        unpack(data)


def test_unpack_refuses_a_released_buffer():
    view = memoryview(pack(sample()))
    view.release()
    with pytest.raises(PayloadError, match="cannot be read"):
        unpack(view)


def patched(offset, data, mode="FS", k=3):
    packet = pack(sample(mode, k))
    return repaired(packet[:offset] + data + packet[offset + len(data) :])


SIGNALLING_NAN = bytes.fromhex("010080 7f")

BAD_PACKETS = [
    (b"", "0 bytes is shorter"),
    (pack(sample())[:19], "19 bytes is shorter"),
    (pack(sample())[:20], "packet has 20 bytes, its size field says 44"),
    (pack(sample())[:-1], "packet has 43 bytes"),
    (repaired(pack(sample()) + b"\0"), "packet has 45 bytes"),
    (patched(0, b"VO"), "magic b'VO'"),
    (patched(2, b"\x01"), "version 0"),
    (patched(2, b"\x21"), "version 2"),
    (patched(2, b"\x14"), "mode number 4"),
    (patched(2, b"\x1f"), "mode number 15"),
    (patched(2, b"\x12"), "size field 44 is not the 48 bytes of mode H4"),
    (patched(3, b"\x03"), "size field 44 is not the 48 bytes of mode FS at k = 4"),
    (patched(8, b"\x2d\x00"), "size field 45"),
    # Mode and k wrong together keep the size right: FS at 3 read as H4 at 2, or as F at 5.
    (patched(2, b"\x12\x01"), r"view ids \(0, 2, 3, .* H4"),
    (patched(20, struct.pack("<III", 0, 3, 2)), r"view ids \(0, 3, 2\)"),
    (patched(20, struct.pack("<I", 2**24)), "view ids"),
    (patched(4, struct.pack("<f", np.nan)), "voi_m .* nan"),
    (patched(4, SIGNALLING_NAN), "voi_m .* nan"),
    (patched(4, struct.pack("<f", -np.inf)), "voi_m .* -inf"),
    (patched(36, SIGNALLING_NAN), r"prefix\[1\] .* nan"),
    (patched(40, struct.pack("<f", np.inf)), r"prefix\[2\] .* inf"),
    (pack(sample())[:16] + b"\0\0\0\0" + pack(sample())[20:], "CRC field 0x00000000"),
    (pack(sample())[:-1] + b"\x01", "CRC field"),
]


@pytest.mark.parametrize(("packet", "message"), BAD_PACKETS)
def test_unpack_refuses(packet, message):
    with pytest.raises(PayloadError, match=message):
        unpack(packet)


# Offset and width of every header field but the checksum; ids and prefix follow the header.
FIELDS = {"magic": (0, 2), "mode": (2, 1), "k": (3, 1), "voi": (4, 4), "size": (8, 2), "deadline": (10, 2)}

FIELDS |= {"client": (12, 2), "sequence": (14, 2), "crc": (16, 4), "ids": (20, 4)}


def mutate(kind, packet, rng):
    data = bytearray(packet)
    if kind == "flip":
        for bit in rng.integers(0, 8 * len(data), rng.integers(1, 4)):
            data[bit // 8] ^= 1 << bit % 8
    elif kind == "truncate":
        del data[rng.integers(0, len(data)) :]
    elif kind == "extend":
        data += rng.bytes(rng.integers(1, 9))
    elif kind == "random":
        data = bytearray(rng.bytes(rng.integers(0, 200)))
        data[:2] = b"OV" if rng.random() < 0.5 else data[:2]
    elif kind == "overwrite":
        offset, width = FIELDS[str(rng.choice(list(FIELDS)))]
        data[offset : offset + width] = rng.bytes(width)
    elif kind == "special":  # not-a-number and infinity where a float is due
        slots = [4, *range(len(data) - 4 * (data[3] + 1), len(data), 4)]
        offset = slots[rng.integers(0, len(slots))]
        word = [0x7F800000, 0xFF800000, 0x7FC00000, 0xFF800001, 0x80000000, 0x00000001][rng.integers(0, 6)]
        data[offset : offset + 4] = struct.pack("<I", word)
    else:  # "reshape": another mode, with the k that keeps the size right
        n, other = len(WIRE_MODES[list(WIRE_MODES)[data[2] & 15]][1]), int(rng.integers(0, 4))
        k_minus_1 = data[3] + n - len(list(WIRE_MODES.values())[other][1])
        data[2], data[3] = 0x10 + other, k_minus_1 % 256
    return bytes(data)


KINDS = ("flip", "truncate", "extend", "random", "overwrite", "special", "reshape")

# 10,000 packets over 7 kinds x {checksum as it falls, repaired} are 714 per cell; this many must be refused.
LEAST_REFUSED = {(kind, False): 450 for kind in KINDS} | {
    ("flip", True): 60,  # most flips hit the payload, where any finite float is a valid one
    ("truncate", True): 700,
    ("extend", True): 700,
    ("random", True): 700,
    ("overwrite", True): 250,  # five of ten fields take any value
    ("special", True): 350,  # -0.0 and the subnormal are valid
    ("reshape", True): 300,  # the same mode is no change, and F is how FS, H4 and A5 begin, H4 how A5 does
}

REASONS = (
    "shorter",
    "magic",
    "version",
    "mode number",
    "packet has",
    "size field",
    "CRC",
    "view ids",
    "voi_m",
    "prefix[",
)


def test_ten_thousand_mutated_packets():
    rng = np.random.default_rng(20)
    refused, accepted, reasons = Counter(), Counter(), Counter()
    for index in range(10_000):
        cell = (KINDS[index % 7], index // 7 % 2 == 1)
        k = int(rng.integers(1, 40))
        mode = str(rng.choice(list(MODES)))
        packet = mutate(cell[0], pack(sample(mode, k, prefix=rng.normal(size=k), voi_m=rng.normal())), rng)
        if cell[1] and len(packet) >= 20:
            packet = repaired(packet)
        try:
            request = unpack(packet)
        except PayloadError as error:
            refused[cell] += 1
            reasons[next(reason for reason in REASONS if reason in str(error))] += 1
        else:
            accepted[cell] += 1
            assert pack(request) == packet
    assert sum(refused.values()) + sum(accepted.values()) == 10_000
    short = {cell: refused[cell] for cell, least in LEAST_REFUSED.items() if refused[cell] < least}
    assert not short, short
    # Every check refused something, and behind repaired checksums valid packets got through to be repacked.
    assert all(reasons[reason] >= 20 for reason in REASONS), reasons
    assert all(accepted[kind, True] >= 50 for kind in ("flip", "overwrite", "special", "reshape")), accepted


@settings(deadline=None, max_examples=150)
@given(st.binary(max_size=80))
def test_arbitrary_bytes_raise_only_payload_errors(data):
    with pytest.raises(PayloadError):
        unpack(data)

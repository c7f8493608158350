"""Packets of coded prefixes: bytes as documented, round trips, and 20,000 mutated packets in either form."""

import contextlib
import struct
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.link.coded_packets import CodedRequest, pack_coded, pack_compact, unpack_coded, varint
from ovibjax.link.payload import PayloadError, Request, pack, unpack
from tests.link.cases import WIRE_MODES

KINDS = {"float32": 0, "int8": 1, "int4": 2, "entropy": 3}
FORMS = {"full": pack_coded, "compact": pack_compact}


def coded(**changes):
    """A request with these changes."""
    fields = {"mode": "FS", "code": "entropy", "k": 16, "data": b"\x01\x80\x07", "voi_m": 1.5, "deadline_ms": 500}
    return CodedRequest(**fields | {"client": 7, "sequence": 258} | changes)


def size_of(code, k):
    return {"float32": 4 * k, "int8": k, "int4": (k + 1) // 2, "entropy": (7 * k) // 5}[code]


def random_request(rng):
    code, k = str(rng.choice(list(KINDS))), int(rng.integers(1, 257))
    mode = str(rng.choice(list(WIRE_MODES)))
    voi_m = float(np.float32(rng.integers(-2000, 20000) / 100))
    numbers = {name: int(rng.integers(0, 65536)) >> int(rng.integers(0, 16)) for name in ("client", "sequence")}
    return coded(mode=mode, code=code, k=k, data=rng.bytes(size_of(code, k)), voi_m=voi_m, deadline_ms=800, **numbers)


def seven_bits(number):
    digits = [number % 128]
    while number := number // 128:
        digits.append(number % 128)
    return bytes([*(digit + 128 for digit in digits[:-1]), digits[-1]])


def by_the_table(request):
    """The layout of version 2, written down once more."""
    mode, views = WIRE_MODES[request.mode]
    head = b"OV" + bytes([0x20 + mode, request.k - 1, KINDS[request.code]])
    head += struct.pack("<fHHH", request.voi_m, request.deadline_ms, request.client, request.sequence)
    body = seven_bits(len(request.data)) + b"".join(struct.pack("<I", view) for view in views) + request.data
    return head + struct.pack("<I", zlib.crc32(head + body)) + body


def by_the_words(request):
    """The compact form, written down once more."""
    mode, _ = WIRE_MODES[request.mode]
    voi_cm = int(np.rint(100 * request.voi_m))
    packet = bytes([0xC0 + 16 * KINDS[request.code] + mode, request.k - 1])
    for number in (request.client, request.sequence, request.deadline_ms, abs(2 * voi_cm) - (voi_cm < 0)):
        packet += seven_bits(number)
    packet += request.data
    return packet + struct.pack("<I", zlib.crc32(packet))


@pytest.mark.parametrize("seed", range(20))
def test_packets_are_as_documented_and_come_back(seed):
    request = random_request(np.random.default_rng(seed))
    assert pack_coded(request) == by_the_table(request) and pack_compact(request) == by_the_words(request)
    assert unpack_coded(pack_coded(request)) == request
    back = unpack_coded(bytearray(pack_compact(request)))
    assert back.voi_m == pytest.approx(request.voi_m, abs=1e-3)
    assert pack_compact(back) == pack_compact(request)


def test_ten_bytes_of_code_travel_under_a_header_of_twelve():
    request = coded(data=b"\x55" * 10, client=12, sequence=900)
    assert len(pack_compact(request)) == 10 + 13
    assert len(pack_coded(request)) == 10 + 20 + 12
    assert len(pack_coded(coded(code="float32", k=35, data=bytes(140)))) == 140 + 21 + 12


@given(st.integers(0, 2**21 - 1))
@settings(max_examples=200, deadline=None)
def test_varints_are_as_documented(number):
    assert varint(number) == seven_bits(number)


WRONG = [
    ({"mode": "X"}, "mode 'X'"),
    ({"code": "int16"}, "code 'int16'"),
    ({"k": 0}, "k must be"),
    ({"k": 257}, "k must be"),
    ({"k": 2.0}, "k must be"),
    ({"data": bytes(33)}, "33 bytes are no code of 16"),
    ({"code": "int8"}, "3 bytes are no code of 16"),
    ({"data": [1]}, "bytes, not list"),
    ({"client": 65536}, "client 65536"),
    ({"sequence": -1}, "sequence -1"),
    ({"deadline_ms": 1.5}, "deadline_ms must be an integer"),
    ({"voi_m": np.nan}, "voi_m"),
    ({"voi_m": 1e39}, "voi_m"),
    ({"voi_m": "2"}, "voi_m"),
]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(("changes", "message"), WRONG)
def test_what_is_out_of_range_is_not_packed(form, changes, message):
    with pytest.raises(PayloadError, match=message):
        FORMS[form](coded(**changes))


def sealed(form, packet):
    """The same bytes with their checksum made right."""
    if form == "compact":
        return packet[:-4] + struct.pack("<I", zlib.crc32(packet[:-4]))
    return packet[:15] + struct.pack("<I", zlib.crc32(packet[:15] + packet[19:])) + packet[19:]


def mutated(packet, rng):
    """Bits flipped, bytes written over, cut off, put in or exchanged."""
    data, kind = bytearray(packet), rng.integers(0, 5)
    at = int(rng.integers(0, len(data)))
    if kind == 0:
        for bit in rng.integers(0, 8 * len(data), rng.integers(1, 5)):
            data[bit // 8] ^= 1 << bit % 8
    elif kind == 1:
        data[at : at + 4] = rng.bytes(int(rng.integers(1, 5)))
    elif kind == 2:
        del data[at:]
    elif kind == 3:
        data[at:at] = rng.bytes(int(rng.integers(1, 9)))
    else:
        other = int(rng.integers(0, len(data)))
        data[at], data[other] = data[other], data[at]
    return bytes(data)


@pytest.mark.parametrize("form", FORMS)
def test_none_of_twenty_thousand_mutated_packets_is_read_without_its_checksum(form):
    rng = np.random.default_rng(1)
    packets = [FORMS[form](random_request(rng)) for _ in range(40)]
    read = changed = resealed = 0
    while changed < 20_000:
        packet = packets[changed % 40]
        data = mutated(packet, rng)
        if data == packet:
            continue
        changed += 1
        with contextlib.suppress(PayloadError):
            read += bool(unpack_coded(data))
        if changed % 10 == 0 and len(data) >= 24:
            # With the checksum made right, what is read is what somebody could have sent.
            again = sealed(form, data)
            try:
                request = unpack_coded(again)
            except PayloadError:
                continue
            resealed += 1
            assert again == (pack_coded if again[:1] == b"O" else pack_compact)(request)
    assert read == 0 and resealed > 200


@pytest.mark.parametrize("data", [None, b"", b"OV", b"\xc0", bytes(40), b"\xff" * 40, "text", pack_coded(coded())[:-1]])
def test_what_is_no_packet_is_refused(data):
    with pytest.raises(PayloadError):
        unpack_coded(data)


def test_versions_do_not_read_one_another():
    request = Request("FS", np.zeros(3, np.float32), 1.0, 10, 1, 2)
    with pytest.raises(PayloadError, match="version 1"):
        unpack_coded(pack(request))
    for form in FORMS.values():
        with pytest.raises(PayloadError):
            unpack(form(coded()))


def test_a_number_may_not_be_written_longer_than_it_is():
    packet = pack_compact(coded(client=5))
    longer = packet[:2] + b"\x85\x00" + packet[3:]
    with pytest.raises(PayloadError, match="as it would have been packed"):
        unpack_coded(sealed("compact", longer))
    with pytest.raises(PayloadError, match="three bytes"):
        unpack_coded(sealed("compact", packet[:2] + b"\x85\x80\x80" + packet[3:]))
    views = pack_coded(coded())
    with pytest.raises(PayloadError, match="as it would have been packed"):
        unpack_coded(sealed("full", views[:20] + struct.pack("<III", 0, 3, 2) + views[32:]))

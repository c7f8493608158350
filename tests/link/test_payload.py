"""Packets byte by byte against struct and zlib, and round trips."""

import struct
import zlib
from dataclasses import FrozenInstanceError, replace

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ovibjax.link.payload import (
    FLOAT_BYTES,
    HEADER_BYTES,
    VIEW_ID_BYTES,
    PayloadError,
    Request,
    pack,
    representation_bytes,
    request_bytes,
    unpack,
)
from ovibjax.views import MODES
from tests.link.cases import WIRE_MODES, sample


def oracle(mode, prefix, voi_m, deadline_ms, client, sequence):
    number, views = WIRE_MODES[mode]
    tail = b"".join(struct.pack("<I", view) for view in views) + b"".join(struct.pack("<f", z) for z in prefix)
    head = b"OV" + bytes([0x10 + number, len(prefix) - 1]) + struct.pack("<f", voi_m)
    head += struct.pack("<H", 20 + len(tail)) + struct.pack("<HHH", deadline_ms, client, sequence)
    return head + struct.pack("<I", zlib.crc32(tail, zlib.crc32(head))) + tail


def test_golden_bytes():
    request = Request("FS", np.array([1.0, -0.0], np.float32), 2.5, 1000, 513, 65535)
    head = "4f56 11 01 00002040 2800 e803 0102 ffff"
    tail = "00000000 02000000 03000000 0000803f 00000080"
    packet = pack(request)
    assert packet[:16] == bytes.fromhex(head) and packet[20:] == bytes.fromhex(tail)
    assert packet[16:20] == struct.pack("<I", zlib.crc32(bytes.fromhex(head + tail)))


@pytest.mark.parametrize("mode", MODES)
def test_sizes_and_layout_for_every_k(mode):
    rng = np.random.default_rng(3)
    n_views = len(MODES[mode])
    for k in range(1, 257):
        values = rng.normal(size=k).astype(np.float32)
        request = Request(mode, values, float(rng.normal()), *map(int, rng.integers(0, 65536, 3)))
        packet = pack(request)
        assert packet == oracle(
            mode, values.tolist(), request.voi_m, request.deadline_ms, request.client, request.sequence
        )
        assert len(packet) == request_bytes(k, n_views) == 4 * k + 20 + 4 * n_views
        assert representation_bytes(k) == len(packet) - 4 * n_views
        assert unpack(packet) == request


def test_sizes_of_the_paper():
    assert (HEADER_BYTES, VIEW_ID_BYTES, FLOAT_BYTES) == (20, 4, 4)
    assert type(request_bytes(16, 1)) is int and type(representation_bytes(16)) is int
    kb = {k: round(representation_bytes(k) / 1024, 3) for k in (16, 32, 35, 128)}
    assert kb == {16: 0.082, 32: 0.145, 35: 0.156, 128: 0.52}
    # The multi-client replay: the compact prefix with three to five views takes 0.094 to 0.102 KB.
    assert [round(request_bytes(16, n) / 1024, 3) for n in (3, 5)] == [0.094, 0.102]


def test_sizes_on_arrays():
    k, n_views = jnp.array([[4, 8]]), jnp.array([[1], [5]])
    np.testing.assert_array_equal(request_bytes(k, n_views), [[40, 56], [56, 72]])
    np.testing.assert_array_equal(request_bytes(np.array([4, 8]), 1), [40, 56])
    np.testing.assert_array_equal(representation_bytes(jnp.array([4, 8])), [36, 52])


float32s = st.floats(width=32, allow_nan=False, allow_infinity=False)

uint16s = st.integers(0, 65535)

EXTREMES = [
    0.0,
    -0.0,
    2.0**-149,
    -(2.0**-149),
    2.0**-126,
    float(np.finfo(np.float32).max),
    -3.4028234663852886e38,
]


@settings(deadline=None, max_examples=150)
@given(
    st.sampled_from(list(MODES)),
    st.lists(float32s, min_size=1, max_size=256),
    float32s,
    uint16s,
    uint16s,
    uint16s,
)
@example("A5", EXTREMES, -0.0, 0, 0, 0)
@example("F", [2.0**-149], -(2.0**-149), 65535, 65535, 65535)
def test_round_trip(mode, prefix, voi_m, deadline_ms, client, sequence):
    request = Request(mode, np.array(prefix, np.float32), voi_m, deadline_ms, client, sequence)
    packet = pack(request)
    assert packet == oracle(mode, prefix, voi_m, deadline_ms, client, sequence)
    for view in (
        packet,
        bytearray(packet),
        memoryview(packet),
        memoryview(b"".join(bytes([b, 0]) for b in packet))[::2],
    ):
        parsed = unpack(view)
        assert parsed == request and hash(parsed) == hash(request) and pack(parsed) == packet
    # Field by field and bit by bit, so that a mistaken __eq__ cannot hide a loss.
    assert struct.pack(f"<{len(prefix)}f", *parsed.prefix) == struct.pack(f"<{len(prefix)}f", *prefix)
    assert struct.pack("<f", parsed.voi_m) == struct.pack("<f", voi_m)
    fields = (parsed.mode, parsed.deadline_ms, parsed.client, parsed.sequence)
    assert fields == (mode, deadline_ms, client, sequence)


def test_request_is_a_value():
    source = np.array([0.1, 0.2])
    request = Request("F", source, 0.1, 1, 2, 3)
    source[0] = 9.0
    assert request.prefix.dtype == np.float32 and request.prefix[0] == np.float32(0.1)
    assert request.voi_m == float(np.float32(0.1))
    with pytest.raises(ValueError, match="read-only"):
        request.prefix[0] = 1.0
    with pytest.raises(FrozenInstanceError):
        request.client = 4
    assert request == Request("F", jnp.array([0.1, 0.2]), jnp.float32(0.1), 1, 2, 3)
    assert request == unpack(pack(request)) and request != "request"
    others = [
        replace(request, mode="FS"),
        replace(request, prefix=[0.1, 0.3]),
        replace(request, prefix=[0.1]),
        replace(request, voi_m=0.2),
        replace(request, deadline_ms=9),
        replace(request, client=9),
        replace(request, sequence=9),
    ]
    assert all(request != other for other in others) and len({request, *others}) == 8
    assert replace(request, prefix=[0.0]) != replace(request, prefix=[-0.0])
    assert pack(replace(request, client=np.int64(2))) == pack(request)


BAD_FIELDS = [
    ({"mode": "Q"}, "mode 'Q'"),
    ({"mode": 1}, "mode 1"),
    ({"mode": ["F"]}, "mode"),
    ({"mode": None}, "mode None"),
    ({"prefix": []}, r"prefix .* shape \(0,\)"),
    ({"prefix": np.zeros(257)}, r"prefix .* shape \(257,\)"),
    ({"prefix": np.zeros((2, 2))}, r"prefix .* shape \(2, 2\)"),
    ({"prefix": 1.0}, r"prefix .* shape \(\)"),
    ({"prefix": [0.0, np.nan]}, r"prefix\[1\] .* nan"),
    ({"prefix": [np.inf]}, r"prefix\[0\] .* inf"),
    ({"prefix": [0.0, 0.0, -1e39]}, r"prefix\[2\] .* -inf"),
    ({"prefix": ["1.0"]}, "prefix .*'1.0'"),
    ({"prefix": [[1.0], [1.0, 2.0]]}, "prefix"),
    ({"prefix": [1j]}, "prefix .*1j"),
    ({"prefix": None}, "prefix .*None"),
    ({"voi_m": np.nan}, "voi_m .* nan"),
    ({"voi_m": -np.inf}, "voi_m .* -inf"),
    ({"voi_m": 1e39}, "voi_m .* inf"),
    ({"voi_m": 10**400}, "voi_m .*1000"),
    ({"voi_m": "2"}, "voi_m .*'2'"),
    ({"voi_m": [1.0]}, r"voi_m .* shape \(1,\)"),
    *[
        ({name: value}, f"{name} .*{text}")
        for name in ("deadline_ms", "client", "sequence")
        for value, text in [
            (-1, "-1"),
            (65536, "65536"),
            (10**30, "10000"),
            (1.0, "1.0"),
            ("1", "'1'"),
            (None, "None"),
        ]
    ],
]


@pytest.mark.parametrize(("changes", "message"), BAD_FIELDS)
def test_pack_refuses(changes, message):
    with pytest.raises(PayloadError, match=message):
        pack(sample(**changes))

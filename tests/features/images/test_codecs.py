"""Image codecs: real bytes there and back, in order, the same on every run."""

import sys
import zlib

import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.features.images import codecs
from ovibjax.features.images.codecs import CLIPS, CODECS, LADDERS, decode, encode

COUNT, HEAD = 5, 20 + 4 * 5


def pictures(rows=96, columns=128):
    """Five pictures that cannot be confused: smooth, of different colours, with some detail."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[0:rows, 0:columns] / 20.0
    out = []
    for view in range(COUNT):
        colour = np.array([40 + 40 * view, 200 - 30 * view, 90 + 15 * view])
        wave = 30 * np.sin(x * (1 + 0.3 * view) + view)[..., None] + 20 * np.cos(y)[..., None]
        out.append(colour + wave + rng.normal(0, 4, (rows, columns, 1)))
    return np.clip(out, 0, 255).astype(np.uint8)


def psnr_db(a, b):
    return 10 * np.log10(255**2 / np.mean((a.astype(float) - b) ** 2, axis=(1, 2, 3)))


@pytest.fixture(params=CODECS)
def codec(request):
    if request.param in CLIPS:
        pytest.importorskip("av")
    return request.param


def test_better_quality_is_larger_and_closer(codec):
    views = pictures()
    sizes, closeness = [], []
    for quality in LADDERS[codec]:
        data = encode(codec, quality, views)
        back = decode(data)
        assert back.shape == views.shape and back.dtype == np.uint8
        sizes.append(len(data))
        closeness.append(psnr_db(back, views).mean())
    assert (np.diff(sizes) > 0).all() and (np.diff(closeness) > 0).all(), (sizes, closeness)
    assert closeness[-1] > 33


def test_views_come_back_in_order(codec):
    views = pictures()
    back = decode(encode(codec, LADDERS[codec][-1], views))
    error = np.abs(back[:, None].astype(float) - views[None]).mean(axis=(2, 3, 4))
    np.testing.assert_array_equal(error.argmin(axis=1), np.arange(COUNT))
    assert encode(codec, LADDERS[codec][2], views) != encode(codec, LADDERS[codec][2], views[::-1].copy())


def test_equal_views_give_equal_bytes(codec):
    views, draws, streams = pictures(128, 160), np.random.default_rng(0), set()
    for _ in range(12):
        # Whatever the memory that an encoder is given held before.
        junk = [np.full(size, 0xA5, np.uint8) for size in draws.integers(1, 400_000, 40)]
        del junk
        streams.add(encode(codec, LADDERS[codec][1], views))
    assert len(streams) == 1


@pytest.mark.parametrize("shape", [(75, 101), (76, 99), (16, 16)])
def test_odd_and_small_sizes(codec, shape):
    views = pictures(*shape)
    back = decode(encode(codec, LADDERS[codec][-1], views))
    assert back.shape == views.shape and psnr_db(back, views).min() > 28


def test_payload_is_header_lengths_and_code(codec):
    """The bytes that are counted are the bytes that are decoded, and contain no text of the encoder's own."""
    views = pictures(64, 80)[:4]
    data = encode(codec, LADDERS[codec][0], views)
    lengths = np.frombuffer(data, "<u4", count=4, offset=20)
    assert len(data) == 20 + 4 * 4 + lengths.sum()
    assert (lengths > 0).sum() == (1 if codec in CLIPS else 4)
    assert b"x264" not in data and b"x265" not in data
    assert decode(data).shape == views.shape


def test_bad_arguments_are_refused():
    views = pictures(16, 16)
    for arguments, word in (
        (("gif", 3, views), "gif"),
        (("jpeg", 101, views), "101"),
        (("h264", 52, views), "52"),
        (("webp", -1, views), "-1"),
        (("jpeg", 5, views[0]), "shape"),
        (("jpeg", 5, views[..., :1]), "shape"),
        (("jpeg", 5, views[:0]), "shape"),
        (("jpeg", 5, views / 255.0), "float64"),
        (("jpeg", 5, np.zeros((17, 8, 8, 3), np.uint8)), "17"),
        (("webp", 5, np.zeros((1, 8, 20000, 3), np.uint8)), "webp"),
    ):
        with pytest.raises(InputError, match=word):
            encode(*arguments)


def test_damaged_payloads_are_refused(codec):
    data = encode(codec, LADDERS[codec][0], pictures(32, 32))
    for bad in (b"", data[:10], data[:-1], data + b"\0", b"XX" + data[2:], data[:50] + b"\xff" + data[51:]):
        with pytest.raises(InputError):
            decode(bad)
    # A right checksum over nonsense.
    for body in (data[20:HEAD] + bytes(len(data) - HEAD), b"\xff" * (len(data) - 20), data[20:60]):
        with pytest.raises(InputError):
            decode(data[:16] + zlib.crc32(data[:16] + body).to_bytes(4, "little") + body)


def test_missing_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    assert "[video]" in codecs.video_missing()
    with pytest.raises(InputError, match="pip install"):
        encode("h265", 30, pictures(16, 16))

"""Image codecs as rivals of feature compression: JPEG and WebP per view, H.264 and H.265 with the views as one clip.

The payload is what a client would send: a 20-byte header and 4 bytes per view, as in `link.payload`, then the coded
views. Here the four bytes hold the length of each view's code; a clip has one length and zeros.

| offset   | bytes | type   | field                                                      |
|----------|-------|--------|------------------------------------------------------------|
| 0        | 2     | char   | magic, `IC`                                                |
| 2        | 1     | uint8  | codec, position in `CODECS`                                |
| 3        | 1     | uint8  | number of views M                                          |
| 4        | 4     | uint16 | rows, columns                                              |
| 8        | 8     | -      | zero: the room that VOI, deadline, client and sequence take |
| 16       | 4     | uint32 | CRC-32 (zlib) of every byte of the payload except these    |
| 20       | 4 M   | uint32 | lengths                                                    |
| 20 + 4 M |       |        | coded views                                                |
"""

import io
import re
import struct
import zlib
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ovibjax.errors import InputError

Images = NDArray[np.uint8]
"""The views of one frame, [M, H, W, 3] red, green and blue."""

STILLS = {"jpeg": "JPEG", "webp": "WebP"}
CLIPS = {"h264": "H.264", "h265": "H.265"}
CODECS = (*STILLS, *CLIPS)
NAMES = STILLS | CLIPS
"""Codecs by kind, with the names that figures use."""

LADDERS: dict[str, tuple[int, ...]] = {
    "jpeg": (1, 4, 8, 15, 40),
    "webp": (0, 5, 15, 35, 70),
    "h264": (51, 46, 41, 36, 28),
    "h265": (51, 46, 41, 36, 28),
}
"""Qualities from the coarsest that the codec has; JPEG and WebP: quality, H.264 and H.265: constant rate factor."""

_HEAD = struct.Struct("<2sBBHH8x")
_CRC = struct.Struct("<I")
_MAX_VIEWS, _MAX_SIDE_PX = 16, 0xFFFF
# One thread and, for x264, no assembly: its look-ahead gives other bytes on other processors, and even with what the
# memory held before. The result does not depend on the machine. x265 would also write its settings into the stream.
_ENCODERS: dict[str, tuple[str, dict[str, str]]] = {
    "h264": ("libx264", {"preset": "medium", "x264-params": "threads=1:sliced-threads=0:lookahead-threads=1:asm=0"}),
    "h265": ("libx265", {"preset": "medium", "x265-params": "pools=none:frame-threads=1:wpp=0:info=0:log-level=none"}),
}
_DECODERS = {"h264": "h264", "h265": "hevc"}
_NAL = re.compile(b"\x00\x00\x00?\x01")


def encode(codec: str, quality: int, views: Images) -> bytes:
    """Code the views of one frame.

    Args:
        codec: one of `CODECS`.
        quality: JPEG and WebP 0 to 100, more is better; H.264 and H.265 constant rate factor 0 to 51, less is better.
        views: [M, H, W, 3] RGB.

    Returns:
        The payload; its length is what is sent. Equal arguments give equal bytes.

    Raises:
        InputError: an unknown codec, a quality or shape out of range, or the extra `[video]` is missing.
    """
    top = 100 if codec in STILLS else 51
    if codec not in CODECS:
        raise InputError(f"codec {codec!r} is not one of {', '.join(CODECS)}")
    if not 0 <= quality <= top:
        raise InputError(f"quality {quality} of {codec} is not in 0 to {top}")
    if views.dtype != np.uint8 or views.ndim != 4 or views.shape[3] != 3 or 0 in views.shape:
        raise InputError(f"views have dtype {views.dtype} and shape {views.shape}, expected uint8 [M, H, W, 3]")
    count, rows, columns, _ = views.shape
    if count > _MAX_VIEWS or max(rows, columns) > _MAX_SIDE_PX:
        raise InputError(f"{count} views of {columns} x {rows} px: at most {_MAX_VIEWS} of {_MAX_SIDE_PX} px a side")
    if codec in STILLS:
        coded = [_encode_still(codec, quality, view) for view in views]
        lengths = [len(code) for code in coded]
    else:
        coded = [_encode_clip(codec, quality, views)]
        lengths = [len(coded[0])] + [0] * (count - 1)
    head = _HEAD.pack(b"IC", CODECS.index(codec), count, rows, columns)
    body = struct.pack(f"<{count}I", *lengths) + b"".join(coded)
    return head + _CRC.pack(zlib.crc32(head + body)) + body


def decode(data: bytes) -> Images:
    """The views that a payload shows.

    Args:
        data: exactly one payload of `encode`.

    Returns:
        [M, H, W, 3] RGB.

    Raises:
        InputError: not a payload, a damaged one, or the extra `[video]` is missing.
    """
    start = _HEAD.size + _CRC.size
    if len(data) < start:
        raise InputError(f"payload of {len(data)} bytes is shorter than its {start}-byte header")
    magic, number, count, rows, columns = _HEAD.unpack_from(data)
    (crc,) = _CRC.unpack_from(data, _HEAD.size)
    if magic != b"IC" or number >= len(CODECS) or crc != zlib.crc32(data[: _HEAD.size] + data[start:]):
        raise InputError("payload is damaged, or not one of an image codec")
    body, codec = data[start + 4 * count :], CODECS[number]
    lengths = struct.unpack_from(f"<{count}I", data, start) if len(data) >= start + 4 * count else ()
    if not lengths or sum(lengths) != len(body):
        raise InputError(f"payload has {len(body)} bytes of code, not what its lengths say")
    if codec in CLIPS:
        return _decode_clip(codec, body, (count, rows, columns))
    ends = np.cumsum(lengths).tolist()
    parts = [body[end - length : end] for end, length in zip(ends, lengths, strict=True)]
    return np.stack([_decode_still(codec, part, (rows, columns)) for part in parts])


def video_missing() -> str:
    """Why H.264 and H.265 cannot be used here; empty if they can."""
    try:
        _av("h264")
        _av("h265")
    except InputError as error:
        return str(error)
    return ""


def _encode_still(codec: str, quality: int, view: Images) -> bytes:
    stream = io.BytesIO()
    # Both with their slower, smaller modes, which a client on a thin link would choose.
    options: dict[str, Any] = {"optimize": True, "progressive": True} if codec == "jpeg" else {"method": 6}
    try:
        Image.fromarray(view).save(stream, codec, quality=quality, **options)
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{codec}: this image cannot be coded here ({error})") from error
    return stream.getvalue()


def _decode_still(codec: str, code: bytes, shape: tuple[int, int]) -> Images:
    try:
        image = Image.open(io.BytesIO(code), formats=[codec])
        if image.size != shape[::-1]:  # checked before any pixel is made room for
            raise InputError(f"{codec}: the image has {image.width} x {image.height} px, not {shape[1]} x {shape[0]}")
        return np.asarray(image.convert("RGB"))
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{codec}: the image cannot be decoded ({error})") from error


def _av(codec: str) -> ModuleType:
    """PyAV with both directions of a codec."""
    try:
        import av
    except ImportError as error:
        raise InputError(f'{codec} needs the extra [video]: pip install "ovibjax[video]"') from error
    missing = [name for name in (_ENCODERS[codec][0], _DECODERS[codec]) if name not in av.codecs_available]
    if missing:
        raise InputError(f"{codec}: the installed av has no {missing[0]}; install the one from PyPI: pip install av")
    return av


def _encode_clip(codec: str, quality: int, views: Images) -> bytes:
    av = _av(codec)
    name, options = _ENCODERS[codec]
    # 4:2:0 needs even sides; the decoder cuts the repeated edge off again.
    rows, columns = views.shape[1:3]
    even = np.pad(views, ((0, 0), (0, rows % 2), (0, columns % 2), (0, 0)), mode="edge")
    context = av.CodecContext.create(name, "w")
    context.width, context.height, context.pix_fmt = even.shape[2], even.shape[1], "yuv420p"
    context.framerate, context.thread_count = 25, 1
    context.options = {**options, "crf": str(quality)}
    packets = []
    for index, view in enumerate(even):
        frame = av.VideoFrame.from_ndarray(view, format="rgb24").reformat(format="yuv420p")
        frame.pts = index
        packets += context.encode(frame)
    packets += context.encode(None)
    stream = b"".join(bytes(packet) for packet in packets)
    return _without_settings(stream) if codec == "h264" else stream


def _without_settings(stream: bytes) -> bytes:
    """An H.264 stream less its supplemental units: x264 writes 0.7 KB about itself, which no client would send."""
    starts = [match.span() for match in _NAL.finditer(stream)]
    ends = [begin for begin, _ in starts[1:]] + [len(stream)]
    kept = (stream[a:end] for (a, b), end in zip(starts, ends, strict=True) if stream[b] & 0x1F != 6)
    return b"".join(kept)


def _decode_clip(codec: str, stream: bytes, shape: tuple[int, int, int]) -> Images:
    av = _av(codec)
    context = av.CodecContext.create(_DECODERS[codec], "r")
    context.thread_count = 1
    count, rows, columns = shape
    try:
        packets = [*context.parse(stream), *context.parse(None)]
        frames = [frame for packet in packets for frame in context.decode(packet)] + list(context.decode(None))
    except av.error.FFmpegError as error:
        raise InputError(f"{codec}: the clip cannot be decoded ({error})") from error
    if len(frames) != count:
        raise InputError(f"{codec}: the clip has {len(frames)} frames, not {count}")
    if any((frame.height, frame.width) != (rows + rows % 2, columns + columns % 2) for frame in frames):
        raise InputError(f"{codec}: the clip does not have {columns} x {rows} px")
    return np.stack([frame.to_ndarray(format="rgb24")[:rows, :columns] for frame in frames])

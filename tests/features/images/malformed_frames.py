"""Malformed frames by name: images, metadata and folders of the released layout that are not what they claim."""

import io
import json
import os
import pickle
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from ovibjax.views import VIEWS
from tests.features.images.made_images import about, encode, pack, pixels, write, write_layout

Builder = Callable[[Path], list[str]]
FRONT = "rgb/Front/000000.png"
METADATA = "metadata/000000.json"


class Evil:
    """Unpickled, it would write a file."""

    def __reduce__(self):
        return Path.write_text, (Path("pwned"), "x")


PICKLE = pickle.dumps(Evil())


def features(src: str, *more: str) -> list[str]:
    return ["features", src, "--out", "out/x.npz", *more]


def zipped(files: dict[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return stream.getvalue()


def png(width: int, height: int, depth: int = 8, colour: int = 2, crc: bool = True, data: bytes = b"") -> bytes:
    """A PNG that claims a size, whatever its data."""
    chunks = b""
    for kind, content in ((b"IHDR", struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)), (b"IDAT", data)):
        mark = zlib.crc32(kind + content) ^ (not crc)
        chunks += struct.pack(">I", len(content)) + kind + content + struct.pack(">I", mark)
    return b"\x89PNG\r\n\x1a\n" + chunks + b"\0\0\0\0IEND\xaeB`\x82"


def images() -> Iterator[tuple[str, bytes]]:
    whole, photo = encode(pixels(0)), encode(pixels(0, width=64, height=48), "jpeg")
    for at in np.linspace(0, len(whole) - 40, 18).astype(int):
        yield f"PNG cut at {at}", whole[:at]
    for at in np.linspace(2, 0.8 * len(photo), 12).astype(int):
        yield f"JPEG cut at {at}", photo[:at]
    yield "WebP cut", encode(pixels(0), "webp")[:60]
    yield "PNG of 2**31-1 squared", png(2**31 - 1, 2**31 - 1)
    yield "PNG of 30000 squared", png(30_000, 30_000, data=zlib.compress(bytes(10**6)))
    yield "PNG of 9000 squared", png(9_000, 9_000, data=zlib.compress(bytes(10**6)))
    yield "PNG of 1 x 50000", png(1, 50_000, data=zlib.compress(bytes(200_000)))
    yield "PNG of no pixels", png(0, 0)
    yield "PNG without data", png(8, 8)
    yield "PNG of depth 77", png(8, 8, depth=77)
    yield "PNG of colour type 9", png(8, 8, colour=9)
    yield "PNG with a wrong checksum", png(8, 8, crc=False, data=zlib.compress(bytes(200)))
    yield "PNG with damaged data", png(8, 8, data=zlib.compress(bytes(200))[:5] + b"\xff" * 9)
    yield "PNG with too little data", png(8, 8, data=zlib.compress(bytes(20)))
    yield "JPEG of 65535 squared", photo.replace(struct.pack(">HH", 48, 64), b"\xff\xff\xff\xff", 1)
    yield "flipped JPEG header", photo[:2] + b"\0\0" + photo[4:]
    yield "text", b"not an image at all\n"
    yield "SVG", b"<svg xmlns='http://www.w3.org/2000/svg' width='9' height='9'/>"
    yield "GIF", encode(pixels(0), "gif")
    yield "TIFF", encode(pixels(0), "tiff")
    yield "EPS", b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\nshowpage\n"
    yield "pickle", PICKLE
    yield "zeros", bytes(5000)
    yield "PNG text bomb", whole[:33] + _chunk(b"zTXt", b"a\0\0" + zlib.compress(bytes(10**8))) + whole[33:]


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def with_image(content: bytes, packed: bool) -> Builder:
    def build(root: Path) -> list[str]:
        write(write_layout(root / "town", 1) / FRONT, content)
        return features(pack(root / "town", root / "t.tar").name) if packed else features("town")

    return build


def metadata() -> Iterator[tuple[str, bytes]]:
    def changed(**fields) -> bytes:
        state = about(0)["uav_state"]
        return json.dumps(about(0, uav_state={**state, **fields})).encode()

    x, y = {"x": 1.0, "y": 2.0, "z": 3.0}, {"pitch": 0.0, "yaw": 0.0, "roll": 0.0}
    for name, value in (("NaN", np.nan), ("infinity", np.inf), ("text", "1.0"), ("null", None), ("true", True)):
        yield f"x is {name}", changed(position=x | {"x": value})
        yield f"yaw is {name}", changed(rotation=y | {"yaw": value})
    yield "x has 400 digits", changed(position=x | {"x": 10**400})
    yield "x is 1e400", changed().replace(b'"x": 0.0', b'"x": 1e400')
    yield "x is beyond all maps", changed(position=x | {"x": 1e30})
    yield "x is a list", changed(position=x | {"x": [1.0]})
    yield "no z", changed(position={"x": 1.0, "y": 2.0})
    yield "position of two", changed(position=[1.0, 2.0])
    yield "position of four", changed(position=[1.0, 2.0, 3.0, 4.0])
    yield "position is text", changed(position="1 2 3")
    yield "no rotation", changed(rotation=None)
    yield "no yaw", changed(rotation={"pitch": 0.0, "roll": 0.0})
    yield "no state", json.dumps({"timestamp": 0}).encode()
    yield "state is a list", json.dumps({"uav_state": [1, 2, 3]}).encode()
    yield "a list", b"[]"
    yield "a number", b"5"
    yield "empty", b""
    yield "half", changed()[:50]
    yield "nested too deep", b"[" * 100_000
    yield "5000 digits", b'{"uav_state": ' + b"9" * 5000 + b"}"
    yield "not UTF-8", b'{"uav_state": "\xff\xfe\xfa"}'
    yield "a pickle", PICKLE
    yield "too large", changed() + b" " * 2_000_000


def with_metadata(content: bytes, packed: bool) -> Builder:
    def build(root: Path) -> list[str]:
        write(write_layout(root / "town", 1) / METADATA, content)
        return features(pack(root / "town", root / "t.tar").name) if packed else features("town")

    return build


def folders() -> Iterator[tuple[str, Callable[[Path], object]]]:
    def without(*parts: str) -> Callable[[Path], object]:
        def change(town: Path) -> None:
            for part in parts:
                for file in sorted((town / part).rglob("*"), reverse=True):
                    file.unlink()
                (town / part).rmdir()

        return change

    for view in VIEWS[:4]:
        yield f"no camera {view}", without(f"rgb/{view}")
    yield "no metadata", without("metadata")
    yield "no images", without(*(f"rgb/{view}" for view in VIEWS))
    yield "all cameras empty", lambda town: [file.unlink() for file in town.rglob("*.png")]
    yield "no frame in common", lambda town: (town / FRONT).rename(town / "rgb/Front/000001.png")
    yield "metadata of other frames", lambda town: (town / METADATA).rename(town / "metadata/1.json")
    yield "two images of a frame", lambda town: write(town / "rgb/Back/000000.jpg", encode(pixels(1), "jpeg"))
    yield "name not UTF-8", lambda town: write(Path(os.fsdecode(bytes(town / "rgb/Left") + b"/\xff\xfe.png")), b"x")
    yield (
        "metadata name not UTF-8",
        lambda town: write(Path(os.fsdecode(bytes(town / "metadata") + b"/\xff.json")), b"{}"),
    )
    yield "line break in a name", lambda town: write(town / "rgb/Left/a\nb.png", b"x")
    yield "escape in a name", lambda town: write(town / "rgb/Left/a\x1b[31m.png", b"x")
    yield "calibration is no JSON", lambda town: write(town / "calibration/camera_calibration.json", b"{")
    yield "calibration is a list", lambda town: write(town / "calibration/camera_calibration.json", b"[]")
    yield "calibration is a pickle", lambda town: write(town / "calibration/camera_calibration.json", PICKLE)
    yield "image is a folder", lambda town: [(town / FRONT).unlink(), (town / FRONT).mkdir()]
    yield "image is a pipe", lambda town: [(town / FRONT).unlink(), os.mkfifo(town / FRONT)]
    yield "image is a dangling link", lambda town: [(town / FRONT).unlink(), (town / FRONT).symlink_to("nowhere")]
    yield "metadata is a folder", lambda town: [(town / METADATA).unlink(), (town / METADATA).mkdir()]
    yield "images of another kind", lambda town: (town / FRONT).rename(town / "rgb/Front/000000.gif")


def with_folder(change: Callable[[Path], object]) -> Builder:
    def build(root: Path) -> list[str]:
        change(write_layout(root / "town", 1))
        return features("town")

    return build

"""Malformed inputs by name: each builder writes into a folder and returns the command line that meets it."""

import bz2
import gzip
import io
import json
import lzma
import os
import pickle
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from ovibjax.views import VIEWS
from tests.features.images.made_images import about, encode, pack, pixels, write, write_layout, write_table

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


# --- one image of the only frame ---------------------------------------------------------------------------


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


# --- metadata of the only frame ----------------------------------------------------------------------------


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


# --- folders -----------------------------------------------------------------------------------------------


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
    yield "images of another kind", lambda town: (town / FRONT).rename(town / "rgb/Front/000000.bmp")


def with_folder(change: Callable[[Path], object]) -> Builder:
    def build(root: Path) -> list[str]:
        change(write_layout(root / "town", 1))
        return features("town")

    return build


# --- archives ----------------------------------------------------------------------------------------------


def member(name: str, content: bytes = b"x", **fields) -> bytes:
    """Header and data of one member, in the GNU form."""
    info = tarfile.TarInfo(name)
    info.size = len(content)
    for key, value in fields.items():
        setattr(info, key, value)
    return info.tobuf(tarfile.GNU_FORMAT, "utf-8", "surrogateescape") + content + bytes(-len(content) % 512)


def claim(header: bytes, size: bytes) -> bytes:
    """The header with another size and a right checksum."""
    header = header[:124] + size + header[136:148] + b" " * 8 + header[156:]
    return header[:148] + b"%06o\0 " % sum(header[:512]) + header[156:]


def archives(root: Path) -> Iterator[tuple[str, bytes]]:
    whole = pack(write_layout(root / "town", 1), root / "t.tar").read_bytes()
    used = len(whole.rstrip(b"\0"))
    packed = gzip.compress(whole)
    for at in np.linspace(0, used - used % 512, 14).astype(int):
        yield f"cut at {at}", whole[:at]
    for at in np.linspace(2, len(packed) - 1, 10).astype(int):
        yield f"gzip cut at {at}", packed[:at]
    for name in (
        "/etc/passwd",
        "../up.png",
        "rgb/../../up.png",
        "..",
        "a\\..\\..\\up.png",
        "C:\\up.png",
        "\\\\host\\x",
    ):
        yield f"path {name}", member(name) + whole
    kinds = {"symlink": b"2", "hard link": b"1", "character device": b"3", "block device": b"4", "pipe": b"6"}
    for name, kind in kinds.items():
        yield name, member("rgb/Front/9.png", b"", type=kind, linkname="/etc/passwd") + whole
    yield "link out of the archive", member("rgb/Up", b"", type=b"2", linkname="../..") + whole
    yield "sparse file", member("rgb/Front/9.png", b"", type=b"S") + whole
    yield "size of 8 GiB", claim(member(FRONT), b"77777777777\0")
    yield "size of 2**62", claim(member(FRONT), b"\x80" + struct.pack(">IQ", 0, 2**62)[1:])
    yield "negative size", member("a") + claim(member(FRONT), b"\xff" * 11 + b"\0") + whole
    yield "size is no number", claim(member(FRONT), b"not a number")
    yield "long name of 1 GiB", claim(member("././@LongLink", type=b"L"), b"10000000000\0")
    yield "long name of negative length", claim(member("././@LongLink", type=b"L"), b"\xff" * 12) + whole
    yield "extended header of 1 GiB", claim(member("x", type=b"x"), b"10000000000\0")
    yield "extended path leads out", _pax(path="../../up.png") + member("fine.png") + whole
    yield "extended size is huge", _pax(size=str(2**60)) + member(FRONT) + whole
    yield "extended size is negative", _pax(size="-100000") + member(FRONT) + whole
    yield "checksum wrong in the middle", whole[:5120] + whole[5120:].replace(b"ustar", b"usta!")
    yield "checksum wrong at once", b"X" + whole[1:]
    yield "member twice", member(FRONT, encode(pixels(0))) + whole
    yield "name not UTF-8", member("rgb/Front/\udcff\udcfe.png") + whole
    yield "line break in a name", member("rgb/Front/a\nb.png") + whole
    yield "empty", b""
    yield "zeros", bytes(10240)
    yield "only other files", member("readme.txt") + bytes(1024)
    yield "text", b"this is no archive\n" * 1000
    yield "bzip2", bz2.compress(whole)
    yield "xz", lzma.compress(whole)
    yield "zip", _zip({"rgb/Front/0.png": b"x"})
    yield "pickle", PICKLE
    yield "gzip of text", gzip.compress(b"no archive" * 500)
    yield "gzip bomb", gzip.compress(member("a.png", b"x") + bytes(10**8), 1)
    yield "gzip with a wrong checksum", packed[:-8] + b"\0\0\0\0" + packed[-4:]
    yield "gzip with damaged data", packed[:200] + b"\xff" * 50 + packed[250:]
    yield "gzip with something behind", packed + b"garbage"


def _pax(**fields: str) -> bytes:
    records = b""
    for key, value in fields.items():
        record = f" {key}={value}\n".encode()
        length = len(record) + 2 if len(record) + 2 < 100 else len(record) + 3
        records += str(length).encode() + record
    return member("PaxHeaders/x", records, type=b"x")


def _zip(files: dict[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return stream.getvalue()


def with_archive(content: bytes) -> Builder:
    def build(root: Path) -> list[str]:
        write(root / "data.tar", content)
        return features("data.tar")

    return build


# --- tables ------------------------------------------------------------------------------------------------

HEADER = b"frame,x_m,y_m,z_m,yaw_deg"
ROW = b"\n0,1,2,3,4"


def tables() -> Iterator[tuple[str, bytes]]:
    names = HEADER.split(b",")
    for name in names:
        yield f"no column {name.decode()}", HEADER.replace(name, b"other") + ROW
    yield "a column twice", HEADER + b",x_m" + ROW + b",5"
    yield "semicolons", HEADER.replace(b",", b";") + ROW.replace(b",", b";")
    yield "too few values", HEADER + b"\n0,1,2,3"
    yield "too many values", HEADER + ROW + b",5,6"
    yield "frame twice", HEADER + ROW + ROW
    yield "empty", b""
    yield "only a header", HEADER + b"\n"
    yield "not UTF-8", HEADER + b"\n\xff,1,2,3,4"
    yield "UTF-16", (HEADER + ROW).decode().encode("utf-16")
    yield "zero byte", HEADER + b"\n\0,1,2,3,4"
    yield "open quote", HEADER + b'\n"0,1,2,3,4'
    yield "text behind a quote", HEADER + b'\n"0"x,1,2,3,4'
    yield "unknown context", HEADER + b",context" + ROW + b",jungle"
    yield "frame is empty", HEADER + b"\n,1,2,3,4"
    yield "frame with an escape", HEADER + b"\na\x1b[31m,1,2,3,4"
    yield "frame of 300 letters", HEADER + b"\n" + b"a" * 300 + b",1,2,3,4"
    yield "field of a megabyte", HEADER + b"\n0," + b"1" * 10**6 + b",2,3,4"
    for value in (b"abc", b"0x10", b"1 2", b"--5"):
        yield f"x is {value.decode()}", HEADER + b"\n0," + value + b",2,3,4"
    for value in (b"", b"nan", b"inf", b"-inf", b"1e99"):
        yield f"pose is {value.decode() or 'empty'}", HEADER + b"\n0,1,2,3," + value
    for value in (b"../0", b"/etc/passwd", b"..\\0", b"a/../../0"):
        yield f"frame {value.decode()}", HEADER + b"\n" + value + b",1,2,3,4"
    yield "images that do not exist", HEADER + b"\n77,1,2,3,4"
    yield "pickle", PICKLE


PATTERNS = (
    *("/tmp/{view}/{frame}.png", "../{view}/{frame}.png", "a/../../{view}/{frame}.png", "..\\{view}\\{frame}.png"),
    *("images/{frame}.png", "images/{view}/0.png", "images/{view}/{frame}/{other}.png", "images/{}/{frame}.png"),
    *("{view.__class__}/{frame}.png", "{view}/{frame[0]}.png", "{view!r}/{frame}.png", "{view}/{frame:>99999999}.png"),
    *("{view}/{frame:x}.png", "{view:upper}/{frame}.png", "{view/{frame}.png", "{view}}/{frame}.png", ""),
    *("C:\\{view}\\{frame}.png", "{scene}/{view}/{frame}.png", "images/{view}/\n{frame}.png"),
)


def with_table(content: bytes) -> Builder:
    def build(root: Path) -> list[str]:
        write(write_table(root, 1), content)
        return features("my.csv", "--images", "images/{view}/{frame}.png")

    return build


def with_pattern(pattern: str) -> Builder:
    def build(root: Path) -> list[str]:
        write_table(root, 1)
        return features("my.csv", f"--images={pattern}")

    return build


# --- options -----------------------------------------------------------------------------------------------


def options() -> Iterator[tuple[str, Builder]]:
    def town(*arguments: str) -> Builder:
        return lambda root: [*(write_layout(root / "town", 2) and ()), *arguments]

    def strict(root: Path) -> list[str]:
        write(write_layout(root / "town", 2) / FRONT, encode(pixels(0))[:80])
        return features("town", "--strict")

    yield "no such source", town(*features("absent"))
    yield "no such table", town(*features("absent.csv", "--images", "{view}/{frame}.png"))
    yield "source of another kind", lambda root: features(write(root / "x.npz", _zip({"a": b"b"})).name)
    yield "source is a pickle", lambda root: features(write(root / "x.pkl", PICKLE).name)
    yield "folder called .tar", lambda root: [(root / "x.tar").mkdir(), features("x.tar")][1]
    yield "table without a pattern", lambda root: features(write_table(root).name)
    yield "pattern for a folder", town(*features("town", "--images", "{view}/{frame}.png"))
    yield "out of another kind", town("features", "town", "--out", "out/x.csv")
    yield "out in no folder", town("features", "town", "--out", "absent/x.npz")
    yield (
        "out is a folder",
        lambda root: [(root / "out/y.npz").mkdir(), town("features", "town", "--out", "out/y.npz")(root)][1],
    )
    yield "batch of none", town(*features("town", "--batch", "0"))
    yield "unknown backbone", town(*features("town", "--backbone", "resnet"))
    yield "misspelt option", town(*features("town", "--strikt"))
    yield "five views of a UGV", lambda root: features(write_layout(root / "ugv", 1, VIEWS[:4]).name, "--views", "5")
    yield "strict and a broken image", strict


# --- feature files, which any command takes ----------------------------------------------------------------


def npz(**arrays) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def feature_files() -> Iterator[tuple[str, bytes]]:
    good = {"features": np.ones((3, 5, 4), np.float32), "positions_m": np.zeros((3, 3))}
    whole = npz(**good)
    yield "pickle", PICKLE
    yield "objects", npz(features=np.array([[Evil()]], object), positions_m=good["positions_m"])
    yield "object frame names", npz(**good, frame_id=np.array([Evil(), 1, 2], object))
    yield "a pickle inside", _zip({"features.npy": PICKLE, "positions_m.npy": PICKLE})
    for name, array in (
        ("two axes", np.ones((3, 5))),
        ("three views", np.ones((3, 3, 4))),
        ("no frames", np.ones((0, 5, 4))),
    ):
        yield f"features with {name}", npz(features=array, positions_m=good["positions_m"])
    yield "positions in a plane", npz(features=good["features"], positions_m=np.zeros((3, 2)))
    yield "other frames", npz(features=good["features"], positions_m=np.zeros((4, 3)))
    yield "NaN poses", npz(features=good["features"], positions_m=np.full((3, 3), np.nan))
    yield "NaN features", npz(features=good["features"] * np.nan, positions_m=good["positions_m"])
    yield "zero features", npz(features=good["features"] * 0, positions_m=good["positions_m"])
    yield "no positions", npz(features=good["features"])
    yield "too few frames", whole
    head = b"\x93NUMPY\x01\x00"
    text = b"{'descr': '<f4', 'fortran_order': False, 'shape': (999999999, 5, 512), }"
    text = text.ljust(117) + b"\n"
    yield (
        "huge declared shape",
        _zip({"features.npy": head + struct.pack("<H", len(text)) + text, "positions_m.npy": b""}),
    )
    for at in np.linspace(1, len(whole) - 2, 8).astype(int):
        yield f"cut at {at}", whole[:at]


def with_features(content: bytes) -> Builder:
    def build(root: Path) -> list[str]:
        write(root / "x.npz", content)
        return [
            "reproduce",
            "--data",
            "x.npz",
            "--only",
            "scalable_compression",
            "--preset",
            "smoke",
            "--out",
            "out/res",
        ]

    return build


def cases(scratch: Path) -> dict[str, Builder]:
    """All builders by name; `scratch` is for what they share."""
    found: dict[str, Builder] = {}
    for name, content in images():
        found[f"image: {name}"] = with_image(content, packed=len(found) % 4 == 0)
    for name, content in metadata():
        found[f"metadata: {name}"] = with_metadata(content, packed=len(found) % 4 == 0)
    found |= {f"folder: {name}": with_folder(change) for name, change in folders()}
    found |= {f"archive: {name}": with_archive(content) for name, content in archives(scratch)}
    found |= {f"table: {name}": with_table(content) for name, content in tables()}
    found |= {f"pattern: {pattern!r}": with_pattern(pattern) for pattern in PATTERNS}
    found |= {f"option: {name}": build for name, build in options()}
    found |= {f"features: {name}": with_features(content) for name, content in feature_files()}
    return found

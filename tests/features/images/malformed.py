"""Malformed inputs by name: each builder writes into a folder and returns the command line that meets it."""

import io
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ovibjax.views import VIEWS
from tests.features.images.made_images import encode, pixels, write, write_layout, write_table
from tests.features.images.malformed_archives import archives, with_archive
from tests.features.images.malformed_frames import (
    FRONT,
    PICKLE,
    Builder,
    Evil,
    features,
    folders,
    images,
    metadata,
    with_folder,
    with_image,
    with_metadata,
    zipped,
)

HEADER = b"frame,x_m,y_m,z_m,yaw_deg"
ROW = b"\n0,1,2,3,4"


def tables() -> Iterator[tuple[str, bytes]]:
    names = HEADER.split(b",")
    for name in names:
        yield f"no column {name.decode()}", HEADER.replace(name, b"other") + ROW
    yield "a column twice", HEADER + b",x_m" + ROW + b",5"
    yield "semicolons below commas", HEADER + ROW.replace(b",", b";")
    yield "decimal commas and points", (HEADER + b"\n0,1.5,2,3,4").replace(b",", b"\t") + b"\n1\t1,5\t2\t3\t4"
    yield "six numbers without a name", b"0,1,2,3,4,5"
    yield "a quaternion of zeros", b"frame,x_m,y_m,z_m,qw,qx,qy,qz\n0,1,2,3,0,0,0,0"
    yield "a heading of no kind", HEADER.replace(b"yaw_deg", b"yaw") + ROW
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


def options() -> Iterator[tuple[str, Builder]]:
    def town(*arguments: str) -> Builder:
        return lambda root: [*(write_layout(root / "town", 2) and ()), *arguments]

    def strict(root: Path) -> list[str]:
        write(write_layout(root / "town", 2) / FRONT, encode(pixels(0))[:80])
        return features("town", "--strict")

    yield "no such source", town(*features("absent"))
    yield "no such table", town(*features("absent.csv", "--images", "{view}/{frame}.png"))
    yield "source of another kind", lambda root: features(write(root / "x.npz", zipped({"a": b"b"})).name)
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
    yield "a pickle inside", zipped({"features.npy": PICKLE, "positions_m.npy": PICKLE})
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
        zipped({"features.npy": head + struct.pack("<H", len(text)) + text, "positions_m.npy": b""}),
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

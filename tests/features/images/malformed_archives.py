"""Malformed archives by name: cut, damaged, leading out of themselves, or claiming what they do not hold."""

import bz2
import gzip
import importlib
import io
import lzma
import struct
import sys
import tarfile
import warnings
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tests.features.images.made_images import encode, pack, pixels, write, write_layout
from tests.features.images.malformed_frames import FRONT, PICKLE, Builder, features, zipped

zstd: Any = importlib.import_module("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd")


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
    for name, other in (("bzip2", bz2.compress(whole)), ("xz", lzma.compress(whole)), ("zstd", zstd.compress(whole))):
        for at in (12, len(other) // 2, len(other) - 6):
            yield f"{name} cut at {at}", other[:at]
            yield f"{name} damaged at {at}", other[:at] + b"\xff\x00\xff\x00" + other[at + 4 :]
        yield f"{name} of text", {"bzip2": bz2, "xz": lzma, "zstd": zstd}[name].compress(b"no archive" * 500)
    yield "bzip2 bomb", bz2.compress(member("a.png", b"x") + bytes(10**8))
    packed_zip = zip_of(root / "town")
    yield "zip without poses", zipped({"rgb/Front/0.png": b"x"})
    yield "zip cut", packed_zip[: len(packed_zip) // 2]
    yield "zip cut at its end", packed_zip[:-10]
    for name in ("../up.png", "/etc/passwd", "a\\..\\..\\up.png", "C:\\up.png"):
        yield f"zip with {name}", zip_of(root / "town", {name: b"x"})
    yield "zip with a member twice", zip_of(root / "town", {FRONT: b"x"})
    yield "zip with a link", zip_of(root / "town", {"rgb/Front/9.png": b"/etc/passwd"}, mode=0o120777)
    yield "zip with an encrypted image", encrypted(packed_zip)
    yield "pickle", PICKLE
    yield "gzip of text", gzip.compress(b"no archive" * 500)
    yield "gzip bomb", gzip.compress(member("a.png", b"x") + bytes(10**8), 1)
    yield "gzip with a wrong checksum", packed[:-8] + b"\0\0\0\0" + packed[-4:]
    yield "gzip with damaged data", packed[:200] + b"\xff" * 50 + packed[250:]
    yield "gzip with something behind", packed + b"garbage"


def zip_of(folder: Path, more: dict[str, bytes] | None = None, mode: int = 0o100644, **options) -> bytes:
    """The folder's content and more as a zip archive."""
    stream = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(stream, "w", **options) as archive:
        warnings.simplefilter("ignore")  # of names that are there twice
        for file in sorted(folder.rglob("*")):
            archive.write(file, file.relative_to(folder))
        for name, content in (more or {}).items():
            info = zipfile.ZipInfo(name)
            info.external_attr = mode << 16
            archive.writestr(info, content)
    return stream.getvalue()


def encrypted(archive: bytes) -> bytes:
    """The archive with its first image marked as encrypted, in the directory and before its content."""
    name = FRONT.encode()
    entry = archive.rindex(b"PK\x01\x02", 0, archive.rindex(name))
    local = archive.rindex(b"PK\x03\x04", 0, archive.index(name))
    for at in (entry + 8, local + 6):
        archive = archive[:at] + b"\x01" + archive[at + 1 :]
    return archive


def _pax(**fields: str) -> bytes:
    records = b""
    for key, value in fields.items():
        record = f" {key}={value}\n".encode()
        length = len(record) + 2 if len(record) + 2 < 100 else len(record) + 3
        records += str(length).encode() + record
    return member("PaxHeaders/x", records, type=b"x")


def with_archive(content: bytes) -> Builder:
    def build(root: Path) -> list[str]:
        write(root / "data.tar", content)
        return features("data.tar")

    return build

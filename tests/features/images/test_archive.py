"""Archives: names as other programs write them, and bytes of a gzip file from any place in it."""

import bz2
import gzip
import io
import itertools
import lzma
import tarfile
import tempfile
import zipfile

import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.features.images.by_path import open_source
from ovibjax.features.images.decoding import decode_image
from ovibjax.features.images.gzip_access import GzipReader
from tests.features.images.made_images import (
    frames_of,
    pack,
    pixels,
    write,
    write_layout,
)
from tests.features.images.malformed_archives import member, zip_of, zstd


@pytest.mark.parametrize("form", [tarfile.GNU_FORMAT, tarfile.PAX_FORMAT])
def test_long_and_foreign_names_are_read(tmp_path, form):
    root = write_layout(tmp_path / "a", 1)
    name = "ünï" * 40
    with tarfile.open(tmp_path / "a.tar", "w", format=form) as tar:
        tar.add(root, f"./{name}")
    source, images = frames_of(tmp_path / "a.tar")
    assert source.frames[0].images[0] == f"{name}/rgb/Front/000000.png"
    np.testing.assert_array_equal(decode_image(images[0][4]), pixels(0, 4))


@pytest.mark.parametrize("length", [0, 1, 2**22 - 1, 2**22, 2**22 + 1, 2**23, 13_000_000])
def test_gzip_content_is_read_at_any_offset(tmp_path, length):
    content = np.random.default_rng(0).bytes(length)
    half = length // 2
    packed = gzip.compress(content[:half], 1) + bytes(700) + gzip.compress(content[half:], 1) + bytes(300_000)
    with write(tmp_path / "x.gz", packed).open("rb") as file:
        reader = GzipReader("x.gz", file.fileno(), len(packed))
        for offset in (length - 3, 0, half - 5, 2**22 - 1, 3 * 2**22 - 2, length, 10**12):
            offset = max(offset, 0)
            assert reader.read(100, offset) == content[offset : offset + 100]
        reader.check_rest()
        assert reader.read(length + 1, 0) == content


PACKERS = {"bz2": bz2.compress, "xz": lzma.compress, "zst": zstd.compress, "gz": gzip.compress}


@pytest.mark.parametrize("streams", [1, 3])
@pytest.mark.parametrize("suffix", PACKERS)
def test_packed_archives_give_what_the_folder_gives(tmp_path, suffix, streams):
    root = write_layout(tmp_path / "a", 2)
    whole = pack(root, tmp_path / "a.tar").read_bytes()
    cuts = np.linspace(0, len(whole), streams + 1).astype(int)
    parts = [PACKERS[suffix](whole[start:end]) for start, end in itertools.pairwise(cuts)]
    source, images = frames_of(write(tmp_path / f"b.tar.{suffix}", b"".join(parts)))
    assert source.frames == frames_of(root)[0].frames
    np.testing.assert_array_equal(decode_image(images[1][4]), pixels(1, 4))


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
@pytest.mark.parametrize("separator", ["/", "\\"])
def test_zip_archives_give_what_the_folder_gives(tmp_path, method, separator):
    root = write_layout(tmp_path / "a", 2)
    content = zip_of(root, {"notes.txt": b"x", "rgb/Front/thumbs.db": b"x"}, compression=method)
    content = content.replace(b"rgb/", b"rgb" + separator.encode()).replace(
        b"metadata/", b"metadata" + separator.encode()
    )
    source, images = frames_of(write(tmp_path / "a.zip", content))
    assert source.frames == frames_of(root)[0].frames
    np.testing.assert_array_equal(decode_image(images[1][4]), pixels(1, 4))


UNRELATED = {
    "a link": member("latest", b"", type=b"2", linkname="rgb"),
    "a hard link": member("doc/x", b"", type=b"1", linkname="doc/y"),
    "a device": member("dev/null", b"", type=b"3"),
    "a pipe": member("queue", b"", type=b"6"),
    "a label": member("my backup", b"", type=b"V"),
    "a list of a folder": member("rgb", b"", type=b"D"),
    "a name not UTF-8": member("notes/\udcff.txt"),
    "a file twice": member("a.txt") + member("a.txt"),
    "a link among images": member("rgb/Front/latest", b"", type=b"2", linkname="000001.png"),
}


@pytest.mark.parametrize("name", UNRELATED)
def test_entries_that_are_not_needed_cost_nothing(tmp_path, name):
    whole = pack(write_layout(tmp_path / "a", 2), tmp_path / "a.tar").read_bytes()
    source, _ = frames_of(write(tmp_path / "b.tar", UNRELATED[name] + whole))
    assert source.frames == frames_of(tmp_path / "a.tar")[0].frames


def test_a_sparse_file_costs_nothing_where_it_is_not_needed(tmp_path):
    whole = pack(write_layout(tmp_path / "a", 1), tmp_path / "a.tar").read_bytes()
    sparse = bytearray(member("disk.img", bytes(512), type=b"S"))
    sparse[386:410] = b"%011o\0%011o\0" % (0, 512)  # one piece of data: offset and length
    sparse[483:495] = b"%011o\0" % 512  # size once unpacked
    sparse[148:156] = b" " * 8
    sparse[148:156] = b"%06o\0 " % sum(sparse[:512])
    assert len(frames_of(write(tmp_path / "b.tar", bytes(sparse) + whole))[0].frames) == 1


@pytest.mark.parametrize("name", ["rgb", "rgb/Down", "metadata", "rgb/Down/000000.png", "metadata/000000.json"])
@pytest.mark.parametrize("kind", [b"1", b"2"])
def test_a_link_that_is_needed_is_refused(tmp_path, name, kind):
    whole = pack(write_layout(tmp_path / "a", 1), tmp_path / "a.tar").read_bytes()
    path = write(tmp_path / "b.tar", member(name, b"", type=kind, linkname="elsewhere") + whole)
    with pytest.raises(InputError, match=f"member {name} is a link"):
        open_source(path)


def test_zstd_needs_its_extra(tmp_path, monkeypatch):
    whole = pack(write_layout(tmp_path / "a", 1), tmp_path / "a.tar").read_bytes()
    path = write(tmp_path / "a.tar.zst", zstd.compress(whole))

    def absent(name):
        raise ImportError(name)

    monkeypatch.setattr("importlib.import_module", absent)
    with pytest.raises(InputError, match=r"pip install \"ovibjax\[zstd\]\""):
        open_source(path)


def test_no_room_to_unpack_is_said(tmp_path, monkeypatch):
    whole = pack(write_layout(tmp_path / "a", 1), tmp_path / "a.tar").read_bytes()

    class Full(io.BytesIO):
        def write(self, _):
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(tempfile, "TemporaryFile", Full)
    with pytest.raises(InputError, match=r"no room to unpack it .*No space left.*TMPDIR"):
        open_source(write(tmp_path / "a.tar.xz", lzma.compress(whole)))

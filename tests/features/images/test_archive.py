"""Archives: names as other programs write them, and bytes of a gzip file from any place in it."""

import gzip
import tarfile

import numpy as np
import pytest

from ovibjax.features.images.decoding import decode_image
from ovibjax.features.images.gzip_access import GzipReader
from tests.features.images.made_images import (
    frames_of,
    pixels,
    write,
    write_layout,
)


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

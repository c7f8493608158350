"""Tables of poses: rows in their order, patterns for the images, and rows that are left out."""

import math

import numpy as np
import pytest

from ovibjax.features.images.decoding import decode_image
from ovibjax.views import VIEWS
from tests.features.images.made_images import (
    encode,
    frames_of,
    pixels,
    write,
    write_table,
)

PATTERN = "images/{view}/{frame}.png"


def test_a_table_gives_its_rows_in_order(tmp_path):
    path = write_table(tmp_path)
    header, *rows = path.read_text().splitlines()
    lines = [header + ",note,scene,context", rows[2] + ",hello,B,corridor", rows[0] + ',"a,b",A,', "", rows[1] + ",,A,"]
    path.write_bytes(b"\xef\xbb\xbf" + "\r\n".join(lines).encode())
    source, images = frames_of(path, images=PATTERN)
    assert [frame.frame_id for frame in source.frames] == ["2", "0", "1"]
    assert [frame.scene for frame in source.frames] == ["B", "A", "A"]
    assert [frame.context for frame in source.frames] == [0, -1, -1]
    assert source.frames[0].position_m == (6, 4, 30) and source.frames[0].yaw_rad == pytest.approx(math.pi / 6)
    np.testing.assert_array_equal(decode_image(images[0][3]), pixels(2, 3))


def test_patterns_fill_in_view_frame_and_scene(tmp_path):
    for view in VIEWS[:4]:
        write(tmp_path / f"A/cam_{view.lower()}_0007.jpeg", encode(pixels(1), "jpeg"))
    table = write(tmp_path / "t.csv", b"frame,x_m,y_m,z_m,yaw_deg,scene\n7,1,2,3,4,A\n8,1,2,3,4,A\n9,,2,3,4,A\n")
    source, _ = frames_of(table, images="{scene}/cam_{view:lower}_{frame:04d}.jpeg")
    assert source.frames[0].images[1] == "A/cam_back_0007.jpeg" and len(source.frames) == 1
    assert [one.reason for one in source.skipped] == ["a view is missing", "a view is missing"]


def test_rows_without_a_pose_are_skipped(tmp_path):
    path = write_table(tmp_path, 4)
    path.write_text(path.read_text().replace("\n1,3,", "\n1,,").replace("\n2,6,", "\n2,nan,"))
    source, _ = frames_of(path, images=PATTERN)
    assert [frame.frame_id for frame in source.frames] == ["0", "3"]
    assert [one.detail for one in source.skipped] == ["line 3: x_m is empty", "line 4: x_m is empty"]

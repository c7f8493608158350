"""Tables of poses: rows in their order, patterns for the images, and rows that are left out."""

import math

import numpy as np
import pytest

from ovibjax.errors import Doubt, InputError
from ovibjax.features.images.decoding import decode_image
from ovibjax.features.images.pose_table import PoseOptions
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


def table_of(tmp_path, text, **options):
    """Frames of a table, and what was understood of it."""
    path = write_table(tmp_path, 2)
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    source, _ = frames_of(path, images=PATTERN, **options)
    return source


DRAWN = {
    "bars": "frame|x_m|y_m|z_m|yaw_deg\n0|20,00|2|3|90\n1|21,5|2|3|90",
    "markdown": "| frame | x_m | y_m | z_m | yaw_deg |\n|---|:--:|---:|---|---|\n| 0 | 20.0 | 2 | 3 | 90 |\n"
    "| 1 | 21.5 | 2 | 3 | 90 |",
    "database": " frame | x_m | y_m | z_m | yaw_deg\n-------+-----+---+---+----\n 0 | 20 | 2 | 3 | 90\n"
    " 1 | 21.5 | 2 | 3 | 90",
    "quoted": 'frame,x_m,y_m,z_m,yaw_deg\n0,"20,00","2,0",3,90\n1,"21,5",2,3,90',
    "all quoted": '"frame","x_m","y_m","z_m","yaw_deg"\n"0","20,00","2,0","3,0","90,0"\n"1","21,5","2,0","3,0","90,0"',
}


@pytest.mark.parametrize("name", DRAWN)
def test_tables_drawn_with_bars_and_quoted_decimal_commas(tmp_path, name):
    source = table_of(tmp_path, DRAWN[name])
    assert [frame.position_m for frame in source.frames] == [(20.0, 2.0, 3.0), (21.5, 2.0, 3.0)]
    assert [frame.yaw_rad for frame in source.frames] == pytest.approx([math.pi / 2] * 2)


def test_quoted_thousands_are_refused(tmp_path):
    with pytest.raises(InputError, match="may be thousands"):
        table_of(tmp_path, 'frame,x_m,y_m,z_m,yaw_deg\n0,"1,200",2,3,90')


LATIN = "frame,x_m,y_m,z_m,yaw_deg{head}\n# H\xf6he {comment}\n0,1,2,3,90{one}\n1,2,2,3,90{one}"


@pytest.mark.parametrize(
    "parts", [{"comment": "\xfc"}, {"head": ",H\xf6he", "one": ",1"}, {"head": ",n", "one": ",\xe9"}]
)
def test_letters_that_are_not_utf8_matter_only_where_they_are_read(tmp_path, parts):
    text = LATIN.format(**{"head": "", "comment": "", "one": ""} | parts).encode("latin-1")
    source = table_of(tmp_path, text)
    assert len(source.frames) == 2
    source.form.encode()
    with pytest.raises(InputError, match="line 3: frame is not UTF-8") as caught:
        table_of(tmp_path, text.replace(b"\n0,", b"\n\xe9,"))
    str(caught.value).encode()


TWICE = "frame,x_m,y_m,z_m,yaw_deg,yaw_rad,qw,qx,qy,qz\n0,1,2,3,90,{rad},{q}\n1,2,2,3,90,1.5708,0.7071,0,0,0.7071"
SAME = {"rad": "1.5708", "q": "0.7071,0,0,0.7071"}


def test_two_headings_that_agree_raise_no_doubt(tmp_path):
    assert len(table_of(tmp_path, TWICE.format(**SAME)).frames) == 2
    assert len(table_of(tmp_path, TWICE.format(rad="NA", q=",,,")).frames) == 2


@pytest.mark.parametrize(("other", "name"), [({"rad": "0.5236"}, "yaw_rad"), ({"q": "1,0,0,0"}, "qw,qx,qy,qz")])
def test_two_headings_that_disagree_are_named(tmp_path, other, name):
    text = TWICE.format(**SAME | other)
    with pytest.warns(Doubt, match=rf"yaw_deg is used, {name} disagrees by up to [69]0 degrees \(line 2\)"):
        source = table_of(tmp_path, text)
    assert source.frames[0].yaw_rad == pytest.approx(math.pi / 2)
    for column in ("yaw_deg=yaw_deg", "yaw_rad=yaw_rad", "qw=qw"):
        assert table_of(tmp_path, text, poses=PoseOptions(columns=(column,))).frames

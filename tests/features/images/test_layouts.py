"""Layouts as people have them: cameras of other names, files named in tables, patterns that lead elsewhere, hints."""

import unicodedata

import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.features.images.by_path import open_source
from ovibjax.features.images.decoding import decode_image
from ovibjax.features.images.pose_table import PoseOptions
from ovibjax.views import VIEWS
from tests.features.images.made_images import encode, frames_of, pack, pixels, write, write_layout, write_table

OTHER_NAMES = {"Front": "cam0", "Back": "rear", "Left": "LEFT", "Right": "right", "Down": "bottom"}
CAMERAS = ("Front=cam0", "Back=rear", "Down=bottom")


@pytest.mark.parametrize("kind", ["png", "jpg", "webp", "bmp"])
def test_images_of_every_kind_in_the_layout_of_folders(tmp_path, kind):
    source, images = frames_of(write_layout(tmp_path / "a", 2, kind=kind))
    assert source.frames[1].images[4] == f"rgb/Down/000001.{kind}" and len(images) == 2
    if kind in ("png", "bmp"):
        np.testing.assert_array_equal(decode_image(images[1][4]), pixels(1, 4))


@pytest.mark.parametrize("packed", [False, True])
def test_cameras_of_other_names(tmp_path, packed):
    root = write_layout(tmp_path / "a", 2)
    for view, name in OTHER_NAMES.items():
        (root / "rgb" / view).rename(root / "rgb" / f"{name}_")
        (root / "rgb" / f"{name}_").rename(root / "rgb" / name)
    path = pack(root, tmp_path / "a.tar") if packed else root
    source, images = frames_of(path, cameras=CAMERAS)
    assert source.frames[0].images == tuple(f"rgb/{OTHER_NAMES[view]}/000000.png" for view in VIEWS)
    for view, content in enumerate(images[1]):
        np.testing.assert_array_equal(decode_image(content), pixels(1, view))
    with pytest.raises(InputError, match=r"no images of Front, Back; .* rgb/ has LEFT.*--cameras Front=NAME"):
        open_source(path)


@pytest.mark.parametrize(
    "cameras", [("front=a",), ("Front",), ("Front=",), ("Front=../a",), ("Front=a", "Front=b"), ("Front=a", "Back=a")]
)
def test_cameras_that_cannot_be(tmp_path, cameras):
    with pytest.raises(InputError, match="--cameras"):
        open_source(write_layout(tmp_path / "a", 1), cameras=cameras)


def test_cameras_in_a_pattern(tmp_path):
    path = write_table(tmp_path, 2)
    for view, name in OTHER_NAMES.items():
        (tmp_path / "images" / view).rename(tmp_path / "images" / f"x{name}")
    cameras = [f"{view}=x{name}" for view, name in OTHER_NAMES.items()]
    source, _ = frames_of(path, images="images/{view}/{frame}.png", cameras=cameras)
    assert len(source.frames) == 2 and source.frames[0].images[0] == "images/xcam0/0.png"
    upper = write(tmp_path / "t.csv", path.read_bytes())
    for view in VIEWS[:4]:
        write(tmp_path / f"{view.upper()}_0.png", encode(pixels(0)))
    assert frames_of(upper, images="{view:upper}_{frame}.png")[0].frames[0].images[1] == "BACK_0.png"


@pytest.mark.parametrize("where", ["../elsewhere", "absolute", "./x/../../elsewhere"])
def test_a_pattern_may_lead_where_its_author_says(tmp_path, where):
    table = write(tmp_path / "tables/my.csv", write_table(tmp_path / "elsewhere", 2).read_bytes())
    (tmp_path / "tables/x").mkdir()
    folder = str(tmp_path / "elsewhere") if where == "absolute" else where
    source, images = frames_of(table, images=folder + "/images/{view}/{frame}.png")
    assert len(source.frames) == 2
    np.testing.assert_array_equal(decode_image(images[1][2]), pixels(1, 2))


@pytest.mark.parametrize("name", ["../0", "/etc/passwd", "a/../../0", "C:\\x"])
@pytest.mark.parametrize("column", ["frame", "Left"])
def test_a_table_may_not(tmp_path, name, column):
    write_table(tmp_path, 1)
    row = {"frame": "0", "Left": "images/Left/0.png"} | {column: name}
    text = f"frame,x_m,y_m,z_m,yaw_deg,Front,Back,Left,Right\n{row['frame']},1,2,3,4,a,b,{row['Left']},d\n"
    table = write(tmp_path / "t.csv", text.encode())
    images = "images/{view}/{frame}.png" if column == "frame" else None
    with pytest.raises(InputError, match=r"line 2: .* leads out of the table's folder"):
        open_source(table, images)


def with_files(tmp_path, names):
    path = write_table(tmp_path, 3)
    header, *rows = path.read_text().splitlines()
    files = [",".join(f"{view}/{row[0]}.png" for view in VIEWS) for row in rows]
    lines = [f"{header},{','.join(names)}", *(f"{row},{more}" for row, more in zip(rows, files, strict=True))]
    return write(path, "\n".join(lines).encode())


def test_a_column_of_files_per_view(tmp_path):
    source, images = frames_of(with_files(tmp_path, VIEWS), images="images/{file}")
    assert [frame.images[3] for frame in source.frames] == [f"images/Right/{row}.png" for row in range(3)]
    np.testing.assert_array_equal(decode_image(images[2][1]), pixels(2, 1))
    named = with_files(tmp_path, [f"{view}_file" for view in VIEWS])
    columns = tuple(f"{view}={view}_file" for view in VIEWS)
    assert frames_of(named, images="images/{file}", poses=PoseOptions(columns=columns))[0].frames == source.frames
    with pytest.raises(InputError, match=r"needs a column of files for each view .*--columns Front=NAME"):
        open_source(named, "images/{file}")
    with pytest.raises(InputError, match=r"say where its images lie.*--columns Front=NAME"):
        open_source(named)
    (tmp_path / "images/Front").rename(tmp_path / "Front")
    for view in VIEWS[1:]:
        (tmp_path / "images" / view).rename(tmp_path / view)
    assert len(frames_of(with_files(tmp_path, VIEWS))[0].frames) == 3


@pytest.mark.parametrize(
    ("there", "pattern", "words"),
    [
        ("images/{view}/{frame}.JPG", "images/{view}/{frame}.jpg", "there is 7.JPG"),
        ("images/{view}/{frame}.png", "images/{view}/{frame}.jpg", "there is 7.png"),
        ("images/{view}/00000{frame}.jpg", "images/{view}/{frame}.jpg", r"write \{frame:06d\}"),
        ("images/{view}/{frame}.jpg", "images/{view}/{frame:06d}.jpg", r"there is 7.jpg: write \{frame:01d\}"),
        ("images/x{view}/{frame}.jpg", "images/{view}/{frame}.jpg", "images has xBack, xDown.*--cameras"),
        ("pictures/{view}/{frame}.jpg", "images/{view}/{frame}.jpg", "there is no folder .*has pictures"),
    ],
)
def test_hints_at_what_may_be_meant(tmp_path, there, pattern, words):
    table = write(tmp_path / "t.csv", b"frame,x_m,y_m,z_m,yaw_deg\n7,1,2,3,4\n")
    for view in VIEWS:
        write(tmp_path / there.format(view=view, frame=7), encode(pixels(0)))
    with pytest.raises(InputError, match=words):
        open_source(table, pattern)


def test_a_hint_at_accents(tmp_path):
    composed = "café"
    apart = unicodedata.normalize("NFD", composed)
    table = write(tmp_path / "t.csv", f"frame,x_m,y_m,z_m,yaw_deg\n{composed},1,2,3,4\n".encode())
    for view in VIEWS:
        write(tmp_path / f"{view}/{apart}.jpg", encode(pixels(0)))
    if (tmp_path / f"Front/{composed}.jpg").exists():
        pytest.skip("this file system makes no difference")
    with pytest.raises(InputError, match="NFC, NFD"):
        open_source(table, "{view}/{frame}.jpg")


def test_the_photos_that_a_recording_names(tmp_path):
    head = "TimeStamp\tPOS_X\tPOS_Y\tPOS_Z\tQ_W\tQ_X\tQ_Y\tQ_Z\tImageFile\n"
    rows = []
    for frame in (17, 18):
        files = [f"img__{camera}_0_{frame}9.png" for camera in range(4)]
        for file in files:
            write(tmp_path / "images" / file, encode(pixels(1)))
        rows.append(f"{frame}\t{frame}\t2\t3\t1\t0\t0\t0\t{';'.join(files)}\n")
    path = write(tmp_path / "airsim_rec.txt", (head + "".join(rows)).encode())
    cameras = ("Front=0", "Back=1", "Left=2", "Right=3")
    source, _ = frames_of(path, images="images/{file}", cameras=cameras)
    assert [frame.images[3] for frame in source.frames] == ["images/img__3_0_179.png", "images/img__3_0_189.png"]

"""Sources of frames: folders, archives and tables give the same frames; incomplete ones are counted."""

import gzip
import io
import json
import math
import tarfile

import numpy as np
import pytest
from PIL import Image

from ovibjax.errors import InputError
from ovibjax.features.images.by_path import open_source
from ovibjax.features.images.decoding import decode_image
from ovibjax.features.images.extraction import extract
from ovibjax.features.images.gzip_access import GzipReader
from ovibjax.views import VIEWS
from ovibjax.world.town import files as town_files
from ovibjax.world.town.layout import TownConfig, make_town
from ovibjax.world.town.render import Views
from ovibjax.world.town.route import context_labels, make_route
from tests.features.images.made_images import (
    about,
    encode,
    pack,
    pixels,
    tiny_backbone,
    write,
    write_layout,
    write_table,
)

CONFIG, N_FRAMES, SEED = TownConfig(), 5, 1
PATTERN = "images/{view}/{frame}.png"


def painted(town, route, frames):
    """Stands in for the renderer, whose compilation would take longer than all tests here."""
    rng = np.random.default_rng(0)
    for frame in frames.tolist():
        rgb = rng.uniform(size=(5, 24, 32, 3)).astype(np.float32)
        yield frame, Views(rgb=rgb, depth_m=50 * rgb[..., 0], semantic=np.zeros(rgb.shape[:3], np.int32))


@pytest.fixture(scope="module")
def town(tmp_path_factory):
    """Frames of the embedded town, written by what `ovibjax town` writes with."""
    root = tmp_path_factory.mktemp("town") / "town"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(town_files, "render_frames", painted)
        town_files.write_frames(CONFIG, root, N_FRAMES, SEED)
    return root


def frames_of(path, **options):
    source = open_source(path, **options)
    images = [[source.read(image) for image in frame.images] for frame in source.frames]
    source.close()
    return source, images


# --- what ovibjax town writes ------------------------------------------------------------------------------


def test_poses_and_contexts_of_the_embedded_town_come_back(town):
    source, images = frames_of(town)
    route = make_route(make_town(CONFIG), CONFIG, N_FRAMES, SEED)
    assert [frame.frame_id for frame in source.frames] == [f"{i:06d}" for i in range(N_FRAMES)]
    assert source.skipped == () and source.axes == "right-handed"
    for row, frame in enumerate(source.frames):
        assert list(frame.position_m) == route.positions_m[row].tolist()
        assert frame.yaw_rad == pytest.approx(float(route.yaw_rad[row]), abs=1e-6)
        assert frame.scene == f"ovibjax-town-{CONFIG.seed}"
        assert frame.images == tuple(f"rgb/{view}/{frame.frame_id}.png" for view in VIEWS)
        for view, content in enumerate(images[row]):
            assert content == (town / frame.images[view]).read_bytes()
            assert len(content) == frame.sizes_bytes[view]
    assert [frame.context for frame in source.frames] == context_labels(make_town(CONFIG), route.positions_m).tolist()


@pytest.mark.parametrize("kind", ["plain", "gzip", "one folder above", "as a folder above"])
def test_an_archive_gives_the_same_file_as_the_folder(town, tmp_path, kind):
    path = {"gzip": tmp_path / "town.tar.gz", "as a folder above": town.parent}.get(kind, tmp_path / "town.tar")
    if kind != "as a folder above":
        pack(town if kind != "one folder above" else town.parent, path, "w:gz" if kind == "gzip" else "w")
    sets = {}
    for name, where in (("folder", town), ("other", path)):
        source = open_source(where)
        sets[name] = extract(source, tiny_backbone(), tmp_path / f"{name}.npz", batch=2).features
        source.close()
    assert (tmp_path / "folder.npz").read_bytes() == (tmp_path / "other.npz").read_bytes()
    assert sets["folder"].features.shape == (N_FRAMES, 5, 6)
    assert (sets["folder"].context >= 0).any()


# --- the released data set ---------------------------------------------------------------------------------


def test_carla_names_axes_and_other_forms(tmp_path):
    write_layout(tmp_path / "a", map_name="Carla/Maps/Town05", kind="jpg")
    state = {"position": [1, 2, 3], "rotation": [0, -90, 0]}
    write(tmp_path / "a/metadata/000001.json", json.dumps(about(1, uav_state=state, context="corridor")).encode())
    for other in ("depth/Front/000000.npy", "semantic/Front/000000.png", "rgb/Front/._000000.png", "notes.txt"):
        write(tmp_path / "a" / other, b"not read")
    source, _ = frames_of(tmp_path / "a")
    assert source.axes == "left-handed (CARLA)"
    first, second, third = source.frames
    # Nothing is mirrored: the heading is (cos, sin) of yaw in the axes of the data.
    assert first.position_m == (0, 0, 30) and third.position_m == (6, -5, 30)
    assert third.yaw_rad == pytest.approx(math.pi / 6)
    assert second.position_m == (1, 2, 3) and second.yaw_rad == pytest.approx(-math.pi / 2)
    assert [frame.context for frame in source.frames] == [-1, 0, -1]
    assert {frame.scene for frame in source.frames} == {"Town05"}


def test_towns_side_by_side_are_scenes(tmp_path):
    for name, n in (("T2", 2), ("T1", 3)):
        write_layout(tmp_path / "all" / name, n, map_name=None if name == "T1" else "Town02")
    source, _ = frames_of(tmp_path / "all")
    assert [frame.frame_id for frame in source.frames] == [f"T1/00000{i}" for i in range(3)] + [
        "T2/000000",
        "T2/000001",
    ]
    assert [frame.scene for frame in source.frames] == ["T1"] * 3 + ["Town02"] * 2
    made = extract(source, tiny_backbone(), tmp_path / "x.npz").features
    assert made.scene_id.tolist() == [0, 0, 0, 1, 1]
    packed, _ = frames_of(pack(tmp_path / "all", tmp_path / "all.tar"))
    assert packed.frames == source.frames


def test_four_views_are_a_ugv(tmp_path):
    write_layout(tmp_path / "ugv", views=VIEWS[:4])
    assert [len(frame.images) for frame in frames_of(tmp_path / "ugv")[0].frames] == [4] * 3
    write_layout(tmp_path / "uav")
    assert len(frames_of(tmp_path / "uav", n_views=4)[0].frames[0].images) == 4
    with pytest.raises(InputError, match="no images of Down"):
        open_source(tmp_path / "ugv", n_views=5)


def test_frames_are_in_numeric_order(tmp_path):
    write_layout(tmp_path / "a", 1)
    for name in ("9", "10", "100"):
        for view in VIEWS:
            write(tmp_path / f"a/rgb/{view}/{name}.png", encode(pixels(1)))
        write(tmp_path / f"a/metadata/{name}.json", json.dumps(about(1)).encode())
    assert [frame.frame_id for frame in frames_of(tmp_path / "a")[0].frames] == ["000000", "9", "10", "100"]


def test_incomplete_frames_are_counted_with_their_reasons(tmp_path):
    root = write_layout(tmp_path / "a", 6)
    (root / "rgb/Left/000001.png").unlink()
    (root / "metadata/000002.json").unlink()
    nan = {"position": {"x": math.nan, "y": 0, "z": 0}, "rotation": {"pitch": 0, "yaw": 0, "roll": 0}}
    write(root / "metadata/000003.json", json.dumps(about(3, uav_state=nan)).encode())
    write(root / "metadata/000009.json", json.dumps(about(9)).encode())
    for path in (root, pack(root, tmp_path / "a.tar")):
        source, _ = frames_of(path)
        assert [frame.frame_id for frame in source.frames] == ["000000", "000004", "000005"]
        assert [(one.frame_id, one.reason) for one in source.skipped] == [
            ("000001", "a view is missing"),
            ("000002", "no usable pose"),
            ("000003", "no usable pose"),
            ("000009", "a view is missing"),
        ]
        assert source.skipped[0].detail == "Left" and "not finite" in source.skipped[2].detail
        with pytest.raises(InputError, match="4 frames incomplete: 2 a view is missing"):
            extract(source, tiny_backbone(), tmp_path / "x.npz", strict=True)
    assert not (tmp_path / "x.npz").exists() and not (tmp_path / "x.npz.partial").exists()


# --- tables ------------------------------------------------------------------------------------------------


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
    assert [one.detail for one in source.skipped] == [f"line {line}: x_m is empty or not finite" for line in (3, 4)]


# --- archives ----------------------------------------------------------------------------------------------


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


# --- images ------------------------------------------------------------------------------------------------


def test_every_common_mode_becomes_rgb():
    rgb = pixels(1)
    grey = rgb[..., 0]
    wide = (grey.astype(np.uint16) << 8) + 200
    alpha = np.dstack([rgb, grey])
    palette = io.BytesIO()
    Image.fromarray(rgb).quantize(16).save(palette, "png", transparency=bytes(range(16)))
    cases = {
        encode(rgb): rgb,
        encode(alpha): rgb,
        encode(grey): np.repeat(grey[..., None], 3, 2),
        encode(wide): np.repeat(grey[..., None], 3, 2),
        encode(rgb, "webp", lossless=True): rgb,
        encode(rgb, "bmp"): rgb,
    }
    for content, expected in cases.items():
        np.testing.assert_array_equal(decode_image(content), expected)
    for content in (palette.getvalue(), encode(np.dstack([rgb, grey]), "webp"), encode(rgb, "jpeg")):
        assert decode_image(content).shape == rgb.shape
    cmyk = io.BytesIO()
    Image.fromarray(rgb).convert("CMYK").save(cmyk, "jpeg")
    assert decode_image(cmyk.getvalue()).shape == rgb.shape


def test_orientation_marks_are_applied():
    exif = Image.Exif()
    exif[0x0112] = 6
    upright = decode_image(encode(pixels(1), "png", exif=exif))
    np.testing.assert_array_equal(upright, np.rot90(pixels(1), -1))

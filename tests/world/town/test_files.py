"""Frames on disk and the picture of the town; the images are smaller than the released ones, for speed."""

import json
from dataclasses import asdict, replace
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image

from ovibjax.errors import InputError
from ovibjax.features.frames import CONTEXTS
from ovibjax.views import VIEWS
from ovibjax.world.town import files as town_files
from ovibjax.world.town import picture
from ovibjax.world.town import render as renderer
from ovibjax.world.town.files import write_frames
from ovibjax.world.town.layout import TownConfig, make_town
from ovibjax.world.town.picture import contact_sheet
from ovibjax.world.town.render import FRAME_CAMERA, render
from ovibjax.world.town.route import context_labels, make_route
from ovibjax.world.town.shading import SEMANTIC_CLASSES

CONFIG = TownConfig()
N_FRAMES, SEED = 3, 1
NAMES = [f"{frame:06d}" for frame in range(N_FRAMES)]
CAMERA = replace(FRAME_CAMERA, height_px=48, width_px=64)
SHAPE = (CAMERA.height_px, CAMERA.width_px)


@pytest.fixture(scope="module", autouse=True)
def small_images():
    with pytest.MonkeyPatch.context() as patch:
        for module in (town_files, renderer):
            patch.setattr(module, "FRAME_CAMERA", CAMERA)
        yield


def read(path):
    with Image.open(path) as image:
        assert image.format == "PNG"
        image.load()
        return np.asarray(image)


def stamps(folder):
    """Every file with the time of its last change."""
    return {str(file.relative_to(folder)): file.stat().st_mtime_ns for file in folder.rglob("*") if file.is_file()}


def refuse_to_render(*_):
    raise AssertionError("rendered again")


def assert_refused(error, *words):
    message = str(error.value)
    assert len(message.splitlines()) == 1, message
    for word in words:
        assert str(word) in message, (word, message)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A folder of three frames, and the calls of `on_frame`."""
    out, calls = tmp_path_factory.mktemp("frames") / "deep" / "town", []
    assert write_frames(CONFIG, out, N_FRAMES, SEED, on_frame=lambda *call: calls.append(call)) == N_FRAMES
    return out, calls


@pytest.fixture
def copy(written, tmp_path):
    """The three frames in a folder of this test alone."""
    for file in written[0].rglob("*"):
        if file.is_file():
            target = tmp_path / "copy" / file.relative_to(written[0])
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(file.read_bytes())
    return tmp_path / "copy"


@pytest.fixture(scope="module")
def drive():
    town = make_town(CONFIG)
    return town, make_route(town, CONFIG, N_FRAMES, SEED)


def test_images_have_the_released_size():
    assert (FRAME_CAMERA.width_px, FRAME_CAMERA.height_px) == (400, 300)


def test_the_folder_holds_the_released_layout_and_nothing_else(written):
    out, calls = written
    images = {f"{kind}/{view}/{name}.png" for kind in ("rgb", "depth", "semantic") for view in VIEWS for name in NAMES}
    about = {f"metadata/{name}.json" for name in NAMES} | {"calibration/camera_calibration.json"}
    assert set(stamps(out)) == images | about
    assert calls == [(1, 3), (2, 3), (3, 3)]


def test_images_are_what_the_renderer_gives(written, drive):
    out, _ = written
    town, route = drive
    for frame, name in enumerate(NAMES):
        batch = [0, 1] if frame < 2 else [2, 2]
        views = render(town, route.positions_m[batch], route.yaw_rad[batch], CAMERA)
        for m, view in enumerate(VIEWS):
            rgb, depth, semantic = (read(out / kind / view / f"{name}.png") for kind in ("rgb", "depth", "semantic"))
            assert rgb.shape == (*SHAPE, 3) and rgb.dtype == np.uint8
            assert depth.shape == SHAPE and depth.dtype == np.uint16
            assert semantic.shape == SHAPE and semantic.dtype == np.uint8
            row = batch.index(frame)
            np.testing.assert_allclose(rgb / 255, views.rgb[row, m], atol=0.51 / 255)
            np.testing.assert_array_equal(semantic, views.semantic[row, m])
            depth_m = np.asarray(views.depth_m[row, m], np.float64)
            far = depth_m >= 655.345
            assert (depth[far] == 65535).all() and (depth[semantic == SEMANTIC_CLASSES.index("sky")] == 65535).all()
            np.testing.assert_allclose(depth[~far] / 100, depth_m[~far], atol=0.00501)


def test_metadata_give_pose_time_and_context(written, drive):
    out, _ = written
    town, route = drive
    codes = context_labels(town, route.positions_m)
    for frame, name in enumerate(NAMES):
        about = json.loads((out / "metadata" / f"{name}.json").read_text())
        assert set(about) == {"frame", "timestamp", "map_name", "context", "uav_state"}
        assert (about["frame"], about["timestamp"]) == (name, 0.5 * frame)
        assert about["map_name"] == f"ovibjax-town-{CONFIG.seed}"
        assert about["context"] == CONTEXTS[codes[frame]]
        position, rotation = about["uav_state"]["position"], about["uav_state"]["rotation"]
        assert [position[axis] for axis in "xyz"] == route.positions_m[frame].tolist()
        assert (rotation["pitch"], rotation["roll"]) == (0, 0)
        assert np.deg2rad(rotation["yaw"]) == pytest.approx(float(route.yaw_rad[frame]), abs=1e-6)


def test_calibration_projects_points_to_where_they_are_seen(written, drive):
    """Depth and calibration together give the ground below the camera back: z = 0 at every pixel of a road."""
    out, _ = written
    calibration = json.loads((out / "calibration" / "camera_calibration.json").read_text())
    assert calibration["semantic_classes"] == list(SEMANTIC_CLASSES)
    assert calibration["drive"] == {"town": asdict(CONFIG), "seed": SEED, "n_frames": N_FRAMES, "period_s": 0.5}
    assert "right-handed" in calibration["coordinates"] and "centimetres" in calibration["depth"]
    assert list(calibration["cameras"]) == list(VIEWS)
    height_m = float(drive[1].positions_m[0, 2])
    for view, camera in calibration["cameras"].items():
        assert (camera["height"], camera["width"], camera["fov_deg"]) == (*SHAPE, 90)
        (fx, _, cx), (_, fy, cy), last = camera["intrinsic"]
        assert fx == fy == pytest.approx(camera["width"] / 2 / np.tan(np.deg2rad(camera["fov_deg"] / 2)))
        assert (cx, cy, last) == (SHAPE[1] / 2, SHAPE[0] / 2, [0, 0, 1])
        depth_m = read(out / "depth" / view / f"{NAMES[0]}.png") / 100
        is_road = read(out / "semantic" / view / f"{NAMES[0]}.png") == SEMANTIC_CLASSES.index("road")
        is_road &= depth_m < 655.35
        up = (cy - np.arange(SHAPE[0])[:, None] - 0.5) / fy
        pitch = np.deg2rad(camera["extrinsic"]["pitch_deg"])
        z = height_m + depth_m * (np.sin(pitch) + up * np.cos(pitch))
        assert is_road.any() and np.abs(z[is_road]).max() < 0.02


def test_a_finished_folder_is_left_alone(copy, monkeypatch):
    before = stamps(copy)
    monkeypatch.setattr(renderer, "render", refuse_to_render)
    assert write_frames(CONFIG, copy, N_FRAMES, SEED) == 0
    assert stamps(copy) == before


@pytest.mark.parametrize("lost", ["metadata/000001.json", "depth/Left/000001.png"])
def test_an_unfinished_frame_is_written_again_and_only_that(copy, written, lost):
    before = stamps(copy)
    (copy / lost).unlink()
    calls = []
    assert write_frames(CONFIG, copy, N_FRAMES, SEED, on_frame=lambda *call: calls.append(call)) == 1
    assert calls == [(3, 3)]
    after = stamps(copy)
    assert {name for name in after if after[name] == before[name]} == {name for name in before if "000001" not in name}
    for name in before:
        assert (copy / name).read_bytes() == (written[0] / name).read_bytes(), name


def test_an_interrupted_run_goes_on(written, tmp_path):
    def interrupt(done, _):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_frames(CONFIG, tmp_path, N_FRAMES, SEED, on_frame=interrupt)
    assert not (tmp_path / "metadata" / "000002.json").exists()
    assert write_frames(CONFIG, tmp_path, N_FRAMES, SEED) == 1
    for name in stamps(written[0]):
        assert (tmp_path / name).read_bytes() == (written[0] / name).read_bytes(), name


def test_metadata_come_last(tmp_path, monkeypatch):
    order = []
    write = town_files.write_whole
    monkeypatch.setattr(town_files, "write_whole", lambda path, content: (order.append(path), write(path, content)))
    write_frames(CONFIG, tmp_path, 1, SEED)
    assert order[0].name == "camera_calibration.json" and order[-1].parent.name == "metadata"
    assert len(order) == 17 and all(a != b for a, b in pairwise(order))


def test_a_killed_write_leaves_no_file_under_its_name(tmp_path, monkeypatch):
    monkeypatch.setattr(town_files.Path, "replace", refuse_to_render)
    with pytest.raises(AssertionError):
        town_files.write_whole(tmp_path / "frame.png", b"content")
    assert not (tmp_path / "frame.png").exists()


@pytest.mark.parametrize(
    ("config", "n_frames", "seed"),
    [(TownConfig(seed=6), N_FRAMES, SEED), (CONFIG, N_FRAMES, SEED + 1), (CONFIG, N_FRAMES + 1, SEED)],
)
def test_frames_of_another_drive_are_never_mixed_in(copy, config, n_frames, seed):
    before = stamps(copy)
    with pytest.raises(InputError) as error:
        write_frames(config, copy, n_frames, seed)
    assert_refused(error, copy, "another drive")
    assert stamps(copy) == before


def test_what_cannot_be_written_is_refused_by_name(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    for out in (blocked, blocked / "below"):
        with pytest.raises(InputError) as error:
            write_frames(CONFIG, out, 1, 0)
        assert_refused(error, out, "cannot be written")
    for n_frames, seed in ((0, 0), (1, -1)):
        with pytest.raises(InputError) as error:
            write_frames(CONFIG, tmp_path / "out", n_frames, seed)
        assert_refused(error, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_contact_sheet_is_a_picture(tmp_path, monkeypatch):
    monkeypatch.setattr(picture, "_CANDIDATES", 1)
    path = tmp_path / "town.png"
    contact_sheet(CONFIG, path)
    pixels = read(path)
    height, width, _ = pixels.shape
    assert 1600 <= width <= 2000 and 400 <= height <= 800
    assert [file.name for file in tmp_path.iterdir()] == ["town.png"]
    # White margins; plan, views and letters within them.
    assert (pixels[:5, :, :3] == 255).all() and (pixels[-5:, :, :3] == 255).all()
    for part in np.array_split(pixels[60:-20, 20:-20, :3], 6, axis=1):
        assert part.std() > 20


def test_a_contact_sheet_that_cannot_be_written_is_refused_by_name(tmp_path, monkeypatch):
    monkeypatch.setattr(renderer, "render", refuse_to_render)  # refused at once, not after the work
    for path in (tmp_path / "nowhere" / "town.png", tmp_path):
        with pytest.raises(InputError) as error:
            contact_sheet(CONFIG, path)
        assert_refused(error, path, "cannot be written")
    with pytest.raises(InputError) as error:
        contact_sheet(CONFIG, tmp_path / "town.png", seed=-1)
    assert_refused(error, tmp_path / "town.png", "seed")

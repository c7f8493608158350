"""The released layout: a folder, an archive and what `ovibjax town` writes give the same frames; gaps are counted."""

import json
import math

import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.features.images.by_path import open_source
from ovibjax.features.images.extraction import extract
from ovibjax.views import VIEWS
from ovibjax.world.town import files as town_files
from ovibjax.world.town.layout import TownConfig, make_town
from ovibjax.world.town.render import Views
from ovibjax.world.town.route import context_labels, make_route
from tests.features.images.made_images import (
    about,
    encode,
    frames_of,
    pack,
    pixels,
    tiny_backbone,
    write,
    write_layout,
)

CONFIG, N_FRAMES, SEED = TownConfig(), 5, 1


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

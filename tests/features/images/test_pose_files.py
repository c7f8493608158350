"""Files of poses as people have them: the same route comes back from every form, and what is missing is named."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ovibjax.errors import InputError
from ovibjax.features.images.axes import axes_of
from ovibjax.features.images.pose_formats import name_recorded_files, read_poses
from ovibjax.features.images.pose_table import PoseOptions

SHORT = PoseOptions(columns=("frame=id", "x_m=x", "y_m=y", "z_m=z", "yaw_deg=yaw"))
HEAD = ("frame", "x_m", "y_m", "z_m", "yaw_deg")


def poses_of(text, options=PoseOptions(), name="poses.csv", front="Front"):  # noqa: B008 (frozen)
    return read_poses(Path(name), text, options, front)


def motion(poses, axes=None):
    """Positions and yaw in the axes that are usual for the form, or in others."""
    axes = axes_of(axes or poses.axes)
    if poses.yaw_rad:
        return axes.place(np.array(poses.position)), axes.yaw_of_angle(np.array(poses.yaw_rad))
    turn = Rotation.from_quat(np.array(poses.quaternion))
    return axes.place(np.array(poses.position)), axes.yaw_of_rotation(turn)


def refused(text, *words, **options):
    with pytest.raises(InputError) as caught:
        poses_of(text, **options)
    said = str(caught.value)
    assert "\n" not in said and all(word in said for word in words), said


coordinates = st.floats(-1e7, 1e7, allow_subnormal=False)
places = st.tuples(coordinates, coordinates, coordinates)
routes = st.lists(st.tuples(places, st.floats(-3.1, 3.1)), min_size=1, max_size=6)

BODY_TO_CAMERA = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # columns: right, down, forward in x forward, z up


def camera_in(yaw_rad, world_is_camera):
    """Rotation of a level camera (z forward), in a world with z up, or in one that is itself a camera's."""
    turn = Rotation.from_euler("z", yaw_rad).as_matrix() @ BODY_TO_CAMERA
    return BODY_TO_CAMERA.T @ turn if world_is_camera else turn


def as_tum(route):
    lines = ["# time x y z qx qy qz qw"]
    for at, (place, yaw) in enumerate(route):
        lines.append(" ".join([f"{1.7e9 + at:.6f}", *map(repr, place), *map(repr, turned(yaw))]))
    return "\n".join(lines)


def turned(yaw):
    return [0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)]


def as_kitti(route):
    rows = []
    for place, yaw in route:
        matrix = np.column_stack([camera_in(yaw, True), BODY_TO_CAMERA.T @ np.array(place)])
        rows.append(" ".join(repr(float(value)) for value in matrix.ravel()))
    return "\n".join(rows)


def as_airsim(route):
    lines = ["VehicleName\tTimeStamp\tPOS_X\tPOS_Y\tPOS_Z\tQ_W\tQ_X\tQ_Y\tQ_Z\tImageFile"]
    for at, (place, yaw) in enumerate(route):
        x, y, z, w = turned(yaw)
        lines.append("\t".join(["", f"{at + 10}", *map(repr, place), repr(w), *map(repr, (x, y, z)), f"a_{at}.png"]))
    return "\n".join(lines)


def as_euroc(route):
    names = ["timestamp", *(f"p_RS_R_{a} [m]" for a in "xyz"), *(f"q_RS_{a} []" for a in "wxyz"), "v_RS_R_x [m s^-1]"]
    lines = ["#" + ", ".join(names)]
    imu = np.array([[0, 0, 1], [0, -1, 0], [1, 0, 0]])  # columns: up, right, forward
    for at, (place, yaw) in enumerate(route):
        x, y, z, w = Rotation.from_matrix(Rotation.from_euler("z", yaw).as_matrix() @ imu).as_quat()
        lines.append(",".join([str(at), *map(repr, place), *(repr(float(v)) for v in (w, x, y, z)), "0.1"]))
    return "\n".join(lines)


def as_colmap(route):
    lines = [
        "# Image list with two lines of data per image:",
        "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME",
    ]
    for at, (place, yaw) in enumerate(route):
        for folder in ("Back", "Front"):
            turn = Rotation.from_matrix(camera_in(yaw, False)).inv()
            x, y, z, w = (float(value) for value in turn.as_quat())
            shift = -turn.apply(place)
            numbers = [w, x, y, z, *map(float, shift)]
            lines += [
                " ".join([str(at), *map(repr, numbers), "1", f"rig/{folder}/{at:04d}.jpg"]),
                "1.0 2.0 -1" * (at % 2),
            ]
    return "\n".join(lines)


def as_table(route, mark=",", point=".", names=HEAD):
    rows = [[str(at), *place, math.degrees(yaw)] for at, (place, yaw) in enumerate(route)]
    cells = [[row[0], *(f"{float(value):.9f}".replace(".", point) for value in row[1:])] for row in rows]
    return "\n".join(mark.join(row) for row in [names, *cells])


WRITERS = {
    "tum": (as_tum, "poses.txt"),
    "kitti": (as_kitti, "poses.txt"),
    "airsim": (as_airsim, "airsim_rec.txt"),
    "euroc": (as_euroc, "data.csv"),
    "colmap": (as_colmap, "images.txt"),
}


@pytest.mark.parametrize("form", WRITERS)
@settings(deadline=None, max_examples=25)
@given(routes)
def test_a_route_comes_back_from_every_form(form, route):
    writer, name = WRITERS[form]
    poses = poses_of(writer(route), name=name)
    assert poses.wrong == [""] * len(route)
    placed, yaw = motion(poses)
    size = max(1.0, *(abs(value) for place, _ in route for value in place))
    np.testing.assert_allclose(placed, [place for place, _ in route], atol=1e-12 * size)
    np.testing.assert_allclose(np.exp(1j * yaw), np.exp(1j * np.array([yaw for _, yaw in route])), atol=1e-6)
    # The same where the form is named instead of recognised.
    assert poses_of(writer(route), PoseOptions(form), name=name).position == poses.position


@pytest.mark.parametrize(("mark", "point"), [(",", "."), (";", ","), (";", "."), ("\t", "."), ("\t", ","), (" ", ".")])
@settings(deadline=None, max_examples=20)
@given(routes)
def test_a_route_comes_back_from_every_dialect(mark, point, route):
    for names, options in ((HEAD, PoseOptions()), (("id", "x", "y", "z", "yaw"), SHORT)):
        poses = poses_of(as_table(route, mark, point, names), options)
        placed, yaw = motion(poses)
        np.testing.assert_allclose(placed, [place for place, _ in route], atol=1e-8)
        np.testing.assert_allclose(yaw, [yaw for _, yaw in route], atol=1e-8)


def test_frames_are_named_as_in_the_file():
    route = [((1.0, 2.0, 3.0), 0.5)] * 2
    named = {form: poses_of(writer(route), name=name).frame for form, (writer, name) in WRITERS.items()}
    assert named == {
        "tum": ["1700000000.000000", "1700000001.000000"],
        "kitti": ["000000", "000001"],
        "airsim": ["10", "11"],
        "euroc": ["0", "1"],
        "colmap": ["0000", "0001"],
    }


@pytest.mark.parametrize("missing", ["", "NA", "-", "nan", "N/A", "null", "NaN", "None"])
@pytest.mark.parametrize("column", [1, 4])
def test_a_missing_value_costs_its_frame_alone(missing, column):
    cells = ["0", "1", "2", "3", "4"]
    cells[column] = missing
    poses = poses_of("\n".join([",".join(HEAD), ",".join(cells), "1,1,2,3,4"]))
    assert [bool(wrong) for wrong in poses.wrong] == [True, False] and HEAD[column] in poses.wrong[0]


@pytest.mark.parametrize(
    "text",
    [
        "# exported\nframe,x_m,y_m,z_m,yaw_deg\n0,1,2,3,4\n# lap 2\n1,1,2,3,4\n",
        "Frame,X_m,Y_M,z_m,YAW_DEG\n0,1,2,3,4\n1,1,2,3,4\n",
        "frame,x_m,y_m,z_m,yaw_deg\r\n\r\n0,1,2,3,4\r\n1,1,2,3,4\r\n",
        'frame , x_m , y_m , z_m , yaw_deg , note\n0,1,2,3,4,\n1,1,2,3,4,"a, b"\n',
        "\tframe\tx_m\ty_m\tz_m\tyaw_deg\n\t0\t1\t2\t3\t4\n\t1\t1\t2\t3\t4\n",
        "frame,x_m,y_m,z_m,yaw_deg,qw,qx,qy,qz\n0,1,2,3,4,0,0,0,0\n1,1,2,3,4,0.99939,0,0,0.0349\n",
    ],
)
def test_tables_from_the_field(text):
    poses = poses_of(text)
    assert poses.frame == ["0", "1"] and poses.position == [(1, 2, 3)] * 2 and poses.wrong == ["", ""]
    np.testing.assert_allclose(poses.yaw_rad, math.radians(4))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("id,x,y,z,yaw\n0,1,2,3,4\n", ["--columns frame=NAME x_m=NAME y_m=NAME z_m=NAME yaw_deg=NAME", "id,x,y,z,yaw"]),
        ("frame,x_m,y_m,z_m,yaw\n0,1,2,3,4\n", ["no column of headings", "--columns yaw_deg=NAME"]),
        ("frame,x_m,y_m,z_m,qw,qx,qy\n0,1,2,3,4,5,6\n", ["no column of headings"]),
        ("frame,x_m,y_m,z_m,yaw_deg\n0,1_000,2,3,4\n", ["line 2", "'1_000'"]),
        ("frame;x_m;y_m;z_m;yaw_deg\n0;1.000,5;2;3;4\n", ["line 2", "'1.000,5'"]),
        ("frame;x_m;y_m;z_m;yaw_deg\n0;1,5;2;3;4\n1;1.5;2;3;4\n", ["line 2", "decimal mark"]),
        ("0 1 2 3 4\n", ["5 numbers", "TUM", "KITTI"]),
        ("# t x y z q\n1 1 2 3 0 0 0 1\n2 1 2 3 0 0 0\n", ["line 3", "7 values, expected 8"]),
        ("1 1 2 3 0 0 0 1\nx 1 2 3 0 0 0 1\n", ["line 2", "'x' is not a number"]),
    ],
)
def test_what_is_refused_names_line_and_option(text, words):
    refused(text, *words)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (PoseOptions("ros"), ["--poses ros", "tum, kitti"]),
        (PoseOptions(columns=("frame",)), ["--columns frame", "NAME=COLUMN"]),
        (PoseOptions(columns=("heading=yaw",)), ["--columns heading=yaw"]),
        (PoseOptions(columns=("frame=nothing",)), ["no such column", "there are frame, x_m"]),
        (PoseOptions("tum", ("frame=a",)), ["leave out --columns"]),
        (PoseOptions("kitti"), ["expected 12"]),
        (PoseOptions("airsim"), ["no such column"]),
        (PoseOptions("colmap"), ["no pose of an image"]),
    ],
)
def test_options_that_do_not_fit(options, words):
    refused(",".join(HEAD) + "\n0,1,2,3,4\n", *words, options=options)


def test_rotations_that_are_none_cost_their_frame():
    tum = poses_of("1 1 2 3 0 0 0 0\n2 1 2 3 0 0 0 1\n3 nan 2 3 0 0 0 nan\n", name="a.txt")
    kitti = poses_of("2 0 0 1 0 2 0 1 0 0 2 1\n1 0 0 1 0 1 0 1 0 0 1 1\n1 0 0 1 0 1 0 1 0 0 -1 1\n", name="a.txt")
    for poses in (tum, kitti):
        assert [bool(wrong) for wrong in poses.wrong] == [True, False, True]
    with pytest.raises(InputError, match="--cameras Front=FOLDER"):
        poses_of(as_colmap([((0, 0, 0), 0.0)]), name="images.txt", front="cam0")


@pytest.mark.parametrize("form", [None, "tum"])
@pytest.mark.parametrize("comma", [",", ", "])
def test_tum_with_commas(form, comma):
    rows = ["1.5 1 2 3 0 0 0 1", "2.5 2 2 3 0 0 0.7071 0.7071"]
    poses = poses_of("\n".join(rows).replace(" ", comma), PoseOptions(form=form), "poses.csv")
    assert poses.frame == ["1.5", "2.5"] and poses.position == [(1, 2, 3), (2, 2, 3)]
    assert motion(poses)[1] == pytest.approx([0, math.pi / 2])


RECORDED = (
    "VehicleName\tTimeStamp\tPOS_X\tPOS_Y\tPOS_Z\tQ_W\tQ_X\tQ_Y\tQ_Z\tImageFile\ndrone\t17\t1\t2\t3\t1\t0\t0\t0\t"
)
SHOTS = ["img_drone_0_1_99.pfm", "img_drone_0_0_99.png", "img_drone_4_0_99.png", "img_drone_2_0_99.png"]
SHOTS += ["img_drone_front_right_0_99.png"]
NAMES = {"Front": "0", "Back": "4", "Left": "2", "Right": "front_right", "Down": "3"}


def test_a_recording_names_the_photo_of_every_camera():
    poses = poses_of(RECORDED + ";".join(SHOTS), name="airsim_rec.txt")
    name_recorded_files(Path("airsim_rec.txt"), poses, NAMES)
    assert poses.cells == [{"Front": SHOTS[1], "Back": SHOTS[2], "Left": SHOTS[3], "Right": SHOTS[4]}]


def test_a_recording_without_a_camera_says_what_there_is():
    poses = poses_of(RECORDED + "img_0_17.jpg", name="airsim_rec.txt")
    with pytest.raises(
        InputError, match=r"line 2: ImageFile has no image of camera '0' for Front, but img_0_17\.jpg.*"
    ):
        name_recorded_files(Path("airsim_rec.txt"), poses, NAMES)

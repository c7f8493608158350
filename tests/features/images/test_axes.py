"""Frames of reference: every code turns its data into x forward, y left, z up; wrong ones are noticed."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ovibjax.errors import InputError
from ovibjax.features.images.axes import axes_of
from ovibjax.features.images.by_path import open_source
from ovibjax.features.images.pose_table import PoseOptions
from tests.features.images.made_images import encode, pixels, write
from tests.features.images.test_pose_files import as_tum, camera_in

PAIRS = ("fb", "lr", "ud")
CODES = ["".join(code) for pairs in itertools.permutations(PAIRS) for code in itertools.product(*pairs)]
DIRECTIONS = {"f": (1, 0, 0), "b": (-1, 0, 0), "l": (0, 1, 0), "r": (0, -1, 0), "u": (0, 0, 1), "d": (0, 0, -1)}
RIGHT_HANDED = [code for code in CODES if np.linalg.det([DIRECTIONS[letter] for letter in code]) > 0]


@settings(deadline=None, max_examples=150)
@given(st.sampled_from(CODES), st.sampled_from(RIGHT_HANDED), st.floats(-3.1, 3.1), st.floats(-1.2, 1.2))
def test_every_code_comes_back(world, body, yaw, pitch):
    to_file = np.array([DIRECTIONS[letter] for letter in world])  # rows: the file's x, y, z
    body_to_file = np.array([DIRECTIONS[letter] for letter in body])
    truth = Rotation.from_euler("ZY", [yaw, pitch])
    place = np.array([[3.0, -4.0, 5.0]])
    axes = axes_of(f"{world}/{body}")
    np.testing.assert_allclose(axes.place(place @ to_file.T), place)
    if np.linalg.det(to_file) < 0:
        return  # a rotation in left-handed axes has no quaternion
    matrix = to_file @ truth.as_matrix() @ body_to_file.T
    turn = Rotation.from_matrix(matrix[None])
    np.testing.assert_allclose(np.exp(1j * axes.yaw_of_rotation(turn)), np.exp(1j * yaw), atol=1e-9)


@pytest.mark.parametrize(
    ("code", "position", "yaw_deg", "expected", "expected_deg"),
    [
        ("flu", (1, 2, 3), 30, (1, 2, 3), 30),
        ("enu", (1, 2, 3), 400, (1, 2, 3), 400),
        ("ned", (1, 2, 3), 30, (2, 1, -3), 60),
        ("nwu", (1, 2, 3), 30, (-2, 1, 3), 120),
        ("frd", (1, 2, 3), 30, (1, -2, -3), -30),
        ("fru", (1, 2, 3), 30, (1, -2, 3), -30),
    ],
)
def test_headings_by_angle(code, position, yaw_deg, expected, expected_deg):
    axes = axes_of(code)
    np.testing.assert_allclose(axes.place(np.array([position], float)), [expected])
    np.testing.assert_allclose(np.degrees(axes.yaw_of_angle(np.radians([yaw_deg]))), expected_deg)


@pytest.mark.parametrize("code", ["", "xyz", "ff", "ffu", "fl", "flud", "enf", "lat-lon", "flu/", "flu/xyz", "fbu"])
def test_codes_that_are_none(code):
    with pytest.raises(InputError, match="--axes"):
        axes_of(code)


def test_degrees_become_metres():
    # One arc second of latitude at 45 degrees is 30.87 m, one of longitude 21.90 m (WGS84).
    second = 1 / 3600
    degrees = np.array([[45.0, 8.0, 100.0], [45.0 + second, 8.0 + second, 101.0]])
    placed = axes_of("lat-lon-alt").place(degrees)
    np.testing.assert_allclose(placed[1] - placed[0], [21.90, 30.87, 1], atol=0.01)
    np.testing.assert_allclose(axes_of("lon-lat-alt").place(degrees[:, [1, 0, 2]]), placed)
    over = axes_of("lat-lon-alt").place(np.array([[0.0, 179.9999, 0], [0.0, -179.9999, 0]]))
    np.testing.assert_allclose(over[1] - over[0], [22.26, 0, 0], atol=0.01)
    with pytest.raises(InputError, match="latitude is beyond 90"):
        axes_of("lat-lon-alt").place(np.array([[100.0, 0, 0]]))
    # A compass: x is north, so an angle of 0 looks north.
    np.testing.assert_allclose(axes_of("lat-lon-alt").yaw_of_angle(np.array([0.0])), np.pi / 2)


def test_an_angle_in_a_level_plane_is_no_heading():
    with pytest.raises(InputError, match="give quaternions"):
        axes_of("rdf").yaw_of_angle(np.zeros(1))


def source(tmp_path, text, **options):
    path = write(tmp_path / "poses.txt", text.encode())
    for view in ("Front", "Back", "Left", "Right"):
        for frame in range(2):
            write(tmp_path / f"{view}/{1.7e9 + frame:.6f}.png", encode(pixels(0)))
    return open_source(path, "{view}/{frame}.png", poses=PoseOptions(**options))


def test_bodies_that_lie_on_their_side_are_refused_until_somebody_says_so(tmp_path):
    camera = []
    for at, yaw in enumerate((0.0, 0.5)):
        quaternion = Rotation.from_matrix(camera_in(yaw, False)).as_quat()
        camera.append(" ".join([f"{1.7e9 + at:.6f}", "1", "2", "3", *(repr(float(value)) for value in quaternion)]))
    with pytest.raises(InputError, match=r"do not stand upright; .* --axes enu/rdf"):
        source(tmp_path, "\n".join(camera))
    found = source(tmp_path, "\n".join(camera), axes="enu/rdf")
    np.testing.assert_allclose([frame.yaw_rad for frame in found.frames], [0, 0.5], atol=1e-9)
    level = source(tmp_path, as_tum([((1.0, 2.0, 3.0), 0.1), ((1.0, 2.0, 3.0), 0.2)]))
    np.testing.assert_allclose([frame.yaw_rad for frame in level.frames], [0.1, 0.2])
    assert "TUM" in level.form and level.axes == "as given, yaw from x towards y"
    with pytest.raises(InputError, match="--axes abc"):
        source(tmp_path, "\n".join(camera), axes="abc")

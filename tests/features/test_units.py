"""Units that cannot be right are named, whatever the route; those that can be are taken without a word."""

import json
import math
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.errors import Doubt, InputError
from ovibjax.features.feature_files import load
from ovibjax.features.images.by_path import open_source
from ovibjax.features.images.pose_table import PoseOptions
from ovibjax.features.units import scale_doubt, seem_beyond_earth, seem_degrees, seem_geographic, seem_radians
from tests.features.cases import raw_features
from tests.features.images.made_images import encode, pixels, write

N = 80


def circle(n=N, radius_m=20.0, laps=1.0, start=0.3):
    """Positions on a circle, and the heading along it, unwrapped, radians."""
    at = start + 2 * np.pi * laps * np.arange(n) / n
    return np.stack([radius_m * np.cos(at), radius_m * np.sin(at), np.full(n, 2.0)], axis=1), at + np.pi / 2


def wavy(n=N, seed=0):
    rng = np.random.default_rng(seed)
    heading = np.cumsum(rng.normal(0, 0.3, n))
    xy = np.cumsum(1.5 * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    return np.column_stack([xy, np.full(n, 2.0)]), heading


def wrapped(yaw_rad):
    return np.angle(np.exp(1j * yaw_rad))


def straight(n=N):
    return np.column_stack([1.5 * np.arange(n), 0.01 * np.sin(np.arange(n)), np.zeros(n)])


ROUTES = {"circle": circle(), "two laps": circle(160, laps=2), "wavy": wavy(), "small": circle(20, 0.5)}
WRAPS = {"wrapped": wrapped, "positive": lambda yaw: wrapped(yaw) % (2 * np.pi)}


@pytest.mark.parametrize("wrap", WRAPS)
@pytest.mark.parametrize("name", ROUTES)
@pytest.mark.parametrize("mounted_rad", [0.0, 1.1, np.pi])
def test_headings_in_the_other_unit_are_told(name, wrap, mounted_rad):
    position, heading = ROUTES[name]
    yaw = WRAPS[wrap](heading + mounted_rad)
    assert seem_radians(position, yaw) and not seem_radians(position, np.degrees(yaw))
    assert seem_degrees(position, np.degrees(yaw)) and not seem_degrees(position, yaw)


@given(st.integers(0, 2**32 - 1), st.floats(0, 3.0), st.integers(8, 300))
@settings(max_examples=150, deadline=None)
def test_a_camera_that_keeps_its_heading_raises_no_doubt(seed, jitter_deg, n):
    """A drone that looks north on any route, with a jitter of a few degrees: within 2 pi, and right."""
    position, heading = wavy(n, seed % 1000)
    yaw_deg = np.clip(np.random.default_rng(seed).normal(0, jitter_deg / 3, n), -3, 3)
    assert not seem_radians(position, yaw_deg)
    assert not seem_radians(straight(n), yaw_deg)
    assert not seem_degrees(position, np.unwrap(heading))


@given(st.integers(0, 2**32 - 1), st.integers(30, 400))
@settings(max_examples=100, deadline=None)
def test_places_in_no_order(seed, n):
    """Without movement, headings that fill the circle of radians and end at it are told; those in degrees are fine."""
    rng = np.random.default_rng(seed)
    position, yaw_rad = rng.uniform(-100, 100, (n, 3)), rng.uniform(-np.pi, np.pi, n)
    yaw_rad[0] = 3.1
    assert seem_radians(position, yaw_rad) and not seem_radians(position, np.degrees(yaw_rad))
    assert not seem_degrees(position, yaw_rad) and seem_degrees(position, np.degrees(yaw_rad) % 359 + 0.5)


@pytest.mark.parametrize("laps", [1.0, 2.0, 6.5, 40.0])
@pytest.mark.parametrize("backwards", [1, -1])
def test_radians_that_go_on_over_the_laps_are_told(laps, backwards):
    """Yaw of odometry is not wrapped: pi/2 to 14 rad under a column of degrees."""
    position, heading = circle(400, laps=laps)
    position, yaw = position * (1, backwards, 1), heading * backwards
    for turned in (yaw, -10 - yaw):  # from x towards y, or as a compass
        assert seem_radians(position, turned) and not seem_radians(position, np.degrees(turned))


@given(st.integers(0, 2**32 - 1), st.integers(8, 300))
@settings(max_examples=200, deadline=None)
def test_degrees_that_have_nothing_to_do_with_the_movement_are_no_radians(seed, n):
    rng = np.random.default_rng(seed)
    position, heading = wavy(n, seed % 1000)
    for yaw_deg in (np.cumsum(rng.normal(0, 5, n)), np.full(n, 200.0), -np.degrees(heading), 90 + rng.normal(0, 5, n)):
        assert not seem_radians(position, np.append(yaw_deg[:-1], 250.0))


@pytest.mark.parametrize("metres", [1e7, -1e7, 2.0037e7])
def test_coordinates_on_earth_raise_no_doubt(metres):
    position = circle()[0] + (metres, -metres, 0)
    assert not seem_beyond_earth(position) and not scale_doubt(position)


@pytest.mark.parametrize(
    ("of_metres", "words"),
    [(100.0, "centimetres"), (1000.0, "centimetres"), (1e-5, "degrees"), (9e-6, "degrees"), (1.0, ""), (0.1, "")],
)
def test_a_drive_of_odd_size_is_named(of_metres, words):
    for position in (circle(60)[0], wavy(60)[0]):
        for climb in (0.0, 0.5):
            odd = scale_doubt(position * (of_metres, of_metres, 1) + np.outer(climb * np.arange(60), (0, 0, 1)))
            assert words in odd and bool(odd) == bool(words)


def test_places_in_no_order_and_far_apart_raise_no_doubt():
    position = np.random.default_rng(0).uniform(-5000, 5000, (300, 3))
    assert scale_doubt(position) == "" and scale_doubt(np.zeros((100, 3))) == ""


def test_degrees_of_a_receiver_are_refused_with_what_settles_it(tmp_path):
    position, heading = circle()
    whole = np.round((np.array([47.12018, 8.5]) + position[:, :2] * 1e-5) * 1e7)
    path = table(tmp_path, np.column_stack([whole, position[:, 2]]), {"yaw_deg": np.degrees(heading)})
    with pytest.raises(InputError, match=r"my\.csv: .*no place on Earth.*--axes lat-lon-alt.*--axes flu") as caught:
        opened(path)
    assert len(str(caught.value).splitlines()) == 1
    assert len(opened(path, axes="flu").frames) == N


def test_many_laps_are_no_degrees():
    position, heading = circle(2000, laps=40)
    assert np.abs(heading).max() > 200 and not seem_degrees(position, heading)


CITIES = [
    (47.123456, 8.654321),
    (51.5007, -0.1246),
    (-33.8568, 151.2153),
    (0.0005, 120.0),
    (64.1, -21.9),
    (37.77, -122.42),
]


@pytest.mark.parametrize("place", CITIES)
@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("extent_deg", [1e-4, 1e-2, 0.04])
def test_latitude_and_longitude_are_told(place, swapped, extent_deg):
    rng = np.random.default_rng(3)
    degrees = np.array(place) + extent_deg * rng.uniform(-0.5, 0.5, (N, 2))
    position = np.column_stack([degrees[:, ::-1] if swapped else degrees, rng.uniform(400, 500, N)])
    assert seem_geographic(position)


@given(st.integers(0, 2**32 - 1), st.floats(0.5, 500), st.floats(0, 9), st.integers(8, 100))
@settings(max_examples=200, deadline=None)
def test_rooms_and_towns_are_no_globes(seed, extent_m, from_zero, n):
    """Any patch that lies within some widths of its origin, and any national grid."""
    rng = np.random.default_rng(seed)
    corner = from_zero * extent_m * rng.uniform(-1, 1, 3)
    position = corner + extent_m * rng.uniform(0, 1, (n, 3))
    position[:2, :2] = np.array([[0, 0], [extent_m, extent_m]]) + corner[:2]
    assert not seem_geographic(position)
    assert not seem_geographic(np.array([512345.0, 5234567.0, 0.0]) + position)


def table(folder, position, columns):
    """`my.csv` with a picture per view, the same for all frames."""
    for view in ("Front", "Back", "Left", "Right"):
        write(folder / f"{view}.png", encode(pixels(1)))
    head = ["frame", "x_m", "y_m", "z_m", *columns]
    rows = [[f"{i}", *map(repr, row)] for i, row in enumerate(np.column_stack([position, *columns.values()]).tolist())]
    text = "\n".join(",".join(cells) for cells in [head, *rows])
    return write(folder / "my.csv", text.encode())


def opened(path, **options):
    for frame in range(N):  # one picture serves them all
        for view in ("Front", "Back", "Left", "Right"):
            link = path.parent / view / f"{frame}.png"
            if not link.exists():
                link.parent.mkdir(exist_ok=True)
                link.hardlink_to(path.parent / f"{view}.png")
    return open_source(path, "{view}/{frame}.png", poses=PoseOptions(**options))


@pytest.mark.parametrize(
    ("column", "in_unit", "settled"),
    [
        ("yaw_deg", 1.0, "yaw_rad=yaw_deg"),
        ("yaw_rad", 180 / math.pi, "yaw_deg=yaw_rad"),
        ("YAW_DEG", 1.0, "yaw_rad=YAW_DEG"),
    ],
)
def test_a_table_in_another_unit_is_refused_with_what_settles_it(tmp_path, column, in_unit, settled):
    position, heading = circle()
    path = table(tmp_path, position, {column: wrapped(heading) * in_unit})
    with pytest.raises(InputError, match=rf"my\.csv: {column} looks like .*--columns {settled}") as caught:
        opened(path)
    assert len(str(caught.value).splitlines()) == 1
    found = opened(path, columns=(settled,))
    np.testing.assert_allclose([frame.yaw_rad for frame in found.frames], wrapped(heading))
    as_named = opened(path, columns=(f"{column.lower()}={column}",))
    assert len(as_named.frames) == N


def test_a_table_of_degrees_is_refused_with_what_settles_it(tmp_path):
    position, heading = circle()
    degrees = np.column_stack([47.1 + position[:, :2] * 1e-5, position[:, 2]])
    path = table(tmp_path, degrees, {"yaw_deg": np.degrees(heading)})
    with pytest.raises(InputError, match=r"latitude and longitude.*--axes lat-lon-alt or lon-lat-alt, or --axes flu"):
        opened(path)
    for axes, far_m in (("lat-lon-alt", 40), ("lon-lat-alt", 40), ("flu", 4e-4)):
        places = np.array([frame.position_m for frame in opened(path, axes=axes).frames])
        assert np.ptp(places[:, 0]) == pytest.approx(far_m, rel=0.6)


def test_feature_files_in_other_units_are_named(tmp_path):
    position, heading = circle()
    fields = {"features": raw_features(N), "positions_m": position, "yaw_rad": wrapped(heading)}
    np.savez(tmp_path / "good.npz", **fields)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load(tmp_path / "good.npz")
    np.savez(tmp_path / "deg.npz", **fields | {"yaw_rad": np.degrees(wrapped(heading))})
    with pytest.warns(Doubt, match=r"deg\.npz: yaw_rad looks like degrees"):
        load(tmp_path / "deg.npz")
    np.savez(tmp_path / "globe.npz", **fields | {"positions_m": 47.1 + position * 1e-5})
    with pytest.warns(Doubt, match=r"globe\.npz: positions_m look like latitude"):
        load(tmp_path / "globe.npz")


@pytest.mark.parametrize(
    ("factor", "scale", "words"), [(1.0, 1.0, "radians"), (180 / math.pi, 1e-5, "latitude"), (180 / math.pi, 1.0, "")]
)
def test_towns_in_other_units_are_named(tmp_path, factor, scale, words):
    position, heading = circle(20)
    for frame in range(20):
        for camera in ("Front", "Back", "Left", "Right"):
            write(tmp_path / "rgb" / camera / f"{frame:06d}.png", encode(pixels(1)))
        place = dict(zip("xyz", (position[frame] * scale + (47.1 if scale < 1 else 0.0)).tolist(), strict=True))
        turn = {"pitch": 0.0, "yaw": float(wrapped(heading[frame]) * factor), "roll": 0.0}
        text = json.dumps({"uav_state": {"position": place, "rotation": turn}})
        write(tmp_path / "metadata" / f"{frame:06d}.json", text.encode())
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        open_source(tmp_path).close()
    assert [words in str(one.message) and one.category is Doubt for one in said] == ([True] if words else [])

"""Drives are told from places in no order, whatever the scale; what is no drive gets no figures of one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.cards.job import Job
from ovibjax.cli.options import own_drive
from ovibjax.errors import InputError
from ovibjax.features.description import describe
from ovibjax.features.feature_files import save
from ovibjax.features.frames import make_feature_set
from ovibjax.features.images.pose_formats import read_poses
from ovibjax.features.images.pose_table import PoseOptions
from ovibjax.features.sequence import require_drive, sequence_of
from ovibjax.features.splits import split_indices
from tests.cli.cases import said_of_bad_input
from tests.features.cases import raw_features


def drive(n=300, seed=0, step_m=1.6, wander=0.15):
    """A route with turns, at a speed that varies."""
    rng = np.random.default_rng(seed)
    heading = np.cumsum(rng.normal(0, wander, n))
    step = step_m * rng.uniform(0.5, 1.5, (n, 1))
    xy = np.cumsum(step * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    return np.column_stack([xy, np.full(n, 20.0)])


def lanes(rows=12, columns=25, apart_m=0.4):
    """A survey in lanes, there and back."""
    y, x = np.divmod(np.arange(rows * columns), columns)
    x = np.where(y % 2 == 0, x, columns - 1 - x)
    return apart_m * np.column_stack([x, y, np.zeros(len(x))])


def laps(n=300, count=6):
    at = 2 * np.pi * count * np.arange(n) / n
    return 25 * np.column_stack([np.cos(at), np.sin(at), np.zeros(n)])


DRIVES = {
    "wandering": drive(),
    "straight": drive(wander=0.0),
    "fast": drive(step_m=39.0),
    "indoors": drive(step_m=0.02),
    "lanes": lanes(),
    "laps": laps(),
    "random walk": np.cumsum(np.random.default_rng(0).normal(size=(240, 3)), axis=0),
    "with noise": drive(step_m=0.5) + np.random.default_rng(1).normal(0, 0.3, (300, 3)),
    "two frames": drive(2),
    "one frame": drive(1),
}


def looked_at(places, scenes=1):
    return sequence_of(np.asarray(places, np.float64), (np.arange(len(places)) % scenes).astype(np.int32))


@pytest.mark.parametrize("name", DRIVES)
def test_a_drive_is_one_and_a_shuffled_one_is_none(name):
    places = DRIVES[name]
    assert looked_at(places).is_drive
    if len(places) > 10:
        shuffled = np.random.default_rng(5).permutation(places)
        found = looked_at(shuffled)
        assert not found.is_drive and "places in no order" in found.line()


@given(st.integers(0, 2**32 - 1), st.floats(0.01, 50), st.integers(30, 400), st.sampled_from([0, 5e6]))
@settings(max_examples=80, deadline=None)
def test_scale_and_origin_do_not_matter(seed, step_m, n, offset_m):
    places = drive(n, seed, step_m) + offset_m
    assert looked_at(places).is_drive
    assert not looked_at(np.random.default_rng(seed).uniform(0, step_m * n, (n, 3)) + offset_m).is_drive


def test_the_table_of_the_report():
    """1,500 random places: 39 m from one to the next, 59 km in all, as if somebody had driven them."""
    places = np.random.default_rng(2).uniform(0, 75, (1500, 3)) * [1, 1, 0]
    found = looked_at(places)
    assert 35 < found.step_m < 43 and found.length_m > 55_000 and not found.is_drive


def test_stops_and_jumps_are_counted():
    places = drive(100)
    places = np.concatenate([places[:40], np.repeat(places[39:40], 25, axis=0), places[40:], places + 500])
    found = looked_at(places)
    assert (found.stops, found.jumps, found.is_drive) == (25, 1, True)
    assert found.line().endswith("25 stops (under 1 mm), 1 jump (over 10 times the median)")
    assert found.length_m == pytest.approx(2 * looked_at(drive(100)).length_m)
    # More stops than movement: the movement is no jump.
    crawling = np.repeat(drive(50), 4, axis=0)
    found = looked_at(crawling)
    assert (found.stops, found.jumps) == (150, 0) and found.length_m == pytest.approx(looked_at(drive(50)).length_m)
    still = looked_at(np.zeros((50, 3)))
    assert (still.stops, still.jumps, still.length_m, still.is_drive) == (49, 0, 0.0, True)


def test_scenes_have_drives_of_their_own():
    places = np.stack([drive(100, 0), drive(100, 1) + 1e5], axis=1).reshape(-1, 3)
    assert looked_at(places, scenes=2).is_drive and looked_at(places, scenes=2).jumps == 0
    assert not looked_at(places).is_drive  # there and back between two towns


def feature_set(places):
    return make_feature_set(raw_features(len(places), 5, 6), places)


def test_a_description_of_places_has_no_route():
    places = np.random.default_rng(0).permutation(drive())
    found = describe(feature_set(places), split_indices(300, 0))
    assert np.isnan(found.route_m) and np.isnan(found.spacing_m) and found.nearest_m > 0
    again = describe(feature_set(drive()), split_indices(300, 0))
    assert again.route_m == pytest.approx(np.linalg.norm(np.diff(drive(), axis=0), axis=1).sum())


@pytest.mark.parametrize(("order", "words"), [(None, "places in no order"), ("places", "said to be"), ("drive", "")])
def test_what_somebody_says_settles_it(tmp_path, order, words):
    places = feature_set(np.random.default_rng(0).permutation(drive()))
    job = Job("x", "smoke", tmp_path, 100, places, "mine.npz", None, order=order)
    save(tmp_path / "mine.npz", places)
    if not words:
        assert job.own_drive is places and own_drive(tmp_path / "mine.npz", order) is not None
        return
    for ask in (lambda: job.own_drive, lambda: own_drive(tmp_path / "mine.npz", order)):
        with pytest.raises(InputError, match=rf"mine\.npz: {words}.*ovibjax features --order COLUMN"):
            ask()


def test_a_drive_may_be_said_to_be_places():
    with pytest.raises(InputError, match="said to be places"):
        require_drive(feature_set(drive()), "a.npz", "places")
    with pytest.raises(InputError, match="--order time: frames are drive or places"):
        require_drive(feature_set(drive()), "a.npz", "time")


@pytest.mark.parametrize(
    "command",
    [("replay",), ("sweep", "system", "--out", "a.zarr"), ("reproduce", "--only", "request_control")],
    ids=str,
)
def test_commands_that_drive_refuse_places(tmp_path, monkeypatch, capsys, command):
    monkeypatch.chdir(tmp_path)
    save(tmp_path / "mine.npz", feature_set(np.random.default_rng(0).permutation(drive())))
    said = said_of_bad_input(monkeypatch, capsys, *command, "--data", "mine.npz")
    refused = [line for line in said.splitlines() if line.startswith("ovibjax: ")]
    assert len(refused) == 1 and "places in no order" in refused[0] and "--order drive" in refused[0]


ROWS = {"1.5": 1, "-3": 0, "1e3": 2, "2000": 3}
DATES = {"2024-05-31T10:00:00": 1, "2024-05-31": 0, "2024-05-31 10:00:00.5": 2, "2025-01-01": 3}


def table(times, column="time"):
    rows = [f"f{rank},{rank},0,0,0,{time}" for time, rank in times.items()]
    return "\n".join([f"frame,x_m,y_m,z_m,yaw_deg,{column}", *rows])


def poses_of(text, **options):
    return read_poses("poses.csv", text, PoseOptions(**options), "Front")


@pytest.mark.parametrize("times", [ROWS, DATES], ids=["numbers", "dates"])
@pytest.mark.parametrize("column", ["time", "time_s", "Timestamp"])
def test_a_column_of_time_orders_the_frames(times, column):
    found = poses_of(table(times, column))
    assert found.frame == ["f0", "f1", "f2", "f3"] and [place[0] for place in found.position] == [0, 1, 2, 3]
    assert found.line[:2] == [3, 2] and f"in order of {column} (2 moved)" in found.form and "not read" not in found.form


@given(st.lists(st.floats(-1e9, 1e9), min_size=1, max_size=30))
@settings(max_examples=50, deadline=None)
def test_any_column_orders_the_frames_when_asked(times):
    text = "frame,x_m,y_m,z_m,yaw_deg,stamp\n" + "\n".join(f"f{i},0,0,0,0,{t!r}" for i, t in enumerate(times))
    assert poses_of(text).frame == [f"f{i}" for i in range(len(times))]
    expected = sorted(range(len(times)), key=lambda i: times[i])  # equal times keep their order
    assert poses_of(text, order="stamp").frame == [f"f{i}" for i in expected]


def test_what_is_no_time_is_said():
    text = table({"10:00": 1, "later": 0})
    found = poses_of(text)
    assert found.frame == ["f1", "f0"] and "time not read (in line 2 it is '10:00', no time)" in found.form
    for options, words in (
        ({"order": "time"}, "line 2: time is '10:00'"),
        ({"order": "tiem"}, "--order tiem: no such"),
    ):
        with pytest.raises(InputError, match=words):
            poses_of(text, **options)
    with pytest.raises(InputError, match="leave out --order"):
        poses_of("1 0 0 0 0 0 0 1\n", order="time")

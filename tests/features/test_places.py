"""Positions far from zero: nothing of a millimetre is lost from the table to the judged error."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.control.drives import SURVEY_DEG, SURVEY_M, halves, join_drives, survey
from ovibjax.control.residuals import answers
from ovibjax.edge.indoor_data import scene_data
from ovibjax.edge.judging import Trained, judge_raw
from ovibjax.edge.retrieval import brute_force
from ovibjax.encoder.checkpoint import CheckpointConfig, train_checkpoint
from ovibjax.encoder.model import Architecture, init
from ovibjax.encoder.training_data import member_data
from ovibjax.errors import Doubt, InputError
from ovibjax.features.description import describe
from ovibjax.features.feature_files import load, save
from ovibjax.features.frames import make_feature_set
from ovibjax.features.images.by_path import open_source
from ovibjax.features.images.extraction import extract
from ovibjax.features.places import MAX_MAGNITUDE_M, coarse_m, from_origin, origin_of
from ovibjax.features.splits import split_indices
from ovibjax.views import mode_mask
from tests.features.cases import raw_features
from tests.features.images.made_images import encode, pixels, tiny_backbone, write

# Zero; a UTM zone; earth-centred coordinates, 6,000 km and more; and what a survey has below zero.
OFFSETS = [(0.0, 0.0, 0.0), (512345.125, 5234567.875, 512.0), (6.1e6, -2.3e6, 6.0e6), (-6e6, 1.0, -0.5)]
MM = 1e-3


def route_m(n=240, step_m=0.25):
    """A route with a step of 0.25 m between frames, in turns."""
    heading = np.cumsum(0.05 * np.sin(np.arange(n) / 7))
    xy = np.cumsum(step_m * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    return np.column_stack([xy, 1.5 + 0.1 * np.sin(np.arange(n) / 5)])


@pytest.fixture(params=OFFSETS, ids=str)
def offset(request):
    return np.array(request.param)


def driven(offset, n=240):
    return make_feature_set(raw_features(n, 5, 16), route_m(n) + offset, yaw_rad=np.linspace(0, 3, n))


@given(
    st.lists(st.floats(-1e7, 1e7), min_size=3, max_size=3),
    st.floats(1e-3, 2000),
    st.integers(0, 2**32 - 1),
)
@settings(max_examples=200, deadline=None)
def test_differences_from_the_origin_are_exact_to_a_tenth_of_a_millimetre(offset, extent_m, seed):
    places = np.array(offset) + extent_m * np.random.default_rng(seed).uniform(-1, 1, (30, 3))
    origin = origin_of(places)
    near = from_origin(places, origin)
    assert near.dtype == np.float32 and np.abs(near).max() <= extent_m + 513
    np.testing.assert_array_equal(origin, origin.astype(np.float32))  # a pytree of float32 may carry it
    np.testing.assert_allclose(near.astype(np.float64) + origin, places, rtol=0, atol=0.2 * MM)


@given(st.integers(0, 2**32 - 1))
def test_small_scenes_keep_their_coordinates(seed):
    places = np.random.default_rng(seed).uniform(-510, 510, (20, 3)).astype(np.float32)
    assert not origin_of(places).any()
    np.testing.assert_array_equal(from_origin(places, origin_of(places)), places, strict=True)


def test_the_origin_of_several_sets_is_one():
    assert origin_of([[0.0, 5000.0]], [[100.0, 7200.0]]).tolist() == [0.0, 6144.0]
    assert np.signbit(origin_of([[-1.0, -2.0]])).tolist() == [False, False]


@pytest.mark.parametrize("step_m", [0.25, 0.01, 0.002])
def test_a_table_reaches_the_description_whole(tmp_path, offset, step_m):
    places = route_m(30, step_m) + offset
    rows = ["frame,x_m,y_m,z_m,yaw_deg", *(f"{i},{x!r},{y!r},{z!r},{i}" for i, (x, y, z) in enumerate(places.tolist()))]
    write(tmp_path / "my.csv", "\n".join(rows).encode())
    for view in ("Front", "Back", "Left", "Right"):
        write(tmp_path / f"{view}.png", encode(pixels(1)))
        for i in range(30):
            write(tmp_path / view / f"{i}.png", (tmp_path / f"{view}.png").read_bytes())
    extract(open_source(tmp_path / "my.csv", "{view}/{frame}.png"), tiny_backbone(), tmp_path / "mine.npz")
    made = load(tmp_path / "mine.npz")
    np.testing.assert_allclose(made.positions_m, places, rtol=0, atol=1e-8)
    found = describe(made, split_indices(30, 0))
    straight = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert found.spacing_m == pytest.approx(np.median(straight), abs=MM)
    assert found.route_m == pytest.approx(straight.sum(), abs=MM)
    assert found.extent_m == pytest.approx(np.ptp(places, axis=0), abs=MM)


def test_training_and_judging_see_differences(offset):
    data = driven(offset)
    member, _ = member_data(data, 0, 8)
    split = split_indices(240, 0)
    for part, rows in ((member.train_m, split.train), (member.val_m, split.val), (member.test_m, split.test)):
        back = np.asarray(part, np.float64) + np.asarray(member.origin_m, np.float64)
        np.testing.assert_allclose(back, data.positions_m[rows], rtol=0, atol=MM / 10)
    train = data.positions_m[split.train]
    y = (train - train.mean(axis=0)) / member.standardizer.scale_m
    np.testing.assert_allclose(member.train.y, y, atol=1e-4)


def test_judged_errors_are_those_of_float64(offset):
    data = driven(offset)
    member, _ = member_data(data, 0, 8)
    split = split_indices(240, 0)
    arch = Architecture(view_dim=8, latent=16, hidden=32, last_hidden=16)
    judged = judge_raw(Trained(member, init(jax.random.key(0), arch)), arch, mode_mask("A5", 5))
    flat = [x.reshape(len(x), -1) for x in (member.test_x, member.train.x)]
    found = np.asarray(brute_force(*flat))
    gap = np.linalg.norm(data.positions_m[split.train][found] - data.positions_m[split.test], axis=1)
    assert float(judged.ret_mean_m) == pytest.approx(gap.mean(), abs=MM)


def test_request_control_sees_differences(offset):
    data = driven(offset)
    frames = join_drives(halves(data), 1)
    assert frames.positions_m.dtype == np.float32
    np.testing.assert_allclose(np.diff(frames.positions_m, axis=0), np.diff(data.positions_m, axis=0), atol=MM)
    at_home = join_drives(halves(driven(np.zeros(3))), 1)
    np.testing.assert_array_equal(frames.references, at_home.references)


def test_residuals_are_those_of_float64(offset):
    from ovibjax.control.actions import ACTIONS

    frames = join_drives(halves(driven(offset)), 1)
    sizes = CheckpointConfig(steps=1, rank=8, mixed=0, hidden=16, last_hidden=8)
    checkpoint = train_checkpoint(jax.random.key(0), frames.first_frames, sizes)
    references = survey(frames.positions_m, frames.yaw_rad, frames.drive, SURVEY_M, SURVEY_DEG)
    far = answers(checkpoint, frames.features, frames.positions_m, references, ACTIONS).residual_m
    whole = driven(offset).positions_m
    # Every residual is the distance to some reference, exact to a millimetre.
    apart = np.linalg.norm(whole[:, None, :2] - whole[references][None, :, :2], axis=-1)
    size = np.linalg.norm(far, axis=-1)
    assert np.abs(size[:, :, None] - apart[:, None, :]).min(axis=-1).max() < MM


def test_the_indoor_protocol_sees_differences(offset):
    references, queries = driven(offset, 60), driven(offset + 0.125, 20)
    made, asked = scene_data(references, queries, 8)
    gap = np.asarray(asked.positions_m)[:, None] - np.asarray(made.positions_m)[None]
    exact = queries.positions_m[:, None] - references.positions_m[None]
    np.testing.assert_allclose(gap, exact, rtol=0, atol=MM)


@pytest.mark.parametrize("dtype", ["<f8", ">f8", "<i8", "<i4"])
def test_wide_types_are_kept_without_a_word(tmp_path, dtype):
    places = np.round(route_m(6, 2.0) + OFFSETS[1]).astype(dtype)
    np.savez(tmp_path / "a.npz", features=raw_features(6), positions_m=places)
    made = load(tmp_path / "a.npz")
    np.testing.assert_array_equal(made.positions_m, places.astype(np.float64), strict=True)
    save(tmp_path / "b.npz", made)
    np.testing.assert_array_equal(load(tmp_path / "b.npz").positions_m, made.positions_m, strict=True)


@pytest.mark.parametrize(
    ("dtype", "at_m", "step"), [("f4", 5e6, "0.5 m"), ("f4", 40000, "0.0039 m"), ("f2", 300, "0.25 m")]
)
def test_a_type_that_has_lost_something_is_named(tmp_path, dtype, at_m, step):
    np.savez(tmp_path / "a.npz", features=raw_features(), positions_m=np.full((6, 3), at_m, dtype))
    with pytest.warns(Doubt, match=rf"a\.npz: positions_m is float\d\d, which steps by {step} .* float64"):
        load(tmp_path / "a.npz")
    assert coarse_m(np.array([100.0], "f4")) == coarse_m(np.array([5e6])) == coarse_m(np.array([10**9])) == 0


def test_a_folder_that_has_lost_something_is_named(tmp_path):
    for camera in ("Front", "Back", "Left", "Right"):
        (tmp_path / camera).mkdir()
        for i, row in enumerate(raw_features(3, 1)):
            np.savez(tmp_path / camera / f"{i}.npz", feature=row[0], position=np.float32([5e5 + i, 5.2e6, 3.0]))
    with pytest.warns(Doubt, match=r"position has a type that steps by 0\.5 m"):
        load(tmp_path)


def test_far_beyond_the_earth_is_refused():
    with pytest.raises(InputError, match="beyond 1e"):
        make_feature_set(raw_features(), np.full((6, 3), 2 * MAX_MAGNITUDE_M))


def test_one_origin_serves_every_seed():
    data = driven(np.array(OFFSETS[2]))
    origins = [member_data(data, seed, 8)[0].origin_m for seed in (0, 1)]
    np.testing.assert_array_equal(*origins)
    assert jnp.stack(origins).dtype == jnp.float32

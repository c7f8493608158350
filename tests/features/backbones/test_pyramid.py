"""The embedded backbone: unit-norm, seeded, and smooth in the pose.

Images come in the renderer's batches of two poses, ten views, so that one size is compiled.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import correlate2d

from ovibjax.features.backbones.pyramid import (
    EMBEDDED_DIM,
    EMBEDDED_HEIGHT_PX,
    EMBEDDED_WIDTH_PX,
    _convolve,
    embed,
    embedded_backbone,
)
from ovibjax.world.town.layout import TownConfig, make_town
from ovibjax.world.town.render import Camera, render
from ovibjax.world.town.route import make_route


@pytest.fixture(scope="module")
def town():
    return make_town(TownConfig())


@pytest.fixture(scope="module")
def route(town):
    return make_route(town, TownConfig(), 400, seed=0)


def view_features(town, positions_m, yaw_rad):
    """Features of two poses, [2, 5, 512]."""
    camera = Camera(EMBEDDED_HEIGHT_PX, EMBEDDED_WIDTH_PX)
    rgb = render(town, positions_m, yaw_rad, camera).rgb.reshape(-1, EMBEDDED_HEIGHT_PX, EMBEDDED_WIDTH_PX, 3)
    return np.asarray(embed(embedded_backbone(), rgb)).reshape(2, 5, EMBEDDED_DIM)


def test_features_have_unit_norm(town, route):
    features = view_features(town, route.positions_m[:2], route.yaw_rad[:2])
    assert features.dtype == np.float32 and np.isfinite(features).all()
    np.testing.assert_allclose(np.linalg.norm(features, axis=-1), 1.0, atol=1e-5)


def test_equal_images_give_equal_features_wherever_they_stand_in_the_batch():
    noise = np.random.default_rng(0).uniform(size=(10, EMBEDDED_HEIGHT_PX, EMBEDDED_WIDTH_PX, 3)).astype(np.float32)
    noise[7] = noise[2]
    features = np.asarray(embed(embedded_backbone(), jnp.asarray(noise)))
    np.testing.assert_allclose(features[7], features[2], atol=1e-6)
    np.testing.assert_array_equal(embed(embedded_backbone(), jnp.asarray(noise)), features)
    swapped = np.asarray(embed(embedded_backbone(), jnp.asarray(noise[::-1].copy())))
    np.testing.assert_allclose(swapped[::-1], features, atol=1e-6)


def test_weights_are_a_function_of_the_seed():
    jax.tree.map(np.testing.assert_array_equal, embedded_backbone(3), embedded_backbone(3))
    assert all(array.dtype == np.float32 for array in jax.tree.leaves(embedded_backbone()))
    for a, b in zip(jax.tree.leaves(embedded_backbone(0)), jax.tree.leaves(embedded_backbone(1)), strict=True):
        assert a.shape == b.shape and not np.array_equal(a, b)


def test_near_poses_are_more_alike_than_far_ones(town, route):
    """1 m on and 50 m on, at six places: every view on average, and all views together at every place."""
    near, far = [], []
    for frame in range(0, 360, 60):
        here, yaw = route.positions_m[frame], route.yaw_rad[frame]
        ahead = here + np.array([np.cos(yaw), np.sin(yaw), 0], np.float32)
        # 50 m off as the crow flies: frames in a turn lie closer together than 1.6 m.
        away = np.linalg.norm(route.positions_m - here, axis=1)
        distant = int(np.argmin(np.abs(away - 50)))
        for at, heading, found in ((ahead, yaw, near), (route.positions_m[distant], route.yaw_rad[distant], far)):
            features = view_features(town, np.stack([here, at]), np.stack([yaw, heading]))
            found.append((features[0] * features[1]).sum(axis=-1))
    near_view, far_view = np.array(near), np.array(far)
    assert (near_view.mean(axis=0) > far_view.mean(axis=0) + 0.1).all(), (near_view.mean(axis=0), far_view.mean(axis=0))
    assert (near_view.mean(axis=1) > far_view.mean(axis=1)).all()


@pytest.mark.parametrize(("size", "channels", "shape"), [(5, 3, (12, 16)), (3, 4, (7, 9))])
def test_convolution_equals_that_of_scipy(size, channels, shape):
    rng = np.random.default_rng(size)
    x = rng.normal(size=(2, *shape, channels)).astype(np.float32)
    kernel = rng.normal(size=(size, size, channels, 6)).astype(np.float32)
    # Zero padding by half the kernel; networks correlate, and call it convolution.
    expected = [
        [
            sum(correlate2d(image[..., i], kernel[..., i, o], "same")[::2, ::2] for i in range(channels))
            for o in range(6)
        ]
        for image in x
    ]
    got = jax.jit(_convolve)(jnp.asarray(x), jnp.asarray(kernel))
    np.testing.assert_allclose(got, np.moveaxis(np.array(expected), 1, -1), atol=1e-4)

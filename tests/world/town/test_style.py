"""Styles: the default one is what it always was, the others differ and lie where they should."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.world.town.layout import TownConfig, make_town
from ovibjax.world.town.render import Camera, _compose, render
from ovibjax.world.town.route import make_route
from ovibjax.world.town.style import make_style

NUMBERS = range(1, 41)


def test_style_zero_is_the_default_look():
    style = make_style(0)
    assert TownConfig().style == 0
    assert style[2:] == (1.0,) * 6  # nothing is scaled
    expected = {
        "sun": (0.46, -0.54, 0.705),
        "sun_inverse": (1 / 0.46, -1 / 0.54, 1 / 0.705),
        "sunlight": (0.95, 0.89, 0.78),
        "skylight": (0.38, 0.44, 0.54),
        "haze_m": 210.0,
        "sky_top": (0.10, 0.26, 0.62),
        "horizon": (0.56, 0.66, 0.78),
        "clear": 0.48,
        "ground": ((0.97, 0.98, 1.04), (1.04, 1.0, 0.94), (1.08, 1.0, 0.86), (0.24, 0.36, 0.13)),
        "leaf": ((0.16, 0.30, 0.10), (0.20, 0.08, 0.0)),
        "glass": (0.8, 0.95, 1.1),
    }
    for name, value in expected.items():
        np.testing.assert_array_equal(getattr(style.look, name), np.asarray(value, np.float32), strict=True)
    np.testing.assert_array_equal(style.palette[[0, 11]], np.float32([[0.72, 0.66, 0.58], [0.44, 0.34, 0.30]]))


@pytest.mark.parametrize("number", [1, 2, 7])
def test_a_style_is_drawn_from_its_number_alone(number):
    for a, b in zip(jax.tree.leaves(make_style(number)), jax.tree.leaves(make_style(number)), strict=True):
        np.testing.assert_array_equal(a, b)


def test_styles_differ_and_light_is_physical():
    looks = [make_style(number).look for number in NUMBERS]
    flat = np.array([np.concatenate([np.ravel(leaf) for leaf in look]) for look in looks])
    apart = np.abs(flat[:, None] - flat[None]).max(axis=-1) + np.eye(len(flat))
    assert apart.min() > 0.1
    for look in looks:
        assert np.linalg.norm(look.sun) == pytest.approx(1.0, abs=1e-5)
        assert np.sin(np.deg2rad(20)) <= look.sun[2] <= np.sin(np.deg2rad(70))
        assert np.abs(look.sun[:2]).min() > 0.08  # never along a street
        np.testing.assert_allclose(look.sun * look.sun_inverse, 1.0, rtol=1e-6)
        for colour in look[2:4] + look[5:7] + look[8:]:
            assert (np.asarray(colour) >= 0).all() and (np.asarray(colour) <= 1.5).all()
    azimuth = np.arctan2(*np.array([look.sun[:2] for look in looks]).T[::-1])
    assert len(set((azimuth // (np.pi / 2)).tolist())) == 4


def test_a_style_changes_the_town_but_not_its_roads():
    plain, styled = make_town(TownConfig()), make_town(TownConfig(style=2))
    np.testing.assert_array_equal(plain.road_x_m, styled.road_x_m)
    assert plain.boxes.shape != styled.boxes.shape or not np.allclose(plain.boxes, styled.boxes)
    tall, low = (max(NUMBERS, key=lambda n, sign=sign: sign * make_style(n).height) for sign in (1, -1))
    heights = [np.median(make_town(TownConfig(style=n)).boxes[:, 5]) for n in (low, 0, tall)]
    assert heights == sorted(heights)
    leafy, bare = (max(NUMBERS, key=lambda n, sign=sign: sign * make_style(n).trees) for sign in (1, -1))
    assert len(make_town(TownConfig(style=leafy)).trees) > 2 * len(make_town(TownConfig(style=bare)).trees)


def test_towns_of_all_styles_share_their_programs():
    camera = Camera()
    seen, sizes = [], []
    for style in (0, 1, 5):
        config = TownConfig(seed=5, style=style)
        town = make_town(config)
        route = make_route(town, config, 2, seed=0)
        arrays = jax.tree.map(jnp.asarray, town)
        seen.append(render(arrays, jnp.asarray(route.positions_m), jnp.asarray(route.yaw_rad), camera).rgb)
        sizes.append(_compose._cache_size())
    assert sizes[0] == sizes[1] == sizes[2]
    assert min(float(jnp.abs(seen[0] - other).mean()) for other in seen[1:]) > 0.02

"""Views in pieces: all of one shape, and put together what they were cut from."""

import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.world.town.layout import TownConfig, make_town
from ovibjax.world.town.pieces import PIECE_PX, cut, joined
from ovibjax.world.town.render import Camera, render


@pytest.mark.parametrize("size", [(1, 5, 60, 80), (2, 5, 48, 65), (3, 5, 96, 64)])
def test_pieces_put_together_are_the_whole(size):
    views, pixels = size[0] * size[1], size[2] * size[3]
    rng = np.random.default_rng(0)
    ray = [jnp.asarray(rng.normal(size=(views, pixels)).astype(np.float32)) for _ in range(3)]
    number = np.arange(views, dtype=np.float32)
    pieces = list(
        cut(jnp.asarray(number[:, None] + [0, 0, 0]), ray, jnp.asarray(number[:, None, None]), ray[0][:, None])
    )
    for starts, rays, boxes, trees in pieces:
        assert starts.shape == (40, 3) and {axis.shape for axis in rays} == {(40, PIECE_PX)}
        assert boxes.shape == (40, 1, 1) and trees.shape == (40, 1, pixels)
    for axis in range(3):
        np.testing.assert_array_equal(joined([piece[1][axis] for piece in pieces], size), ray[axis])
    # Every pixel meets the buildings of its own view.
    owner = joined([jnp.broadcast_to(boxes[:, 0], (40, PIECE_PX)) for _, _, boxes, _ in pieces], size)
    np.testing.assert_array_equal(owner, np.repeat(number[:, None], pixels, axis=1))


def test_a_large_view_shows_what_a_small_one_shows():
    town = make_town(TownConfig())
    at, yaw = jnp.array([[10.0, 4.0, 20.0]]), jnp.array([0.3])
    small, large = (render(town, at, yaw, Camera(48 * scale, 64 * scale)) for scale in (1, 3))
    # The middle of three pixels looks along the ray of the small one.
    np.testing.assert_allclose(np.asarray(large.depth_m)[:, :, 1::3, 1::3], np.asarray(small.depth_m), rtol=1e-3)
    # Textures are filtered by the pixel's size: at the edge of a marking the class may differ.
    assert (np.asarray(large.semantic)[:, :, 1::3, 1::3] == np.asarray(small.semantic)).mean() > 0.99

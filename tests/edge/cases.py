"""What the tests of the edge share."""

import numpy as np

from ovibjax.features.frames import make_feature_set


def some_frames(n, seed, n_views=4):
    """Frames in a room whose features vary smoothly with the position."""
    world, rng = np.random.default_rng(0), np.random.default_rng(seed)
    position = np.column_stack([rng.uniform(-2, 2, (n, 2)), np.full(n, 0.3)])
    features = np.sin(np.einsum("nk,kmd->nmd", position, world.normal(size=(3, n_views, 10))))
    return make_feature_set(features + 0.05 * rng.normal(size=features.shape), position)

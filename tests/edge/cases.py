"""What the tests of the edge share."""

import numpy as np

from ovibjax.encoder.model import Architecture
from ovibjax.encoder.train import TrainConfig
from ovibjax.encoder.training_data import member_data
from ovibjax.features.frames import make_feature_set

ARCH = Architecture(view_dim=6, latent=8, hidden=16, last_hidden=12, head=8)
STATIC = TrainConfig(arch=ARCH, prefixes=(2, 4, 8), steps=20, batch=32)
KS = (2, 5, 8)


def some_frames(n, seed, n_views=4):
    """Frames in a room whose features vary smoothly with the position."""
    world, rng = np.random.default_rng(0), np.random.default_rng(seed)
    position = np.column_stack([rng.uniform(-2, 2, (n, 2)), np.full(n, 0.3)])
    features = np.sin(np.einsum("nk,kmd->nmd", position, world.normal(size=(3, n_views, 10))))
    return make_feature_set(features + 0.05 * rng.normal(size=features.shape), position)


def two_members():
    """Data of seeds 0 and 1, on features that vary smoothly with the position."""
    rng = np.random.default_rng(0)
    position = rng.uniform(-50, 50, (240, 3)).astype(np.float32)
    features = np.tanh(position @ rng.normal(size=(3, 60)) / 30).reshape(240, 5, 12)
    feature_set = make_feature_set(features, position)
    return [member_data(feature_set, seed, 6)[0] for seed in (0, 1)]

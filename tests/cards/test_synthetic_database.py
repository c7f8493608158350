"""Recombined databases are made of real views."""

import numpy as np

from ovibjax.cards.synthetic_database import SCENE_FRAMES, recombine


def test_recombined_scenes_are_real_views_and_queries_are_no_references():
    rng = np.random.default_rng(0)
    drives = [np.cumsum(rng.normal(size=(120, 3, 8)), axis=0).astype(np.float32) for _ in range(3)]
    places = [np.cumsum(rng.normal(size=(120, 2)), axis=0).astype(np.float32) for _ in range(3)]
    made = recombine(4, drives, places, SCENE_FRAMES + 100, 30)
    assert made.reference.shape == (SCENE_FRAMES + 100, 8) and made.query.shape == (30, 8)
    assert set(made.scene) == {0, 1} and set(made.query_scene) <= {0, 1}
    assert np.abs(made.query[:, None] - made.reference[None]).max(axis=-1).min() > 0
    again = recombine(4, drives, places, SCENE_FRAMES + 100, 30)
    np.testing.assert_array_equal(made.reference, again.reference)

"""The data of a member: nothing of it that training sees depends on held-out frames."""

import jax
import numpy as np
import pytest

from ovibjax.encoder.training_data import member_data
from ovibjax.features.splits import split_indices
from tests.encoder.cases import smooth_frames


@pytest.fixture(scope="module")
def feature_set():
    return smooth_frames()


def test_nothing_is_fitted_on_held_out_frames(feature_set) -> None:
    split = split_indices(260, 1)
    held_out = np.concatenate([split.val, split.test])
    features, positions = feature_set.features.copy(), feature_set.positions_m.copy()
    features[held_out] = features[held_out][:, :, ::-1]
    positions[held_out] += 1000
    changed = feature_set._replace(features=features, positions_m=positions)
    (one, basis_one), (other, basis_other) = member_data(feature_set, 1, 6), member_data(changed, 1, 6)
    for a, b in zip(
        jax.tree.leaves((one.train, one.train_m, one.standardizer, basis_one)),
        jax.tree.leaves((other.train, other.train_m, other.standardizer, basis_other)),
        strict=True,
    ):
        np.testing.assert_array_equal(a, b)
    assert not np.array_equal(one.test_x, other.test_x)
    np.testing.assert_allclose(np.asarray(one.train.x).var(), 1.0, rtol=1e-3)
    np.testing.assert_allclose(np.asarray(one.train.y)[:, :2].var(axis=0).mean(), 1.0, rtol=1e-3)

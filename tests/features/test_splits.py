"""Splits: the paper's sizes, disjoint and complete, the same for the same seed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.errors import InputError
from ovibjax.features.frames import make_feature_set
from ovibjax.features.splits import require_frames, split_indices
from tests.features.cases import assert_refused, raw_features


def test_split_sizes_of_the_paper():
    assert [part.size for part in split_indices(4994, 0)] == [3495, 749, 750]


@given(st.integers(7, 5000), st.integers(0, 2**63))
@settings(max_examples=100, deadline=None)
def test_splits_are_disjoint_complete_sorted_and_repeatable(n, seed):
    split = split_indices(n, seed)
    np.testing.assert_array_equal(np.sort(np.concatenate(split)), np.arange(n))
    for part, again in zip(split, split_indices(n, seed), strict=True):
        assert part.size > 0 and (np.diff(part) > 0).all()
        np.testing.assert_array_equal(part, again)
    assert split.train.size == 7 * n // 10 and split.val.size == 15 * n // 100


def test_seeds_give_different_splits():
    parts = {split_indices(500, seed).test.tobytes() for seed in range(20)}
    assert len(parts) == 20


@pytest.mark.parametrize(("n", "seed", "word"), [(6, 0, "at least 7"), (-1, 0, "at least 7"), (500, -1, "seed -1")])
def test_bad_splits_are_refused(n, seed, word):
    with pytest.raises(InputError) as error:
        split_indices(n, seed)
    assert_refused(error, word)


def test_require_frames():
    fs = make_feature_set(raw_features(199), np.zeros((199, 3)))
    with pytest.raises(InputError) as error:
        require_frames(fs, source="town.npz")
    assert_refused(error, "town.npz", "199 frames", "at least 200")
    require_frames(fs, 199, "town.npz")

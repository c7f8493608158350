"""Training, validation and test frames of a feature set, drawn at random, and how many frames are enough for that."""

import operator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ovibjax.errors import refusal
from ovibjax.features.frames import FeatureSet

MIN_FRAMES = 200
"""Fewest frames worth splitting: 15 percent of them are 30 validation frames."""
MIN_REFERENCES, MIN_QUERIES = 20, 5
"""Fewest frames of the motion-capture protocol: five spatial folds of four references each, and a few queries."""

_SPLIT_STREAM = 0x5911  # keeps the split's draws apart from other uses of the same seed


class Split(NamedTuple):
    """Frame indices of the three parts, each ascending."""

    train: NDArray[np.int64]
    val: NDArray[np.int64]
    test: NDArray[np.int64]


def split_indices(n: int, seed: int) -> Split:
    """Random 70/15/15 split (paper, Section "Experimental Setup": 4,994 frames give 3,495/749/750).

    Args:
        n: number of frames, at least 7 so that no part is empty.
        seed: not negative; the same seed and n give the same split.

    Returns:
        Disjoint index arrays that cover 0..n-1.

    Raises:
        InputError: n or seed is too small.
    """
    n, seed = operator.index(n), operator.index(seed)
    if n < 7:
        raise refusal("split", f"{n} frames cannot be split 70/15/15; at least 7 are needed")
    if seed < 0:
        raise refusal("split", f"seed {seed} is negative; use 0 or more")
    order = np.random.default_rng([seed, _SPLIT_STREAM]).permutation(n)
    # Whole-number arithmetic: int(0.7 * 90) is 62.
    train, val = 70 * n // 100, 15 * n // 100
    return Split(*(np.sort(part) for part in np.split(order, [train, train + val])))


def require_frames(feature_set: FeatureSet, minimum: int = MIN_FRAMES, source: str = "array") -> None:
    """Refuse a set too small for a split to mean anything.

    Raises:
        InputError: fewer than `minimum` frames.
    """
    n = len(feature_set.features)
    if n < minimum:
        raise refusal(source, f"{n} frames, but at least {minimum} frames are needed; add frames")

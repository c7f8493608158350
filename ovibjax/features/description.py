"""A feature set in numbers: what the paper's table of data sets says of one, read off the data."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ovibjax.features.frames import CONTEXTS, FeatureSet
from ovibjax.features.sequence import sequence_of
from ovibjax.features.splits import Split


class Description(NamedTuple):
    """One scene, or all of them.

    Attributes:
        frames: number of frames.
        parts: training, validation and test frames.
        views: views per frame.
        dim: dimension of a view's feature.
        route_m: length of the drives in the order of the frames, breaks left out; NaN for places in no order.
        breaks: jumps between consecutive frames of a scene, over ten times the median step.
        spacing_m: median distance between consecutive frames, stops left out; NaN for places in no order.
        nearest_m: median distance from a test frame to the nearest training frame of its scene; NaN without either.
        extent_m: width along x, width along y, height range.
        context_share: share of frames per context of `CONTEXTS`, then of unknown context.
    """

    frames: int
    parts: tuple[int, int, int]
    views: int
    dim: int
    route_m: float
    breaks: int
    spacing_m: float
    nearest_m: float
    extent_m: tuple[float, float, float]
    context_share: tuple[float, ...]


def describe(feature_set: FeatureSet, split: Split, scene: int | None = None) -> Description:
    """Describe one scene of a feature set, or the whole.

    Args:
        feature_set: the set; consecutive frames of a scene are taken as consecutive in time.
        split: the split of the whole set.
        scene: a scene id; None takes all scenes together, distances still within scenes.

    Returns:
        The description.
    """
    scenes = np.unique(feature_set.scene_id) if scene is None else np.array([scene])
    members = [np.flatnonzero(feature_set.scene_id == one) for one in scenes]
    rows = np.concatenate(members)
    order = sequence_of(feature_set.positions_m[rows], feature_set.scene_id[rows])
    train, val, test = (int(np.isin(part, rows).sum()) for part in split)
    nearest = np.concatenate([_nearest_m(feature_set, split, one) for one in members])
    context = feature_set.context[rows]
    codes = [*range(len(CONTEXTS)), -1]
    spans = [np.ptp(feature_set.positions_m[one], axis=0) for one in members]
    return Description(
        frames=len(rows),
        parts=(train, val, test),
        views=feature_set.features.shape[1],
        dim=feature_set.features.shape[2],
        route_m=order.length_m if order.is_drive else float("nan"),
        breaks=order.jumps,
        spacing_m=order.step_m if order.is_drive else float("nan"),
        nearest_m=float(np.median(nearest)) if nearest.size else float("nan"),
        extent_m=(*np.max(spans, axis=0).tolist(),),
        context_share=tuple(float((context == code).mean()) for code in codes),
    )


def _nearest_m(feature_set: FeatureSet, split: Split, rows: NDArray[np.int64]) -> NDArray[np.float64]:
    """Distance from each test frame among `rows` to the nearest training frame among them."""
    train, test = (feature_set.positions_m[np.intersect1d(part, rows)] for part in (split.train, split.test))
    if not len(train) or not len(test):
        return np.empty(0)
    return np.asarray(cKDTree(train).query(test)[0], np.float64)

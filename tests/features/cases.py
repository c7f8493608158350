"""Small feature sets, folders of them, and what a refusal looks like."""

from pathlib import Path

import numpy as np
import pytest

from ovibjax.features.frames import FeatureSet, make_feature_set
from ovibjax.views import VIEWS


def raw_features(n=6, views=5, dim=8, seed=0):
    return np.random.default_rng(seed).normal(size=(n, views, dim)).astype(np.float32)


def example(n=6, views=5, dim=8):
    return make_feature_set(
        raw_features(n, views, dim),
        np.arange(3 * n, dtype=np.float32).reshape(n, 3),
        yaw_rad=np.linspace(-3, 3, n),
        context=np.arange(n) % 4 - 1,
        scene_id=np.arange(n) // 2,
        frame_id=[f"frame {i}" for i in range(n)],
    )


def assert_same(left: FeatureSet, right: FeatureSet) -> None:
    for name, a, b in zip(FeatureSet._fields, left, right, strict=True):
        assert a.dtype == b.dtype, name
        np.testing.assert_array_equal(a, b, strict=True, err_msg=name)


def assert_refused(error: pytest.ExceptionInfo, *words: str) -> None:
    message = str(error.value)
    assert len(message.splitlines()) == 1 and message.isprintable(), message
    for word in words:
        assert word in message, (word, message)


def listing(folder: Path) -> list[str]:
    return sorted(file.name for file in folder.iterdir())


def write_view_folder(root, n=4, dim=8, cameras=VIEWS, one_row=False, flat=False):
    features = raw_features(n, len(cameras), dim)
    for view, camera in enumerate(cameras):
        (root / camera).mkdir(parents=True)
        for frame in range(n):
            feature = features[frame, view][None] if one_row else features[frame, view]
            position = np.array([frame, 2.0, 3.0])[: 2 if flat else 3]
            np.savez_compressed(root / camera / f"{frame:06d}.npz", feature=feature, position=position)
    return features

"""The data of one member: a feature set split by seed, in the per-view basis of its training part."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.encoder.train import TrainData
from ovibjax.features.basis import ViewBasis, fit_basis, project
from ovibjax.features.frames import FeatureSet
from ovibjax.features.splits import split_indices


class Standardizer(NamedTuple):
    """Affine map between metres and the scale positions are trained in.

    Attributes:
        mean_m: [3] mean training position.
        scale_m: scalar, standard deviation of a horizontal coordinate.
    """

    mean_m: jax.Array
    scale_m: jax.Array


class MemberData(NamedTuple):
    """Everything a member sees, split by seed.

    Attributes:
        train: training data; its features are also the reference database of retrieval.
        train_m: [N, 3] training positions, m.
        val_x: [V, M, r] validation features.
        val_m: [V, 3] validation positions, m.
        test_x: [T, M, r] test features.
        test_m: [T, 3] test positions, m.
        standardizer: map between standardised and metric positions.
    """

    train: TrainData
    train_m: jax.Array
    val_x: jax.Array
    val_m: jax.Array
    test_x: jax.Array
    test_m: jax.Array
    standardizer: Standardizer


def member_data(feature_set: FeatureSet, seed: int, rank: int | None = 64) -> tuple[MemberData, ViewBasis]:
    """Split 70/15/15 by seed, fit the per-view basis on the training part, and project everything.

    Args:
        feature_set: unit-norm features with positions.
        seed: the split.
        rank: coordinates kept per view; None keeps all d.

    Returns:
        The member's arrays and its basis.
    """
    split = split_indices(len(feature_set.features), seed)
    basis = fit_basis(feature_set.features[split.train], rank)
    train_m = feature_set.positions_m[split.train]
    mean = train_m.mean(axis=0)
    scale = np.float32(max(float(np.sqrt(np.mean((train_m - mean)[:, :2] ** 2))), 1e-6))
    coordinates = {name: project(basis, feature_set.features[rows]) for name, rows in split._asdict().items()}
    train = TrainData(
        x=jnp.asarray(coordinates["train"]),
        y=jnp.asarray((train_m - mean) / scale),
    )
    member = MemberData(
        train=train,
        train_m=jnp.asarray(train_m),
        val_x=jnp.asarray(coordinates["val"]),
        val_m=jnp.asarray(feature_set.positions_m[split.val]),
        test_x=jnp.asarray(coordinates["test"]),
        test_m=jnp.asarray(feature_set.positions_m[split.test]),
        standardizer=Standardizer(jnp.asarray(mean), jnp.asarray(scale)),
    )
    return member, basis

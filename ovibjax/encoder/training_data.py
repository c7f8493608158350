"""The data of one member: a feature set split by seed, in the per-view basis of its training part."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.encoder.train import TrainData
from ovibjax.features.basis import ViewBasis, fit_basis, project
from ovibjax.features.frames import FeatureSet
from ovibjax.features.places import from_origin, origin_of
from ovibjax.features.splits import split_indices


class Standardizer(NamedTuple):
    """Map between metres and the scale in which positions are trained.

    Attributes:
        mean_m: [3] mean training position, from the origin of the data.
        scale_m: scalar, standard deviation of a horizontal coordinate.
    """

    mean_m: jax.Array
    scale_m: jax.Array


def mean_and_scale(positions_m: np.ndarray) -> tuple[np.ndarray, np.float32]:
    """Fields of the `Standardizer` of training positions.

    Args:
        positions_m: [N, 3] metres.

    Returns:
        [3] mean, and the standard deviation of a horizontal coordinate, not zero.
    """
    mean_m = positions_m.mean(axis=0)
    return mean_m, np.float32(max(float(np.sqrt(np.mean((positions_m - mean_m)[:, :2] ** 2))), 1e-6))


class MemberData(NamedTuple):
    """Everything that training and judging one member sees, split by seed.

    Attributes:
        train: training data; its features are also the reference database of retrieval.
        train_m: [N, 3] training positions from the origin, m; so are the others.
        val_x: [V, M, r] validation features.
        val_m: [V, 3] validation positions, m.
        test_x: [T, M, r] test features.
        test_m: [T, 3] test positions, m.
        standardizer: map between standardised and metric positions.
        origin_m: [3] what positions are counted from, see `features.places`; exact in float32.
    """

    train: TrainData
    train_m: jax.Array
    val_x: jax.Array
    val_m: jax.Array
    test_x: jax.Array
    test_m: jax.Array
    standardizer: Standardizer
    origin_m: jax.Array


def member_data(feature_set: FeatureSet, seed: int, rank: int | None = 64) -> tuple[MemberData, ViewBasis]:
    """Training, validation and test data of one seed: a 70/15/15 split, in the basis of its training part.

    Args:
        feature_set: unit-norm features [N, M, d] with positions.
        seed: the split.
        rank: coordinates r kept per view; None keeps all d.

    Returns:
        The member's arrays and its per-view basis.
    """
    split = split_indices(len(feature_set.features), seed)
    basis = fit_basis(feature_set.features[split.train], rank)
    origin_m = origin_of(feature_set.positions_m)
    places_m = from_origin(feature_set.positions_m, origin_m)
    train_m = places_m[split.train]
    mean_m, scale_m = mean_and_scale(train_m)
    coordinates = {name: project(basis, feature_set.features[rows]) for name, rows in split._asdict().items()}
    train = TrainData(
        x=jnp.asarray(coordinates["train"]),
        y=jnp.asarray((train_m - mean_m) / scale_m),
    )
    member = MemberData(
        train=train,
        train_m=jnp.asarray(train_m),
        val_x=jnp.asarray(coordinates["val"]),
        val_m=jnp.asarray(places_m[split.val]),
        test_x=jnp.asarray(coordinates["test"]),
        test_m=jnp.asarray(places_m[split.test]),
        standardizer=Standardizer(jnp.asarray(mean_m), jnp.asarray(scale_m)),
        origin_m=jnp.asarray(origin_m, jnp.float32),
    )
    return member, basis

"""References and queries of the motion-capture protocol (paper, "Real-Scene Multi-Platform Evaluation").

The references are the database. One spatial fold of them is held out to stop training early and to choose the mixing
weight of each prefix; the rest trains the encoder.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.edge.view_fusion import spatial_folds
from ovibjax.encoder.training_data import Standardizer, mean_and_scale
from ovibjax.features.basis import fit_basis, project
from ovibjax.features.frames import FeatureSet
from ovibjax.features.places import from_origin, origin_of


class References(NamedTuple):
    """The database and all that is learnt from.

    Attributes:
        features: [R, M, d] unit-norm features.
        x: [R, M, r] the same in the per-view basis of the training rows, unit variance overall.
        positions_m: [R, 3] from the origin.
        folds: [R] int32 spatial fold.
        train: [T] int32 rows that train the encoder.
        val: [V] int32 rows of the first fold.
        standardizer: between standardised and metric positions.
        origin_m: [3] what positions are counted from, see `features.places`; exact in float32.
    """

    features: jax.Array
    x: jax.Array
    positions_m: jax.Array
    folds: jax.Array
    train: jax.Array
    val: jax.Array
    standardizer: Standardizer
    origin_m: jax.Array


class Queries(NamedTuple):
    """What is localized.

    Attributes:
        features: [Q, M, d] unit-norm features.
        x: [Q, M, r] the same in the references' basis.
        positions_m: [Q, 3] from the references' origin.
    """

    features: jax.Array
    x: jax.Array
    positions_m: jax.Array


def scene_data(references: FeatureSet, queries: FeatureSet, rank: int | None) -> tuple[References, Queries]:
    """The data of one scene: references split by place, and queries, in the basis of the training references.

    Args:
        references: at least `splits.MIN_REFERENCES` frames.
        queries: frames of the same platform and backbone.
        rank: coordinates kept per view, at most half the training frames; None keeps all d.

    Returns:
        References and queries; nothing in the former depends on the latter but the origin that both are counted from.
    """
    origin_m = origin_of(references.positions_m, queries.positions_m)
    places_m = from_origin(references.positions_m, origin_m)
    folds = spatial_folds(places_m)
    train, val = np.flatnonzero(folds != 0), np.flatnonzero(folds == 0)
    kept = None if rank is None else max(2, min(rank, len(train) // 2))
    basis = fit_basis(references.features[train], kept)
    mean_m, scale_m = mean_and_scale(places_m[train])
    made = References(
        features=jnp.asarray(references.features),
        x=jnp.asarray(project(basis, references.features)),
        positions_m=jnp.asarray(places_m),
        folds=jnp.asarray(folds),
        train=jnp.asarray(train, jnp.int32),
        val=jnp.asarray(val, jnp.int32),
        standardizer=Standardizer(jnp.asarray(mean_m), jnp.asarray(scale_m)),
        origin_m=jnp.asarray(origin_m, jnp.float32),
    )
    asked = (queries.features, project(basis, queries.features), from_origin(queries.positions_m, origin_m))
    return made, Queries(*map(jnp.asarray, asked))

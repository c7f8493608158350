"""Localizing in a room from a few dozen references: the motion-capture protocol (paper, "Real-Scene Multi-Platform
Evaluation").

`learn` sees the references only: it trains the encoder with early stopping, chooses a mixing weight per prefix and
calibrates the view fusion. `answer` uses the queries, once.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.edge.indoor_data import Queries, References
from ovibjax.edge.localize import errors, mix, select_eta
from ovibjax.edge.retrieval import brute_force
from ovibjax.edge.view_fusion import calibrate, fold_error_m, fold_similarity, fused_descriptor, kept_weights
from ovibjax.encoder.early_stopping import fit_early
from ovibjax.encoder.loss import LR, make_hypers, prefix_mask
from ovibjax.encoder.model import Params, decode, encode, locate
from ovibjax.encoder.train import TrainConfig, TrainData
from ovibjax.views import full_mode, mode_mask, modes_for


class Learned(NamedTuple):
    """What `learn` takes from the references.

    Attributes:
        params: the network at its best checkpoint.
        eta: [modes, prefixes] mixing weights.
        val_m: [modes, prefixes] mean validation errors with them.
        weights: [M] view-fusion weights.
        metrics: loss and terms [epochs], `score` [checkpoints], `best`.
    """

    params: Params
    eta: jax.Array
    val_m: jax.Array
    weights: jax.Array
    metrics: dict[str, jax.Array]


@dataclass(frozen=True)
class Protocol:
    """Learn from the references and localize the queries: a member function for `sweep.run`; hashable.

    Attributes:
        static: architecture, steps.
        prefixes: prefix lengths to judge at.
        checkpoints: of early stopping.
        lr: peak learning rate.
        weight_decay: decoupled weight decay.
    """

    static: TrainConfig
    prefixes: tuple[int, ...]
    checkpoints: int
    lr: float = LR
    weight_decay: float = 0.5

    @property
    def modes(self) -> tuple[str, ...]:
        """View modes of the platform."""
        return modes_for(self.static.arch.n_views)

    def __call__(
        self, key: jax.Array, point: dict[str, jax.Array], scene: tuple[References, Queries]
    ) -> dict[str, Any]:
        """Learn from the references and localize the queries.

        Args:
            key: the training seed's key.
            point: ignored.
            scene: references and queries.

        Returns:
            Errors per query in metres: `ovib_m`, `regression_m` [modes, prefixes, Q], `raw_m` [modes, Q],
            `floor_m` [Q]; of what was learnt: `eta` and `val_m` [modes, prefixes], `weights` [M], `fold_m` and
            `fold_uniform_m` (mean fold errors with calibrated and with equal weights), `score` [checkpoints], `best`.
        """
        references, queries = scene
        learned = learn(key, references, self)
        n_views = self.static.arch.n_views
        similarity, allowed = fold_similarity(references.features, references.folds)
        distance_m = errors(references.positions_m[:, None], references.positions_m[None])
        uniform = jnp.full(n_views, 1.0 / n_views, jnp.float32)
        return {
            **answer(learned, references, queries, self),
            "eta": learned.eta,
            "val_m": learned.val_m,
            "weights": learned.weights,
            "fold_m": fold_error_m(learned.weights, similarity, allowed, distance_m),
            "fold_uniform_m": fold_error_m(uniform, similarity, allowed, distance_m),
            "score": learned.metrics["score"],
            "best": learned.metrics["best"],
        }


DIMS: dict[str, tuple[str, ...]] = {
    "ovib_m": ("mode", "prefix", "query"),
    "regression_m": ("mode", "prefix", "query"),
    "raw_m": ("mode", "query"),
    "floor_m": ("query",),
    "eta": ("mode", "prefix"),
    "val_m": ("mode", "prefix"),
    "weights": ("view",),
    "score": ("checkpoint",),
}
"""Trailing dimensions of the protocol's outputs."""


def learn(key: jax.Array, references: References, protocol: Protocol) -> Learned:
    """Train the encoder with early stopping, choose the mixing weights, calibrate the view fusion.

    Args:
        key: the training seed's key.
        references: the only data.
        protocol: static choices.

    Returns:
        What answering needs.
    """
    arch = protocol.static.arch
    train_m = references.positions_m[references.train]
    centre, scale = references.standardizer
    data = TrainData(references.x[references.train], (train_m - centre[None]) / scale)
    val_m = references.positions_m[references.val]
    prefixes = jnp.array(protocol.prefixes, jnp.int32)
    masks = jnp.stack([mode_mask(mode, arch.n_views) for mode in protocol.modes])

    def validate(params: Params, mask: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Mixing weight and mean error of each prefix, of validation frames against training frames."""
        x = references.x[references.val]
        reg, ret = _estimates(params, references, x, references.train, mask, prefixes, protocol)
        eta = jax.vmap(select_eta, in_axes=(0, 0, None))(reg, ret, val_m)
        est = jax.vmap(mix)(reg, ret, eta)
        return eta, jnp.mean(errors(est, val_m[None]), axis=1)

    whole = mode_mask(full_mode(arch.n_views), arch.n_views)
    params, metrics = fit_early(
        key,
        make_hypers(lr=protocol.lr, weight_decay=protocol.weight_decay),
        data,
        protocol.static,
        lambda params: jnp.mean(validate(params, whole)[1]),
        protocol.checkpoints,
    )
    eta, error_m = jax.lax.map(lambda mask: validate(params, mask), masks)
    weights = calibrate(references.features, references.positions_m, references.folds)
    return Learned(params, eta, error_m, weights, metrics)


def answer(learned: Learned, references: References, queries: Queries, protocol: Protocol) -> dict[str, jax.Array]:
    """Localize the queries against the whole database, by O-VIB and by calibrated retrieval of raw features.

    Args:
        learned: from the references.
        references: the database.
        queries: used here and nowhere else.
        protocol: static choices.

    Returns:
        Errors in metres, see `Protocol.__call__`.
    """
    n_views = protocol.static.arch.n_views
    prefixes = jnp.array(protocol.prefixes, jnp.int32)
    masks = jnp.stack([mode_mask(mode, n_views) for mode in protocol.modes])
    everything = jnp.arange(references.x.shape[0])
    truth_m = queries.positions_m

    def one(item: tuple[jax.Array, jax.Array]) -> dict[str, jax.Array]:
        mask, eta = item
        reg, ret = _estimates(learned.params, references, queries.x, everything, mask, prefixes, protocol)
        weights = kept_weights(learned.weights, mask)
        found = brute_force(fused_descriptor(queries.features, weights), fused_descriptor(references.features, weights))
        return {
            "ovib_m": errors(jax.vmap(mix)(reg, ret, eta), truth_m[None]),
            "regression_m": errors(reg, truth_m[None]),
            "raw_m": errors(references.positions_m[found], truth_m),
        }

    out: dict[str, jax.Array] = jax.lax.map(one, (masks, learned.eta))
    return {**out, "floor_m": jnp.min(errors(truth_m[:, None], references.positions_m[None]), axis=1)}


def _estimates(
    params: Params,
    references: References,
    x: jax.Array,
    rows: jax.Array,
    mask: jax.Array,
    prefixes: jax.Array,
    protocol: Protocol,
) -> tuple[jax.Array, jax.Array]:
    """Regressed and retrieved positions [P, B, 3] of frames x [B, M, r] at each prefix; `rows` are the database."""
    arch = protocol.static.arch
    wide = jnp.repeat(mask, arch.view_dim)[None]
    mu, _ = encode(params, x.reshape(x.shape[0], -1) * wide, arch)
    database = references.x[rows].reshape(rows.shape[0], -1) * wide
    centre, scale = references.standardizer

    def one(k: jax.Array) -> tuple[jax.Array, jax.Array]:
        descriptor = decode(params, mu, prefix_mask(k, arch.latent), arch) * wide
        reg = centre[None] + scale * locate(params, descriptor, arch)
        return reg, references.positions_m[rows][brute_force(descriptor, database)]

    return jax.vmap(one)(prefixes)

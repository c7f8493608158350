"""Realised residuals of every action, and the predictor g_psi (paper, "Local Belief and Predicted Edge Gain").

A label-free checkpoint is trained by masked reconstruction on the first frames of a training route: the objective
without its localization term, view modes and prefixes sampled. The edge keeps a survey of the scene encoded by the
same checkpoint; leave-one-out retrieval against it gives the residual of each frame and action. g_psi is the median
residual on training routes by context and action.
"""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.control.actions import ActionSet
from ovibjax.edge.retrieval import leave_one_out
from ovibjax.encoder.loss import make_hypers
from ovibjax.encoder.model import Architecture, Params, decode, encode
from ovibjax.encoder.train import TrainConfig, TrainData, fit
from ovibjax.features.basis import ViewBasis, fit_basis, project
from ovibjax.views import mode_mask, modes_for

CHECKPOINT_PREFIXES = (16, 32, 35, 64, 128)
TRAIN_FRAMES = 356


@dataclass(frozen=True)
class CheckpointConfig:
    """Static choices of the checkpoint; hashable.

    Attributes:
        rank: principal coordinates kept per view; few, because few frames are seen.
        steps: training steps.
        batch: examples per step.
        prefixes: prefix lengths trained on.
        mixed: examples made by mixing frames, see `mix_frames`; 0 for none.
        hidden: width of the first encoder and last decoder layer.
        last_hidden: width of the layer before the latent mean.
    """

    rank: int = 32
    steps: int = 600
    batch: int = 128
    prefixes: tuple[int, ...] = CHECKPOINT_PREFIXES
    mixed: int = 8192
    hidden: int = 256
    last_hidden: int = 128


class Checkpoint(NamedTuple):
    """A trained encoder with the basis of its input.

    Attributes:
        params: network parameters.
        basis: per-view basis.
        arch: widths of the network.
    """

    params: Params
    basis: ViewBasis
    arch: Architecture


_fit = jax.jit(fit, static_argnames="static")


def train_checkpoint(key: jax.Array, features: np.ndarray, config: CheckpointConfig) -> Checkpoint:
    """Train by masked reconstruction alone; no position is seen.

    Args:
        key: random key.
        features: [N, M, d] unit-norm view features of the training frames.
        config: static choices.

    Returns:
        The checkpoint.
    """
    key_mix, key_fit = jax.random.split(key)
    basis = fit_basis(features, config.rank)
    x = mix_frames(key_mix, jnp.asarray(project(basis, features)), config.mixed)
    arch = Architecture(
        n_views=x.shape[1],
        view_dim=x.shape[2],
        latent=max(config.prefixes),
        hidden=config.hidden,
        last_hidden=config.last_hidden,
    )
    static = TrainConfig(arch=arch, prefixes=config.prefixes, steps=config.steps, batch=config.batch)
    no_labels = jnp.zeros((len(x), 3), jnp.float32)
    params, _ = _fit(key_fit, make_hypers(alpha=0.0, lr=2e-3), TrainData(x, no_labels), static)
    return Checkpoint(params, basis, arch)


def mix_frames(key: jax.Array, x: jax.Array, count: int) -> jax.Array:
    """Frames, and mixtures x_i + e (x_j - x_k) of three of them, e uniform in [0, 1].

    A network trained on a few hundred frames alone reproduces those and maps the rest of the scene onto them; mixtures
    ask it for the directions in which frames differ. No label is involved.

    Args:
        key: random key.
        x: [N, M, r] features.
        count: mixtures to add.

    Returns:
        [N + count, M, r].
    """
    if count == 0:
        return x
    key_rows, key_weight = jax.random.split(key)
    i, j, k = jax.random.randint(key_rows, (3, count), 0, x.shape[0])
    weight = jax.random.uniform(key_weight, (count, 1, 1))
    return jnp.concatenate([x, x[i] + weight * (x[j] - x[k])])


def survey(positions_m: np.ndarray, drive: np.ndarray, spacing_m: float) -> np.ndarray:
    """Frames that a survey of the scene keeps as references: one every so many metres of each drive.

    Args:
        positions_m: [N, 3] positions along the drives.
        drive: [N] which drive a frame belongs to.
        spacing_m: distance between kept frames; 0 keeps all.

    Returns:
        Ascending rows.
    """
    step_m = np.linalg.norm(np.diff(positions_m, axis=0, prepend=positions_m[:1]), axis=1)
    kept = []
    since = np.inf
    for row in range(len(positions_m)):
        new_drive = row > 0 and drive[row] != drive[row - 1]
        since = np.inf if new_drive else since + step_m[row]
        if since >= spacing_m:
            kept.append(row)
            since = 0.0
    return np.array(kept)


def residuals_m(
    checkpoint: Checkpoint, features: np.ndarray, positions_m: np.ndarray, references: np.ndarray, actions: ActionSet
) -> np.ndarray:
    """Realised residual of every frame and action: error of leave-one-out retrieval.

    Args:
        checkpoint: the encoder.
        features: [N, M, d] features of all frames of the scene.
        positions_m: [N, 3] their positions.
        references: rows that are in the edge's database.
        actions: modes and prefixes.

    Returns:
        [N, A, 2] horizontal error of the retrieved position, m.
    """
    x = jnp.asarray(project(checkpoint.basis, features).reshape(len(features), -1))
    own = np.full(len(features), -1, np.int32)
    own[references] = np.arange(len(references))
    found = np.asarray(
        _retrieve(checkpoint.params, x, jnp.asarray(references), jnp.asarray(own), checkpoint.arch, actions)
    )
    places = positions_m[references][:, :2]
    return (places[found].transpose(1, 0, 2) - positions_m[:, None, :2]).astype(np.float32)


@partial(jax.jit, static_argnames=("arch", "actions"))
def _retrieve(
    params: Params, x: jax.Array, references: jax.Array, own: jax.Array, arch: Architecture, actions: ActionSet
) -> jax.Array:
    """[A, N] retrieved rows of the database."""
    masks = jnp.stack([mode_mask(mode, arch.n_views) for mode in actions.modes for _ in actions.prefixes])

    def one(action: tuple[jax.Array, jax.Array]) -> jax.Array:
        view_mask, k = action
        return retrieve(params, encode_views(params, x, view_mask, arch), view_mask, k, references, own, arch)

    return jax.lax.map(one, (masks, jnp.asarray(actions.prefix)))


def encode_views(params: Params, x: jax.Array, view_mask: jax.Array, arch: Architecture) -> jax.Array:
    """Latent means [N, K] of frames x [N, M r] of which only the views of a mode [M] are seen."""
    return encode(params, x * jnp.repeat(view_mask, arch.view_dim)[None], arch)[0]


def retrieve(
    params: Params,
    mu: jax.Array,
    view_mask: jax.Array,
    k: jax.Array,
    references: jax.Array,
    own: jax.Array,
    arch: Architecture,
) -> jax.Array:
    """Leave-one-out retrieval of a prefix of every frame against the survey, encoded alike.

    Args:
        params: network parameters.
        mu: [N, K] latent means, see `encode_views`.
        view_mask: [M] views of the mode.
        k: prefix length.
        references: [R] rows that are in the database.
        own: [N] a frame's position in the database, or -1.
        arch: widths of the network (static).

    Returns:
        [N] int32 retrieved positions in the database.
    """
    prefix = (jnp.arange(arch.latent) < k).astype(jnp.float32)
    descriptor = decode(params, mu * prefix[None], arch) * jnp.repeat(view_mask, arch.view_dim)[None]
    return leave_one_out(descriptor, descriptor[references], own)


def fit_predictor(residual_m: np.ndarray, context: np.ndarray, n_contexts: int) -> np.ndarray:
    """g_psi: median residual on training routes by context and action (paper, eq. "edge_risk").

    Args:
        residual_m: [N, A] realised residuals of training frames, m.
        context: [N] context of each.
        n_contexts: number of contexts.

    Returns:
        [n_contexts, A] metres; a context that training never met has the median over all.
    """
    rows = [residual_m[context == c] for c in range(n_contexts)]
    return np.stack([np.median(r if len(r) else residual_m, axis=0) for r in rows]).astype(np.float32)


def actions_for(n_views: int, actions: ActionSet) -> ActionSet:
    """The actions that a platform with so many views has."""
    return ActionSet(tuple(mode for mode in actions.modes if mode in modes_for(n_views)), actions.prefixes)

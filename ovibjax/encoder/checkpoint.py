"""An encoder trained without labels, by rebuilding what it was not shown (paper, Section "View-Rate Selection").

The checkpoint of the request-control study sees the first frames of a training route and no position: the objective
without its localization term, view modes and prefixes sampled.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.encoder.loss import make_hypers
from ovibjax.encoder.model import Architecture, Params
from ovibjax.encoder.train import TrainConfig, TrainData, fit
from ovibjax.features.basis import ViewBasis, fit_basis, project

CHECKPOINT_PREFIXES = (16, 32, 35, 64, 128)
"""Prefix lengths that the paper's prefix checkpoint is trained at."""

CHECKPOINT_RANK = 5
"""Principal coordinates kept per view: few, as 356 frames of one drive show few directions in which the rest of a scene
differs. Chosen on training routes that the checkpoint has not seen, by the share of answers in another place (18 m away
or more), over all actions and with uncompressed references: 23, 20, 18, 22, 24, 21, 29 and 38 % with 3, 4, 5, 6, 8, 10,
16 and 32 coordinates. What they leave out of a view is in neither request nor reference."""

TRAIN_FRAMES = 356
"""Frames that it is trained on: 000000 to 000355."""


@dataclass(frozen=True)
class CheckpointConfig:
    """Static choices of the checkpoint; hashable.

    Attributes:
        rank: principal coordinates kept per view.
        steps: training steps.
        batch: examples per step.
        prefixes: prefix lengths trained on.
        mixed: examples made by mixing frames, see `mix_frames`; 0 for none.
        hidden: width of the first encoder and last decoder layer.
        last_hidden: width of the layer before the latent mean.
    """

    rank: int = CHECKPOINT_RANK
    steps: int = 600
    batch: int = 128
    prefixes: tuple[int, ...] = CHECKPOINT_PREFIXES
    mixed: int = 8192
    hidden: int = 256
    last_hidden: int = 128


CHECKPOINT = CheckpointConfig()
"""The checkpoint of the request-control study."""


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
    params, _ = _fit(key_fit, make_hypers(alpha=0.0), TrainData(x, no_labels), static)
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

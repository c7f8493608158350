"""Training of the O-VIB encoder as one pure function, to be vmapped over hyperparameters and seeds.

Randomness follows the seed alone: minibatch order, view modes, prefixes and noise are the same for every member
that shares a key, so members that differ in their hyperparameters are paired, and under `vmap` their first layer
is one large matrix product over a shared minibatch.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from ovibjax.encoder.bits import with_bits
from ovibjax.encoder.epochs import Epoch, State, make_epoch, make_optimizer, schedule_of
from ovibjax.encoder.linear_start import linear_paths, linear_start, principal_encoder
from ovibjax.encoder.loss import Batch, Hypers, composite_loss
from ovibjax.encoder.model import Architecture, Params, init
from ovibjax.encoder.recipe import (
    PAPER_BATCH,
    PAPER_EPOCHS,
    PAPER_PREFIXES,
    SHORTEST_FOR_BITS,
    training_prefixes,
)
from ovibjax.views import MODES, modes_for


@dataclass(frozen=True)
class TrainConfig:
    """Static choices of a training run; hashable.

    Attributes:
        arch: widths of the network.
        prefixes: prefix lengths drawn per example, as often as they stand here; one length makes a fixed-rate model.
        modes: view modes trained on, in equal shares of every batch; all that the platform supports by default.
        prior: "gaussian" (scalable model), "ard" (fixed-rate model), or "bits" (rounded codes, see `bits`).
        steps: optimizer steps, rounded up to whole epochs; by the number of examples if None (`recipe`).
        batch: examples per step, at most the number of training examples.
        warmup: steps of linear warm-up before the linear decay.
        clip: norm that gradients are scaled down to; none if None.
        linear_lr: learning rate of the linear paths, as a share of the others': they start where they should be, and
            long prefixes rest on them.
        precision: type of the operands of the network's products, "float32" or "bfloat16".
    """

    arch: Architecture = field(default_factory=Architecture)
    prefixes: tuple[int, ...] = field(default_factory=training_prefixes)
    modes: tuple[str, ...] | None = None
    prior: str = "gaussian"
    steps: int | None = None
    batch: int = 128
    warmup: int = 200
    clip: float | None = 1.0
    linear_lr: float = 0.05
    precision: str = "float32"

    def steps_on(self, n: int) -> int:
        """Steps that are taken on n training examples: whole epochs."""
        _, per_epoch, epochs = schedule_of(self.steps, self.batch, n)
        return per_epoch * epochs


def fixed_rate(static: TrainConfig, latent: int) -> TrainConfig:
    """The fixed-rate model of the conference version: one code length K, the ARD prior (paper, eq. "ardkl").

    Args:
        static: the scalable model's choices.
        latent: latent dimension K, the only prefix.

    Returns:
        The same choices otherwise, but that the linear paths learn as fast as the rest: there is no longer prefix to
        keep them for, and the ARD prior prunes coordinates of theirs.
    """
    return replace(static, arch=replace(static.arch, latent=latent), prefixes=(latent,), prior="ard", linear_lr=1.0)


def for_bits(static: TrainConfig) -> TrainConfig:
    """The scalable model trained for bits, see `bits`: rounded codes that pay for what is sent.

    Chosen on tuning seed 0 at 2,000 steps: with all lengths of the recipe and slow linear paths, 12 coordinates in 7.4
    bytes leave 6.9 m; without lengths below 8, 6.0 m in 7.3; with linear paths that learn as fast as the rest, whose
    spread a price per bit must be able to change, 5.2 m in 7.0.

    Args:
        static: the scalable model's choices.

    Returns:
        The same choices otherwise.
    """
    prefixes = tuple(k for k in static.prefixes if k >= min(SHORTEST_FOR_BITS, static.arch.latent))
    return replace(static, prefixes=prefixes, prior="bits", linear_lr=1.0)


def paper_recipe(static: TrainConfig, n: int) -> TrainConfig:
    """The recipe that the paper states, taken literally (Section "Experimental Setup"); `recipe.PAPER_LR` goes with it.

    A dense network, not started from principal components, the paper's prefixes drawn evenly, 50 epochs of batches of
    512. What the paper does not say (hidden widths, warm-up, decay, clipping) stays as in the recipe.

    Args:
        static: the recipe.
        n: training examples.

    Returns:
        The static choices.
    """
    latent = static.arch.latent
    return replace(
        static,
        arch=replace(static.arch, kind="dense"),
        prefixes=tuple(min(k, latent) for k in PAPER_PREFIXES),
        steps=PAPER_EPOCHS * (n // min(PAPER_BATCH, n)),
        batch=PAPER_BATCH,
    )


class TrainData(NamedTuple):
    """What one member learns from.

    Attributes:
        x: [N, M, r] features, centred, unit variance overall.
        y: [N, 3] standardised positions.
    """

    x: jax.Array
    y: jax.Array


def view_rows(static: TrainConfig, size: int) -> tuple[np.ndarray, tuple[int, ...]]:
    """Share out a batch among the view modes, those with the most views first.

    Args:
        static: modes and views.
        size: examples B; a multiple of the number of modes gives exactly equal shares.

    Returns:
        [B, M] view masks, and per view the number of leading rows that have it (modes are nested).

    Raises:
        ValueError: a mode that the platform does not support.
    """
    n_views = static.arch.n_views
    supported = modes_for(n_views)
    for mode in static.modes or ():
        if mode not in supported:
            raise ValueError(f"view mode {mode!r} is not one of {', '.join(supported)}")
    modes = sorted(static.modes or supported, key=lambda mode: -len(MODES[mode]))
    table = np.array([np.isin(np.arange(n_views), MODES[mode]) for mode in modes], np.float32)
    masks = table[np.arange(size) * len(modes) // size]
    return masks, tuple(int(count) for count in masks.sum(axis=0))


def sample_batch(key: jax.Array, index: jax.Array, data: TrainData, static: TrainConfig) -> Batch:
    """A minibatch: equal shares of the view modes, a prefix length drawn per example.

    An unbiased, lower-variance estimate of the paper's expectation over one (S, k) per minibatch.

    Args:
        key: the step's key.
        index: [B] rows of the training data, in random order.
        data: training data.
        static: view modes, prefixes and latent dimension.

    Returns:
        The minibatch with masks and noise.
    """
    key_prefix, key_noise = jax.random.split(key)
    size, latent = index.shape[0], static.arch.latent
    choice = jax.random.randint(key_prefix, (size,), 0, len(static.prefixes))
    length = jnp.array(static.prefixes, jnp.int32)[choice]
    return Batch(
        x=data.x[index],
        y=data.y[index],
        view_mask=jnp.asarray(view_rows(static, size)[0]),
        prefix_mask=(jnp.arange(latent)[None] < length[:, None]).astype(jnp.float32),
        noise=_noise(key_noise, (size, latent), static.prior),
    )


def _noise(key: jax.Array, shape: tuple[int, int], prior: str) -> jax.Array:
    """What stands for the width of a code, or for its rounding."""
    if prior == "bits":
        return jax.random.uniform(key, shape, jnp.float32, -0.5, 0.5)
    return jax.random.normal(key, shape, jnp.float32)


def without_nesting(key: jax.Array, prefix_mask: jax.Array, nesting: jax.Array) -> jax.Array:
    """Give a share 1 - nesting of the examples all coordinates.

    Args:
        key: random key.
        prefix_mask: [B, K] sampled masks.
        nesting: share that keeps its mask.

    Returns:
        [B, K] masks.
    """
    whole = jax.random.uniform(key, (prefix_mask.shape[0], 1)) >= nesting
    return jnp.maximum(prefix_mask, whole.astype(jnp.float32))


def fit(key: jax.Array, hypers: Hypers, data: TrainData, static: TrainConfig) -> tuple[Params, dict[str, jax.Array]]:
    """Train one encoder from scratch: AdamW on the composite objective (paper, eq. "composite_loss").

    Args:
        key: the member's seed; members with equal keys see the same draws.
        hypers: array leaves, may be batched by the caller's `vmap`.
        data: training data.
        static: architecture, prefixes, prior, steps (static under `jit`).

    Returns:
        Parameters, and metrics [epochs]: mean `loss` and its terms per epoch.
    """
    epoch, start, epochs = epochs_of(key, hypers, data, static)
    (params, _), metrics = jax.lax.scan(epoch, start, jnp.arange(epochs))
    return params, metrics


def epochs_of(
    key: jax.Array, hypers: Hypers, data: TrainData, static: TrainConfig, multiple: int = 1
) -> tuple[Epoch, State, int]:
    """What `fit` scans: one epoch as a function of state and number, the state it starts from, and how many.

    Args:
        key: as for `fit`.
        hypers: as for `fit`.
        data: as for `fit`.
        static: as for `fit`.
        multiple: the number of epochs is rounded up to a multiple of this.

    Returns:
        The epoch, its initial state, the number of epochs.
    """
    key_init, *keys = jax.random.split(key, 3)
    epoch, optimizer, epochs = _loop(keys, hypers, data, static, multiple)
    params = linear_start(init(key_init, static.arch), data.x, static.arch)
    if static.prior == "bits":
        params = with_bits(params, data.x, static.arch)
    return epoch, (params, optimizer.init(params)), epochs


def epoch_of(key: jax.Array, hypers: Hypers, data: TrainData, static: TrainConfig) -> Epoch:
    """One epoch of `fit`, for those who have a state already; see `epochs_of`."""
    _, *keys = jax.random.split(key, 3)
    return _loop(keys, hypers, data, static, 1)[0]


def _loop(
    keys: Sequence[jax.Array], hypers: Hypers, data: TrainData, static: TrainConfig, multiple: int
) -> tuple[Epoch, optax.GradientTransformation, int]:
    """One epoch, the optimizer whose state it goes on with, and how many epochs there are; keys of order and steps."""
    key_order, key_steps = keys
    n = data.x.shape[0]
    batch, per_epoch, epochs = schedule_of(static.steps, static.batch, n)
    epochs = -(-epochs // multiple) * multiple
    optimizer = make_optimizer(hypers, static.warmup, epochs * per_epoch, static.clip)
    if static.arch.linear:
        optimizer = optax.chain(optimizer, optax.masked(optax.scale(static.linear_lr), linear_paths))
    if static.arch.encoder == "principal":
        # No gradient reaches it, but the decay of weights would.
        optimizer = optax.chain(optimizer, optax.masked(optax.set_to_zero(), principal_encoder))
    rows = view_rows(static, batch)[1]

    def sample(count: jax.Array, index: jax.Array) -> Batch:
        key_batch, key_nesting = jax.random.split(jax.random.fold_in(key_steps, count))
        minibatch = sample_batch(key_batch, index, data, static)
        mask = without_nesting(key_nesting, minibatch.prefix_mask, hypers.nesting)
        return minibatch._replace(prefix_mask=mask)

    def loss_of(params: Params, minibatch: Batch) -> tuple[jax.Array, dict[str, jax.Array]]:
        return composite_loss(params, minibatch, hypers, static.arch, static.prior, rows, static.precision)

    return make_epoch(key_order, optimizer, sample, loss_of, n, (batch, per_epoch)), optimizer, epochs

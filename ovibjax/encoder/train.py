"""Training of one O-VIB member as one pure function, to be vmapped over hyperparameters and seeds.

Randomness follows the seed alone: minibatch order, view modes, prefixes and noise are the same for every member
that shares a key, so members that differ in their hyperparameters are paired, and under `vmap` their first layer
is one large matrix product over a shared minibatch.
"""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from ovibjax.encoder.loss import Batch, Hypers, composite_loss
from ovibjax.encoder.model import Architecture, Params, init

PAPER_PREFIXES = (4, 8, 16, 32, 64, 96, 128)


@dataclass(frozen=True)
class TrainConfig:
    """Static choices of a training run; hashable.

    Attributes:
        arch: widths of the network.
        prefixes: supported prefix lengths, sampled uniformly per example; one length makes a fixed-rate model.
        prior: "gaussian" (scalable model) or "ard" (fixed-rate model).
        steps: optimizer steps, rounded up to whole epochs.
        batch: examples per step, at most the number of training examples.
        warmup: steps of linear warm-up before the cosine decay.
    """

    arch: Architecture = field(default_factory=Architecture)
    prefixes: tuple[int, ...] = PAPER_PREFIXES
    prior: str = "gaussian"
    steps: int = 4000
    batch: int = 128
    warmup: int = 200


class TrainData(NamedTuple):
    """What one member learns from.

    Attributes:
        x: [N, M, r] features, centred, unit variance overall.
        y: [N, 3] standardised positions.
        mode_masks: [modes, M] view masks, sampled uniformly per example.
    """

    x: jax.Array
    y: jax.Array
    mode_masks: jax.Array


def make_optimizer(hypers: Hypers, static: TrainConfig, total_steps: int) -> optax.GradientTransformation:
    """AdamW with linear warm-up and cosine decay; its numbers are leaves, so that they can be swept."""
    warmup = max(1, min(static.warmup, total_steps // 5))

    def schedule(count: jax.Array) -> jax.Array:
        step = jnp.asarray(count).astype(jnp.float32)
        rise = (step + 1.0) / warmup
        fall = jnp.clip((step - warmup) / max(total_steps - warmup, 1), 0.0, 1.0)
        return hypers.lr * jnp.minimum(rise, 0.5 * (1.0 + jnp.cos(jnp.pi * fall)))

    return optax.adamw(schedule, weight_decay=hypers.weight_decay)


def sample_batch(key: jax.Array, index: jax.Array, data: TrainData, static: TrainConfig) -> Batch:
    """A minibatch: view mode and prefix length drawn per example, an unbiased estimate of the paper's expectation.

    Args:
        key: the step's key.
        index: [B] rows of the training data.
        data: training data.
        static: prefixes and latent dimension.

    Returns:
        The minibatch with masks and noise.
    """
    key_mode, key_prefix, key_noise = jax.random.split(key, 3)
    size, latent = index.shape[0], static.arch.latent
    mode = jax.random.randint(key_mode, (size,), 0, data.mode_masks.shape[0])
    choice = jax.random.randint(key_prefix, (size,), 0, len(static.prefixes))
    length = jnp.array(static.prefixes, jnp.int32)[choice]
    return Batch(
        x=data.x[index],
        y=data.y[index],
        view_mask=data.mode_masks[mode],
        prefix_mask=(jnp.arange(latent)[None] < length[:, None]).astype(jnp.float32),
        noise=jax.random.normal(key_noise, (size, latent), jnp.float32),
    )


def fit(key: jax.Array, hypers: Hypers, data: TrainData, static: TrainConfig) -> tuple[Params, dict[str, jax.Array]]:
    """Train one member (paper, eq. "composite_loss" with AdamW).

    Args:
        key: the member's seed; members with equal keys see the same draws.
        hypers: array leaves, may be batched by the caller's `vmap`.
        data: training data.
        static: architecture, prefixes, prior, steps (static under `jit`).

    Returns:
        Parameters, and metrics [epochs]: mean `loss` and its terms per epoch.
    """
    key_init, key_order, key_steps = jax.random.split(key, 3)
    n = data.x.shape[0]
    batch = min(static.batch, n)
    per_epoch = n // batch
    epochs = -(-static.steps // per_epoch)
    optimizer = make_optimizer(hypers, static, epochs * per_epoch)
    params = init(key_init, static.arch)

    def step(state: Any, inputs: Any) -> Any:
        params, opt_state = state
        count, index = inputs
        minibatch = sample_batch(jax.random.fold_in(key_steps, count), index, data, static)
        grad_fn = jax.value_and_grad(composite_loss, has_aux=True)
        (loss, terms), grads = grad_fn(params, minibatch, hypers, static.arch, static.prior)
        # optax's bias correction raises a float to an integer power, which strict promotion (our tests') refuses.
        with jax.numpy_dtype_promotion("standard"):
            updates, opt_state = optimizer.update(grads, opt_state, params)
        return (optax.apply_updates(params, updates), opt_state), {"loss": loss, **terms}

    def epoch(state: Any, number: jax.Array) -> Any:
        order = jax.random.permutation(jax.random.fold_in(key_order, number), n)
        index = order[: per_epoch * batch].reshape(per_epoch, batch)
        count = number * per_epoch + jnp.arange(per_epoch)
        state, trace = jax.lax.scan(step, state, (count, index))
        return state, jax.tree.map(jnp.mean, trace)

    (params, _), metrics = jax.lax.scan(epoch, (params, optimizer.init(params)), jnp.arange(epochs))
    return params, metrics

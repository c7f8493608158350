"""The loop that trains a network: epochs of minibatches in random order, AdamW with warm-up and linear decay.

It is shared by O-VIB and by the attention baseline, so that a comparison of them is one of models.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import optax

from ovibjax.encoder.loss import Hypers
from ovibjax.encoder.model import Params
from ovibjax.encoder.recipe import training_steps

State = tuple[Params, Any]
"""Parameters and the optimizer's state."""

Epoch = Callable[[State, jax.Array], tuple[State, dict[str, jax.Array]]]
"""One epoch of training, see `make_epoch`."""


def make_optimizer(
    hypers: Hypers, warmup: int, total_steps: int, clip: float | None = None
) -> optax.GradientTransformation:
    """AdamW with linear warm-up and linear decay to zero; its numbers are leaves, so that they can be swept.

    Args:
        hypers: `lr`, the peak learning rate, and `weight_decay`.
        warmup: steps of warm-up, at most a fifth of all.
        total_steps: steps in all.
        clip: norm that gradients are scaled down to first; none if None.

    Returns:
        The gradient transformation.
    """
    warmup = max(1, min(warmup, total_steps // 5))

    def schedule(count: jax.Array) -> jax.Array:
        step = jnp.asarray(count).astype(jnp.float32)
        rise = (step + 1.0) / warmup
        left = jnp.clip((total_steps - step) / max(total_steps - warmup, 1), 0.0, 1.0)
        return hypers.lr * jnp.minimum(rise, left)

    adamw = optax.adamw(schedule, weight_decay=hypers.weight_decay)
    return adamw if clip is None else optax.chain(optax.clip_by_global_norm(clip), adamw)


def schedule_of(steps: int | None, batch: int, n: int) -> tuple[int, int, int]:
    """Whole epochs: examples per step, steps per epoch, epochs, for n training examples; `recipe`'s length if None."""
    size = min(batch, n)
    steps = training_steps(n, batch) if steps is None else steps
    return size, n // size, -(-steps // (n // size))


def make_epoch(
    key_order: jax.Array,
    optimizer: optax.GradientTransformation,
    sample: Callable[[jax.Array, jax.Array], Any],
    loss_of: Callable[[Params, Any], tuple[jax.Array, dict[str, jax.Array]]],
    n: int,
    shape: tuple[int, int],
) -> Epoch:
    """One epoch of minibatches in random order, as a scan over its steps.

    Args:
        key_order: sets the order of examples.
        optimizer: gradient transformation.
        sample: minibatch of a step's number and its [B] rows.
        loss_of: loss and its terms, of parameters and a minibatch.
        n: training examples.
        shape: examples per step, steps per epoch.

    Returns:
        A function of (parameters, optimizer state) and the epoch's number; returns the new state, and the epoch's
        mean `loss` and its terms.
    """
    batch, per_epoch = shape

    def step(state: State, inputs: Any) -> Any:
        params, opt_state = state
        minibatch = sample(*inputs)
        (loss, terms), grads = jax.value_and_grad(loss_of, has_aux=True)(params, minibatch)
        # optax's bias correction raises a float to an integer power, which strict promotion (our tests') refuses.
        with jax.numpy_dtype_promotion("standard"):
            updates, opt_state = optimizer.update(grads, opt_state, params)
        return (optax.apply_updates(params, updates), opt_state), {"loss": loss, **terms}

    def epoch(state: State, number: jax.Array) -> tuple[State, dict[str, jax.Array]]:
        order = jax.random.permutation(jax.random.fold_in(key_order, number), n)
        index = order[: per_epoch * batch].reshape(per_epoch, batch)
        count = number * per_epoch + jnp.arange(per_epoch)
        state, trace = jax.lax.scan(step, state, (count, index))
        return state, jax.tree.map(jnp.mean, trace)

    return epoch

"""Early stopping inside one compiled training of fixed length: the parameters of the best checkpoint are kept.

For training sets of a few dozen frames (paper, "Real-Scene Multi-Platform Evaluation"). Nothing stops early in time,
which costs little under `vmap`, where the slowest member would have to be waited for anyway.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from ovibjax.encoder.epochs import State
from ovibjax.encoder.loss import Hypers
from ovibjax.encoder.model import Params
from ovibjax.encoder.train import TrainConfig, TrainData, epochs_of


def fit_early(
    key: jax.Array,
    hypers: Hypers,
    data: TrainData,
    static: TrainConfig,
    score: Callable[[Params], jax.Array],
    checkpoints: int,
) -> tuple[Params, dict[str, jax.Array]]:
    """Train one member as `fit` does, and return the checkpoint with the lowest score.

    Args:
        key: the member's seed.
        hypers: array leaves, may be batched by the caller's `vmap`.
        data: training data.
        static: architecture, prefixes, prior, steps; epochs are rounded up to a multiple of `checkpoints`.
        score: validation error of parameters, a scalar; not a number never wins.
        checkpoints: evenly spaced, the last one at the end of training.

    Returns:
        Parameters of the best checkpoint, the earlier one of equals; metrics [epochs] as `fit`, and
        `score` [checkpoints], `best` (the number of the best one, from 0).
    """
    epoch, start, epochs = epochs_of(key, hypers, data, static, multiple=checkpoints)
    between = epochs // checkpoints
    Best = tuple[Params, jax.Array, jax.Array]

    def block(carry: tuple[State, Best], number: jax.Array) -> tuple[tuple[State, Best], dict[str, jax.Array]]:
        state, (kept, lowest, at) = carry
        state, metrics = jax.lax.scan(epoch, state, number * between + jnp.arange(between))
        value = score(state[0])
        better = value < lowest
        kept = jax.tree.map(lambda new, old: jnp.where(better, new, old), state[0], kept)
        best = (kept, jnp.where(better, value, lowest), jnp.where(better, number, at))
        return (state, best), {**metrics, "score": value}

    nothing_yet = (start[0], jnp.asarray(jnp.inf, jnp.float32), jnp.int32(-1))
    (_, (params, _, best)), metrics = jax.lax.scan(block, (start, nothing_yet), jnp.arange(checkpoints))
    per_epoch = {name: values.reshape(epochs) for name, values in metrics.items() if name != "score"}
    return params, {**per_epoch, "score": metrics["score"], "best": best}

"""Multi-view fusion by self-attention: the earlier conference version that the paper compares with (figure
"single_scene_ib_ablation").

Views are tokens and the position is regressed from their mean: no bottleneck, no retrieval. It shares data, batch
order, optimizer and schedule with O-VIB, so that the comparison is one of models.
"""

from dataclasses import dataclass
from typing import Any, cast

import flax.linen as nn
import jax
import jax.numpy as jnp

from ovibjax.encoder.epochs import make_epoch, make_optimizer, schedule_of
from ovibjax.encoder.loss import Hypers
from ovibjax.encoder.model import Params
from ovibjax.encoder.train import TrainData
from ovibjax.encoder.training_data import Standardizer
from ovibjax.views import mask_table


@dataclass(frozen=True)
class AttentionConfig:
    """Static choices of the network and its training; hashable.

    Attributes:
        n_views: views M, 5 for a UAV, 4 for a UGV.
        view_dim: input coordinates r per view.
        width: width of a token; a multiple of `heads`.
        heads: attention heads per block.
        blocks: self-attention blocks.
        mlp: hidden width of each block's MLP and of the regression head.
        steps: optimizer steps, rounded up to whole epochs.
        batch: examples per step, at most the number of training examples.
        warmup: steps of linear warm-up before the cosine decay.
        all_views: train with every view always, not with a view mode sampled per example.
    """

    n_views: int = 5
    view_dim: int = 64
    width: int = 128
    heads: int = 4
    blocks: int = 2
    mlp: int = 256
    steps: int = 4000
    batch: int = 128
    warmup: int = 200
    all_views: bool = True


class ViewFusion(nn.Module):
    """Tokens, self-attention blocks, pooling and regression head."""

    static: AttentionConfig

    @nn.compact
    def __call__(self, x: jax.Array, present: jax.Array) -> jax.Array:
        """Standardised position [B, 3] of features x [B, M, r], of which the views `present` [B, M] count."""
        static = self.static
        he = nn.initializers.he_normal()
        # Attention and pooling weigh an absent view by zero, which a NaN would survive.
        x = jnp.where(present[:, :, None], x, 0.0)
        embedding = self.param("view_embedding", nn.initializers.normal(1.0), (static.n_views, static.width))
        # One projection per view: each view has a basis of its own, so coordinate j means something else in each.
        per_view = nn.initializers.lecun_normal(batch_axis=0)
        kernel = self.param("token", per_view, (static.n_views, static.view_dim, static.width))
        tokens = jnp.einsum("bmr,mrw->bmw", x, kernel) + embedding[None]
        for block in range(static.blocks):
            normed = nn.LayerNorm(name=f"norm_attention_{block}")(tokens)
            # A key's bias cancels in the softmax; Adam would blow its gradient, all rounding, up to full steps.
            attention = nn.MultiHeadDotProductAttention(static.heads, use_bias=False, name=f"attention_{block}")
            tokens = tokens + attention(normed, mask=present[:, None, None, :])
            normed = nn.LayerNorm(name=f"norm_mlp_{block}")(tokens)
            hidden = nn.gelu(nn.Dense(static.mlp, kernel_init=he, name=f"mlp_in_{block}")(normed))
            tokens = tokens + nn.Dense(static.width, name=f"mlp_out_{block}")(hidden)
        weights = present.astype(jnp.float32)
        weights = weights / jnp.sum(weights, axis=1, keepdims=True)
        pooled = nn.LayerNorm(name="norm_pooled")(jnp.sum(tokens * weights[:, :, None], axis=1))
        hidden = nn.gelu(nn.Dense(static.mlp, kernel_init=he, name="head_in")(pooled))
        return nn.Dense(3, name="head_out")(hidden)


def init_attention(key: jax.Array, static: AttentionConfig) -> Params:
    """Initial parameters, a pytree of float32 arrays."""
    x = jnp.zeros((1, static.n_views, static.view_dim), jnp.float32)
    return cast(Params, ViewFusion(static).init(key, x, jnp.ones((1, static.n_views), bool)))


def predict(params: Params, x: jax.Array, view_mask: jax.Array, static: AttentionConfig) -> jax.Array:
    """Regress positions; an absent view has no influence whatever its features.

    Args:
        params: parameters of the network.
        x: [B, M, r] features, centred, unit variance overall.
        view_mask: [M] or [B, M], nonzero where the view is present; at least one view per example.
        static: widths of the network (static).

    Returns:
        [B, 3] standardised positions.
    """
    present = jnp.broadcast_to(view_mask != 0, x.shape[:2])
    return cast(jax.Array, ViewFusion(static).apply(params, x, present))


def positions_m(
    params: Params, x: jax.Array, standardizer: Standardizer, view_mask: jax.Array, static: AttentionConfig
) -> jax.Array:
    """Regress positions in metres.

    Args:
        params: parameters of the network.
        x: [B, M, r] features, centred, unit variance overall.
        standardizer: map between standardised and metric positions.
        view_mask: [M] or [B, M], nonzero where the view is present; at least one view per example.
        static: widths of the network (static).

    Returns:
        [B, 3] positions, m.
    """
    return predict(params, x, view_mask, static) * standardizer.scale_m + standardizer.mean_m[None]


def fit_attention(
    key: jax.Array, hypers: Hypers, data: TrainData, static: AttentionConfig
) -> tuple[Params, dict[str, jax.Array]]:
    """Train one member on the squared position error with AdamW; batches come in the order of `encoder.train.fit`.

    Args:
        key: the member's seed; members with equal keys see the same draws.
        hypers: `lr` and `weight_decay` are used, array leaves, may be batched by the caller's `vmap`; on the embedded
            town 3e-3 and 0.1 gave the lowest validation error of those tried.
        data: training data.
        static: network, steps, view sampling (static under `jit`).

    Returns:
        Parameters, and metrics [epochs]: mean `loss` per epoch, in squared standardised units.
    """
    key_init, key_order, key_steps = jax.random.split(key, 3)
    n = data.x.shape[0]
    batch, per_epoch, epochs = schedule_of(static.steps, static.batch, n)
    optimizer = make_optimizer(hypers, static.warmup, epochs * per_epoch)

    def sample(count: jax.Array, index: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        view_mask = jnp.ones((batch, static.n_views), jnp.float32)
        if not static.all_views:
            masks = mask_table(static.n_views)
            mode = jax.random.randint(jax.random.fold_in(key_steps, count), (batch,), 0, masks.shape[0])
            view_mask = masks[mode]
        return data.x[index], data.y[index], view_mask

    def loss_of(params: Params, minibatch: Any) -> tuple[jax.Array, dict[str, jax.Array]]:
        x, y, view_mask = minibatch
        return jnp.mean(jnp.sum((predict(params, x, view_mask, static) - y) ** 2, axis=-1)), {}

    params = init_attention(key_init, static)
    epoch = make_epoch(key_order, optimizer, sample, loss_of, n, (batch, per_epoch))
    (params, _), metrics = jax.lax.scan(epoch, (params, optimizer.init(params)), jnp.arange(epochs))
    return params, metrics

"""The O-VIB network: an encoder for all views, a decoder and a localizer (paper, Section "Overall Training Objective").

flax.linen used functionally: parameters are a plain pytree; every method takes one batch. Hidden layers use GELU:
it trains to lower error than ReLU here, because a smooth decoder interpolates between training frames.

The layers that touch the multi-view feature hold one kernel per view. Their sum is the dense layer over the
concatenated views, and a view that is masked in some rows of a batch costs nothing there: rows are ordered so that
every view is present in the first `rows[v]` of them, and only those are multiplied.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, cast

import flax.linen as nn
import jax
import jax.numpy as jnp

from ovibjax.runtime.precision import dot_general

Params = dict[str, Any]
"""Parameters of the network: nested dictionaries of float32 arrays."""


@dataclass(frozen=True)
class Architecture:
    """Widths of the network; hashable, so that it can be a static argument.

    Attributes:
        n_views: views M, 5 for a UAV, 4 for a UGV.
        view_dim: input coordinates per view: r in the per-view basis, d without it.
        latent: full latent dimension K.
        hidden: width of the first encoder and last decoder layer.
        last_hidden: width d_h of the layer before the posterior-mean projection.
        head: hidden width of the edge localizer.
        logvar_bias: initial log-variance of the posterior; near zero the noise drowns the signal from the start.
    """

    n_views: int = 5
    view_dim: int = 64
    latent: int = 128
    hidden: int = 512
    last_hidden: int = 256
    head: int = 192
    logvar_bias: float = -4.0


class OVIB(nn.Module):
    """Encoder q(z|x), decoder of the descriptor, and localizer of the position from the descriptor.

    Attributes:
        arch: widths.
        precision: type of the operands of matrix products, see `runtime.precision`.
    """

    arch: Architecture
    precision: str = "float32"

    def setup(self) -> None:
        """Declare the layers; flax calls this."""
        arch = self.arch
        dense = partial(nn.Dense, dot_general=dot_general(self.precision))
        he = nn.initializers.he_normal()
        # The inputs of a joint layer are those of all views together.
        joint_he = nn.initializers.variance_scaling(2.0 / arch.n_views, "fan_in", "truncated_normal")
        views = range(arch.n_views)
        self.encoder_1 = [dense(arch.hidden, use_bias=False, kernel_init=joint_he) for _ in views]
        self.encoder_1_bias = self.param("encoder_1_bias", nn.initializers.zeros, (arch.hidden,))
        self.encoder_2 = dense(arch.last_hidden, kernel_init=he)
        self.mean = dense(arch.latent)
        small = nn.initializers.variance_scaling(0.01, "fan_in", "normal")
        bias = nn.initializers.constant(arch.logvar_bias)
        self.logvar = dense(arch.latent, kernel_init=small, bias_init=bias)
        self.decoder_1 = dense(arch.last_hidden, kernel_init=he)
        self.decoder_2 = dense(arch.hidden, kernel_init=he)
        self.descriptor = [dense(arch.view_dim) for _ in views]
        self.head_1 = [dense(arch.head, use_bias=False, kernel_init=joint_he) for _ in views]
        self.head_1_bias = self.param("head_1_bias", nn.initializers.zeros, (arch.head,))
        self.head_2 = nn.Dense(3)

    def encode(self, views: Sequence[jax.Array]) -> tuple[jax.Array, jax.Array]:
        """Posterior mean and log-variance, each [B, K], of masked views, each [rows_v, r]."""
        hidden = _sum_rows([layer(x) for layer, x in zip(self.encoder_1, views, strict=True)])
        hidden = nn.gelu(self.encoder_2(nn.gelu(hidden + self.encoder_1_bias[None])))
        return self.mean(hidden), jnp.clip(self.logvar(hidden), -12.0, 6.0)

    def decode(self, z: jax.Array, rows: Sequence[int]) -> list[jax.Array]:
        """Reconstructed views, each [rows_v, r], of a masked latent z [B, K]."""
        hidden = nn.gelu(self.decoder_2(nn.gelu(self.decoder_1(z))))
        return [layer(hidden[:count]) for layer, count in zip(self.descriptor, rows, strict=True)]

    def locate(self, views: Sequence[jax.Array]) -> jax.Array:
        """Standardised position [B, 3] regressed from a descriptor in views, each [rows_v, r]."""
        hidden = _sum_rows([layer(x) for layer, x in zip(self.head_1, views, strict=True)])
        return self.head_2(nn.gelu(hidden + self.head_1_bias[None]))

    def __call__(self, views: Sequence[jax.Array]) -> jax.Array:
        """All three parts in a row, without noise; used to initialise."""
        return self.locate(self.decode(self.encode(views)[0], [len(x) for x in views]))


def _sum_rows(parts: Sequence[jax.Array]) -> jax.Array:
    """Sum of arrays that cover the first rows only; the first covers all."""
    total = parts[0]
    for part in parts[1:]:
        missing = total.shape[0] - part.shape[0]
        total = total + (jnp.pad(part, ((0, missing), (0, 0))) if missing else part)
    return total


def split_views(x: jax.Array, arch: Architecture, rows: Sequence[int] | None = None) -> list[jax.Array]:
    """Views of flattened features [B, M r], each its first rows_v rows, all of them by default: [rows_v, r]."""
    counts = rows or [x.shape[0]] * arch.n_views
    joint = x.reshape(x.shape[0], arch.n_views, arch.view_dim)
    return [joint[:count, view] for view, count in enumerate(counts)]


def init(key: jax.Array, arch: Architecture) -> Params:
    """Random parameters to start training from.

    Args:
        key: random key.
        arch: widths of the network.

    Returns:
        A pytree of float32 arrays.
    """
    views = [jnp.zeros((1, arch.view_dim), jnp.float32)] * arch.n_views
    return cast(Params, OVIB(arch).init(key, views))


def encode(params: Params, x: jax.Array, arch: Architecture) -> tuple[jax.Array, jax.Array]:
    """The code of each frame as a distribution, q(z|x).

    Args:
        params: parameters of the network.
        x: [B, M r] flattened features, zero where a view is absent.
        arch: widths of the network (static).

    Returns:
        Posterior mean and log-variance, each [B, K]; the mean is what is sent.
    """
    return cast(tuple[jax.Array, jax.Array], OVIB(arch).apply(params, split_views(x, arch), method="encode"))


def decode(params: Params, z: jax.Array, arch: Architecture) -> jax.Array:
    """The descriptor that a received code stands for.

    Args:
        params: parameters of the network.
        z: [B, K] code, zero beyond the prefix that was sent.
        arch: widths of the network (static).

    Returns:
        [B, M r] reconstructed features; the caller masks absent views.
    """
    views = OVIB(arch).apply(params, z, [z.shape[0]] * arch.n_views, method="decode")
    return jnp.concatenate(cast(list[jax.Array], views), axis=1)


def locate(params: Params, descriptor: jax.Array, arch: Architecture) -> jax.Array:
    """The position that the edge localizer regresses from a descriptor.

    Args:
        params: parameters of the network.
        descriptor: [B, M r] decoded or uncompressed features, zero where a view is absent.
        arch: widths of the network (static).

    Returns:
        [B, 3] standardised positions; `MemberData.standardizer` turns them into metres.
    """
    return cast(jax.Array, OVIB(arch).apply(params, split_views(descriptor, arch), method="locate"))


def mean_projection(params: Params) -> jax.Array:
    """The matrix W [K, d_h] of the posterior-mean projection."""
    return params["params"]["mean"]["kernel"].T


def dense_layers(params: Params) -> dict[str, dict[str, jax.Array]]:
    """The network as plain dense layers over concatenated views, for other frameworks and for checking.

    Args:
        params: parameters of the network.

    Returns:
        Per layer `kernel` [inputs, outputs] and `bias` [outputs].
    """
    tree = params["params"]
    views = range(sum(name.startswith("descriptor_") for name in tree))
    layers = {name: dict(tree[name]) for name in ("encoder_2", "mean", "logvar", "decoder_1", "decoder_2", "head_2")}
    for name in ("encoder_1", "head_1"):
        kernel = jnp.concatenate([tree[f"{name}_{view}"]["kernel"] for view in views])
        layers[name] = {"kernel": kernel, "bias": tree[f"{name}_bias"]}
    parts = [tree[f"descriptor_{view}"] for view in views]
    layers["descriptor"] = {
        "kernel": jnp.concatenate([part["kernel"] for part in parts], axis=1),
        "bias": jnp.concatenate([part["bias"] for part in parts]),
    }
    return layers


def parameter_bytes(params: Params) -> int:
    """Size of the parameters in float32 bytes."""
    return sum(leaf.size * 4 for leaf in jax.tree.leaves(params))

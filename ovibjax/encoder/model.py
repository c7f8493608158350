"""The O-VIB network: joint encoder over masked views, reconstruction decoder, edge localizer (paper, Section III).

flax.linen used functionally: parameters are a plain pytree; every method takes one batch. Hidden layers use GELU:
it trains to lower error than ReLU here, because a smooth decoder interpolates between training frames.
"""

from dataclasses import dataclass
from typing import Any, cast

import flax.linen as nn
import jax
import jax.numpy as jnp

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
    """Encoder q(z|x), decoder of the descriptor, and localizer of the position from the descriptor."""

    arch: Architecture

    def setup(self) -> None:
        """Declare the layers; flax calls this."""
        arch = self.arch
        he = nn.initializers.he_normal()
        self.encoder_1 = nn.Dense(arch.hidden, kernel_init=he)
        self.encoder_2 = nn.Dense(arch.last_hidden, kernel_init=he)
        self.mean = nn.Dense(arch.latent)
        small = nn.initializers.variance_scaling(0.01, "fan_in", "normal")
        bias = nn.initializers.constant(arch.logvar_bias)
        self.logvar = nn.Dense(arch.latent, kernel_init=small, bias_init=bias)
        self.decoder_1 = nn.Dense(arch.last_hidden, kernel_init=he)
        self.decoder_2 = nn.Dense(arch.hidden, kernel_init=he)
        self.descriptor = nn.Dense(arch.n_views * arch.view_dim)
        self.head_1 = nn.Dense(arch.head, kernel_init=he)
        self.head_2 = nn.Dense(3)

    def encode(self, x: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Posterior mean and log-variance, each [B, K], of masked flattened features x [B, M r]."""
        hidden = nn.gelu(self.encoder_2(nn.gelu(self.encoder_1(x))))
        return self.mean(hidden), jnp.clip(self.logvar(hidden), -12.0, 6.0)

    def decode(self, z: jax.Array) -> jax.Array:
        """Reconstructed descriptor [B, M r] of a masked latent z [B, K]."""
        return self.descriptor(nn.gelu(self.decoder_2(nn.gelu(self.decoder_1(z)))))

    def locate(self, descriptor: jax.Array) -> jax.Array:
        """Standardised position [B, 3] regressed from a descriptor [B, M r]."""
        return self.head_2(nn.gelu(self.head_1(descriptor)))

    def __call__(self, x: jax.Array) -> tuple[jax.Array, jax.Array]:
        """All three parts in a row, without noise: descriptor and position; used to initialise."""
        descriptor = self.decode(self.encode(x)[0])
        return descriptor, self.locate(descriptor)


def init(key: jax.Array, arch: Architecture) -> Params:
    """Initial parameters.

    Args:
        key: random key.
        arch: widths of the network.

    Returns:
        A pytree of float32 arrays.
    """
    return cast(Params, OVIB(arch).init(key, jnp.zeros((1, arch.n_views * arch.view_dim), jnp.float32)))


def encode(params: Params, x: jax.Array, arch: Architecture) -> tuple[jax.Array, jax.Array]:
    """Posterior mean and log-variance, each [B, K], of masked flattened features x [B, M r]."""
    return cast(tuple[jax.Array, jax.Array], OVIB(arch).apply(params, x, method="encode"))


def decode(params: Params, z: jax.Array, arch: Architecture) -> jax.Array:
    """Reconstructed descriptor [B, M r] of a masked latent z [B, K]."""
    return cast(jax.Array, OVIB(arch).apply(params, z, method="decode"))


def locate(params: Params, descriptor: jax.Array, arch: Architecture) -> jax.Array:
    """Standardised position [B, 3] regressed from a descriptor [B, M r]."""
    return cast(jax.Array, OVIB(arch).apply(params, descriptor, method="locate"))


def mean_projection(params: Params) -> jax.Array:
    """The matrix W [K, d_h] of the posterior-mean projection."""
    return params["params"]["mean"]["kernel"].T


def parameter_bytes(params: Params) -> int:
    """Size of the parameters in float32 bytes."""
    return sum(leaf.size * 4 for leaf in jax.tree.leaves(params))

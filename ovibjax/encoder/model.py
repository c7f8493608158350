"""The O-VIB network: an encoder for all views, a decoder and a localizer (paper, Section "Overall Training Objective").

flax.linen used functionally: parameters are a plain pytree; every method takes one batch. Hidden layers use GELU:
it trains to lower error than ReLU here, because a smooth decoder interpolates between training frames.

Three kinds of network (`Architecture.kind`). "dense" is encoder and decoder of plain layers. "linear" and "completing"
add a linear path to both, which starts as principal component analysis (`linear_start`), so that training only has to
learn what that leaves open:

- Encoder: h = sum of L_v x_v + MLP(x), mu = W h. L starts as the leading principal directions of the training features,
  W as the first K rows of the identity, so that W W^T = I.
- Decoder of "linear": x̂ = D (z m) + MLP(z m), with D the transpose of L at the start.
- Decoder of "completing": x̂ = D (z m + (1 - m) f(z m)), where the network f predicts from the prefix the principal
  coordinates that were not sent. The edge knows the mask m, as k stands in every packet. At k = K the decoder is
  linear, so that short prefixes cost long ones nothing. The first layer of f is a sine: a few numbers must become
  patterns of high spatial frequency.

An encoder may also stay what it starts as (`Architecture.encoder` is "principal"): mu are the principal coordinates
themselves, without noise, and decoder and localizer alone are trained. It tells what the decoder gives from what the
encoder gives.

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
from jax.flatten_util import ravel_pytree

from ovibjax.runtime.precision import dot_general

Params = dict[str, Any]
"""Parameters of the network: nested dictionaries of float32 arrays."""

KINDS = ("dense", "linear", "completing")
ENCODERS = ("learned", "principal")
WAVES = {"sine": jnp.sin, "gelu": nn.gelu}

_NO_NOISE = -40.0
"""Log-variance of a code that is not noisy."""

_TRUNCATED = 0.87962566103423978
"""Standard deviation of a standard normal that is truncated at two deviations."""

_CORRECTION = 0.1
"""Scale of what the networks add to the linear paths at the start."""


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
        kind: "dense", "linear" or "completing", see above.
        rank: principal coordinates that the linear paths start from, at least K.
        wave: first activation of the decoder of "linear" and "completing": "sine" or "gelu".
        encoder: "learned", or "principal" for principal coordinates that stay as they are.

    Raises:
        ValueError: an unknown kind, wave or encoder, a rank below K, or principal coordinates without linear paths.
    """

    n_views: int = 5
    view_dim: int = 64
    latent: int = 128
    hidden: int = 512
    last_hidden: int = 256
    head: int = 192
    logvar_bias: float = -4.0
    kind: str = "completing"
    rank: int = 128
    wave: str = "sine"
    encoder: str = "learned"

    def __post_init__(self) -> None:
        """Refuse what the network cannot be."""
        if self.kind not in KINDS:
            raise ValueError(f"kind is one of {', '.join(KINDS)}, not {self.kind!r}")
        if self.wave not in WAVES:
            raise ValueError(f"wave is one of {', '.join(WAVES)}, not {self.wave!r}")
        if self.encoder not in ENCODERS:
            raise ValueError(f"encoder is one of {', '.join(ENCODERS)}, not {self.encoder!r}")
        if self.encoder == "principal" and not self.linear:
            raise ValueError("a principal encoder is a linear path, which a dense network does not have")
        if self.linear and self.rank < self.latent:
            raise ValueError(f"rank {self.rank} is below the latent dimension {self.latent}")

    @property
    def linear(self) -> bool:
        """Whether encoder and decoder have linear paths."""
        return self.kind != "dense"


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
        # Two before an activation (He), one before none. What is added to a linear path starts small; the inputs of a
        # joint layer are those of all views together.
        scale = _CORRECTION**2 if arch.linear else 1.0
        he, added_he, added = _deviation(2.0), _deviation(2.0 * scale), _deviation(scale)
        joint_he = _deviation(2.0 / arch.n_views)
        views = range(arch.n_views)
        if arch.encoder == "learned":
            self.encoder_1 = [dense(arch.hidden, use_bias=False, kernel_init=joint_he) for _ in views]
            self.encoder_1_bias = self.param("encoder_1_bias", nn.initializers.zeros, (arch.hidden,))
            self.encoder_2 = dense(arch.last_hidden, kernel_init=added_he)
            bias = nn.initializers.constant(arch.logvar_bias)
            self.logvar = dense(arch.latent, kernel_init=_deviation(0.01), bias_init=bias)
        if arch.linear:
            zeros: dict[str, Any] = {"use_bias": False, "kernel_init": nn.initializers.zeros}
            self.direct = [dense(arch.last_hidden, **zeros) for _ in views]
            self.principal = [dense(arch.view_dim, **zeros) for _ in views]
        self.mean = dense(arch.latent, kernel_init=_deviation(1.0))
        self.decoder_1 = dense(arch.last_hidden, kernel_init=he)
        self.decoder_2 = dense(arch.hidden, kernel_init=he)
        if arch.kind == "completing":
            self.completion = dense(arch.rank, kernel_init=added)
        else:
            self.descriptor = [dense(arch.view_dim, kernel_init=added) for _ in views]
        self.head_1 = [dense(arch.head, use_bias=False, kernel_init=joint_he) for _ in views]
        self.head_1_bias = self.param("head_1_bias", nn.initializers.zeros, (arch.head,))
        self.head_2 = nn.Dense(3, kernel_init=_deviation(1.0))

    def encode(self, views: Sequence[jax.Array]) -> tuple[jax.Array, jax.Array]:
        """Posterior mean and log-variance, each [B, K], of masked views, each [rows_v, r]."""
        if self.arch.encoder == "principal":
            straight = _sum_rows([layer(x) for layer, x in zip(self.direct, views, strict=True)])
            mu = jax.lax.stop_gradient(self.mean(straight))
            return mu, jnp.full_like(mu, _NO_NOISE)
        hidden = _sum_rows([layer(x) for layer, x in zip(self.encoder_1, views, strict=True)])
        hidden = self.encoder_2(nn.gelu(hidden + self.encoder_1_bias[None]))
        if self.arch.linear:
            hidden = hidden + _sum_rows([layer(x) for layer, x in zip(self.direct, views, strict=True)])
            # The width of the posterior is learnt by its own weights alone: through the linear path it would bend the
            # principal directions that long prefixes rest on.
            logvar = self.logvar(_CORRECTION * jax.lax.stop_gradient(hidden))
            return self.mean(hidden), jnp.clip(logvar, -12.0, 6.0)
        hidden = nn.gelu(hidden)
        return self.mean(hidden), jnp.clip(self.logvar(hidden), -12.0, 6.0)

    def decode(self, z: jax.Array, kept: jax.Array, rows: Sequence[int]) -> list[jax.Array]:
        """Reconstructed views, each [rows_v, r], of a code z [B, K] of which the coordinates kept [B, K] were sent."""
        arch, sent = self.arch, z * kept
        wave = WAVES[arch.wave] if arch.linear else nn.gelu
        hidden = nn.gelu(self.decoder_2(wave(self.decoder_1(sent))))
        if not arch.linear:
            return _per_view(self.descriptor, hidden, rows)
        beyond = ((0, 0), (0, arch.rank - arch.latent))
        coordinates = jnp.pad(sent, beyond)
        if arch.kind == "completing":
            coordinates = coordinates + (1.0 - jnp.pad(kept, beyond)) * self.completion(hidden)
            return _per_view(self.principal, coordinates, rows)
        straight = _per_view(self.principal, coordinates, rows)
        return [a + b for a, b in zip(_per_view(self.descriptor, hidden, rows), straight, strict=True)]

    def locate(self, views: Sequence[jax.Array]) -> jax.Array:
        """Standardised position [B, 3] regressed from a descriptor in views, each [rows_v, r]."""
        hidden = _sum_rows([layer(x) for layer, x in zip(self.head_1, views, strict=True)])
        return self.head_2(nn.gelu(hidden + self.head_1_bias[None]))

    def __call__(self, views: Sequence[jax.Array]) -> jax.Array:
        """All three parts in a row, without noise and with every coordinate; used to initialise."""
        z = self.encode(views)[0]
        return self.locate(self.decode(z, jnp.ones_like(z), [len(x) for x in views]))


def _deviation(variance: float) -> nn.initializers.Initializer:
    """Initialiser that gives not the weights but their standard deviation, for this variance per input; see `init`."""

    def initialise(key: jax.Array, shape: Sequence[int], dtype: Any = jnp.float32) -> jax.Array:
        return jnp.full(shape, (variance / shape[0]) ** 0.5, dtype)

    return initialise


def _per_view(layers: Sequence[nn.Dense], hidden: jax.Array, rows: Sequence[int]) -> list[jax.Array]:
    """A layer per view on the first rows_v rows: [rows_v, r] each."""
    return [layer(hidden[:count]) for layer, count in zip(layers, rows, strict=True)]


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
    """Random parameters to start training from: kernels normal, truncated at two deviations; biases constant.

    The kernels are one draw: a draw for each takes as long to compile as a training step.

    Args:
        key: random key.
        arch: widths of the network.

    Returns:
        A pytree of float32 arrays.
    """
    views = [jnp.zeros((1, arch.view_dim), jnp.float32)] * arch.n_views
    tree = OVIB(arch).init(key, views)["params"]
    kernels = {name: layer.pop("kernel") for name, layer in tree.items() if isinstance(layer, dict)}
    deviation, unravel = ravel_pytree(kernels)
    drawn = unravel(deviation * jax.random.truncated_normal(key, -2.0, 2.0, deviation.shape) / _TRUNCATED)
    return {
        "params": {name: layer | {"kernel": drawn[name]} if name in drawn else layer for name, layer in tree.items()}
    }


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


def decode(params: Params, z: jax.Array, kept: jax.Array, arch: Architecture) -> jax.Array:
    """The descriptor that a received code stands for.

    Args:
        params: parameters of the network.
        z: [B, K] code.
        kept: [K] one where a coordinate was sent, zero where not; the prefix mask.
        arch: widths of the network (static).

    Returns:
        [B, M r] reconstructed features; the caller masks absent views.
    """
    masks = jnp.broadcast_to(kept[None], z.shape)
    views = OVIB(arch).apply(params, z, masks, [z.shape[0]] * arch.n_views, method="decode")
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
        Per layer `kernel` [inputs, outputs] and, but for the linear paths, `bias` [outputs].
    """
    tree = params["params"]
    views = range(sum(name.startswith("head_1_") and name != "head_1_bias" for name in tree))
    single = ("encoder_2", "mean", "logvar", "decoder_1", "decoder_2", "completion", "head_2")
    layers = {name: dict(tree[name]) for name in single if name in tree}
    for name in (name for name in ("encoder_1", "head_1") if f"{name}_0" in tree):
        kernel = jnp.concatenate([tree[f"{name}_{view}"]["kernel"] for view in views])
        layers[name] = {"kernel": kernel, "bias": tree[f"{name}_bias"]}
    if "direct_0" in tree:
        layers["direct"] = {"kernel": jnp.concatenate([tree[f"direct_{view}"]["kernel"] for view in views])}
    for name in ("principal", "descriptor"):
        if f"{name}_0" in tree:
            parts = [tree[f"{name}_{view}"] for view in views]
            layers[name] = {key: jnp.concatenate([part[key] for part in parts], axis=-1) for key in parts[0]}
    return layers


def parameter_bytes(params: Params) -> int:
    """Size of the parameters in float32 bytes."""
    return sum(leaf.size * 4 for leaf in jax.tree.leaves(params))

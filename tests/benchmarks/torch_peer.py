"""The PyTorch peer of `ovibjax.encoder.train.fit`: one member per call, to be looped over by a benchmark.

The same models ("dense" and "completing"), objective, optimizer, schedule, batch, steps and sampling distributions,
written as one writes it in eager PyTorch: data in memory, indexed by a permutation per epoch; masked views multiplied
densely; AdamW in its fused form, which is the fastest on a CPU. The draws come from a torch generator, so a member
agrees with its JAX twin in distribution, not number by number. The caller chooses the number of threads
(`torch.set_num_threads`).
"""

import math
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ovibjax.encoder.epochs import schedule_of
from ovibjax.encoder.loss import Hypers
from ovibjax.encoder.model import Architecture, Params, dense_layers
from ovibjax.encoder.train import TrainConfig, view_rows

TERMS = ("loss", "reconstruction", "localization", "rate", "orthogonality")
DECAYS = ("linear", "cosine")
LINEAR_PATHS = ("direct", "mean", "principal")
CORRECTION = 0.1
"""Scale of what the networks add to the linear paths at the start."""


class OVIB(nn.Module):
    """The network, "dense" or "completing"; layers carry the names of the flax module."""

    def __init__(self, arch: Architecture) -> None:
        super().__init__()
        if arch.kind not in ("dense", "completing") or (arch.wave, arch.encoder) != ("sine", "learned"):
            raise ValueError(f"there is no peer of {arch}")
        self.arch = arch
        features = arch.n_views * arch.view_dim
        self.encoder_1 = nn.Linear(features, arch.hidden)
        self.encoder_2 = nn.Linear(arch.hidden, arch.last_hidden)
        self.mean = nn.Linear(arch.last_hidden, arch.latent)
        self.logvar = nn.Linear(arch.last_hidden, arch.latent)
        self.decoder_1 = nn.Linear(arch.latent, arch.last_hidden)
        self.decoder_2 = nn.Linear(arch.last_hidden, arch.hidden)
        if arch.linear:
            self.direct = nn.Linear(features, arch.last_hidden, bias=False)
            self.completion = nn.Linear(arch.hidden, arch.rank)
            self.principal = nn.Linear(arch.rank, features, bias=False)
        else:
            self.descriptor = nn.Linear(arch.hidden, features)
        self.head_1 = nn.Linear(features, arch.head)
        self.head_2 = nn.Linear(arch.head, 3)

    def encode(self, x: Tensor) -> tuple[Tensor, Tensor]:
        hidden = self.encoder_2(gelu(self.encoder_1(x)))
        if self.arch.linear:
            hidden = hidden + self.direct(x)
            logvar = self.logvar(CORRECTION * hidden.detach())
        else:
            hidden = gelu(hidden)
            logvar = self.logvar(hidden)
        # float() matters under autocast alone: the loss is computed in float32.
        return self.mean(hidden).float(), logvar.float().clamp(-12.0, 6.0)

    def decode(self, z: Tensor, kept: Tensor) -> Tensor:
        sent = z * kept
        wave = torch.sin if self.arch.linear else gelu
        hidden = gelu(self.decoder_2(wave(self.decoder_1(sent))))
        if not self.arch.linear:
            return self.descriptor(hidden).float()
        beyond = (0, self.arch.rank - self.arch.latent)
        coordinates = F.pad(sent, beyond) + (1.0 - F.pad(kept, beyond)) * self.completion(hidden)
        return self.principal(coordinates).float()

    def locate(self, descriptor: Tensor) -> Tensor:
        return self.head_2(gelu(self.head_1(descriptor))).float()


def gelu(x: Tensor) -> Tensor:
    return F.gelu(x, approximate="tanh")


@torch.no_grad()
def initialise(model: OVIB, generator: torch.Generator) -> None:
    """The initial distributions of the flax module: He or LeCun normal, truncated at two deviations; zero biases.

    The linear paths are zero, as there, until `linear_start`.
    """
    plain = ("mean", "descriptor", "completion", "head_2")
    added = ("encoder_2", "completion") if model.arch.linear else ()
    for name, layer in model.named_children():
        assert isinstance(layer, nn.Linear)
        if layer.bias is None:
            nn.init.zeros_(layer.weight)
            continue
        nn.init.zeros_(layer.bias)
        if name == "logvar":
            nn.init.normal_(layer.weight, std=math.sqrt(0.01 / layer.in_features), generator=generator)
            nn.init.constant_(layer.bias, model.arch.logvar_bias)
            continue
        scale = CORRECTION if name in added else 1.0
        # flax widens the truncated normal, so that its deviation after truncation is the wanted one.
        std = scale * math.sqrt((1.0 if name in plain else 2.0) / layer.in_features) / 0.87962566103423978
        nn.init.trunc_normal_(layer.weight, std=std, a=-2.0 * std, b=2.0 * std, generator=generator)


@torch.no_grad()
def linear_start(model: OVIB, x: Tensor) -> None:
    """Let the linear paths hold the principal directions of features [N, M, r], as `encoder.linear_start`."""
    arch = model.arch
    if not arch.linear:
        return
    axes = principal_axes(x.flatten(1), max(arch.last_hidden, arch.rank))
    model.direct.weight.copy_(axes[:, : arch.last_hidden].T)
    model.principal.weight.copy_(axes[:, : arch.rank])
    nn.init.eye_(model.mean.weight)


def principal_axes(x: Tensor, count: int) -> Tensor:
    """Leading principal directions [D, count] of centred rows [N, D], each with its largest entry positive."""
    vectors = torch.linalg.eigh(x.T @ x / len(x)).eigenvectors.flip(1)[:, :count]
    largest = vectors.gather(0, vectors.abs().argmax(0, keepdim=True))
    return F.pad(vectors * largest.sign(), (0, count - vectors.shape[1]))


@torch.no_grad()
def load_params(model: OVIB, params: Params) -> None:
    """Copy a tree of flax parameters into the module."""
    layers = dense_layers(params)
    for name, layer in model.named_children():
        assert isinstance(layer, nn.Linear)
        layer.weight.copy_(torch.tensor(np.asarray(layers[name]["kernel"]).T))
        if layer.bias is not None:
            layer.bias.copy_(torch.tensor(np.asarray(layers[name]["bias"])))


def flax_params(model: OVIB) -> Params:
    """The weights as parameters of `ovibjax.encoder.model`, one kernel per view: the inverse of `load_params`."""
    views, tree = model.arch.n_views, dict[str, Any]()
    for name, layer in model.named_children():
        leaves = {"kernel": layer.weight.T, "bias": layer.bias}
        arrays = {key: leaf.detach().numpy().copy() for key, leaf in leaves.items() if leaf is not None}
        if name in ("encoder_1", "direct", "head_1"):
            kernels = np.split(arrays["kernel"], views)
            tree |= {f"{name}_{view}": {"kernel": jnp.asarray(kernel)} for view, kernel in enumerate(kernels)}
            if "bias" in arrays:
                tree[f"{name}_bias"] = jnp.asarray(arrays["bias"])
        elif name in ("principal", "descriptor"):
            parts = {key: np.split(leaf, views, axis=-1) for key, leaf in arrays.items()}
            for view in range(views):
                tree[f"{name}_{view}"] = {key: jnp.asarray(part[view]) for key, part in parts.items()}
        else:
            tree[name] = {key: jnp.asarray(leaf) for key, leaf in arrays.items()}
    return {"params": tree}


def as_numbers(hypers: Hypers) -> dict[str, float]:
    """Hyperparameters as this module takes them."""
    return {name: float(value) for name, value in hypers._asdict().items()}


class Batch(NamedTuple):
    """One minibatch: fields and shapes of `ovibjax.encoder.loss.Batch`."""

    x: Tensor
    y: Tensor
    view_mask: Tensor
    prefix_mask: Tensor
    noise: Tensor


def gaussian_kl(mu: Tensor, logvar: Tensor) -> Tensor:
    return 0.5 * (mu.square() + logvar.exp() - logvar - 1.0).sum(-1)


def ard_kl(mu: Tensor, logvar: Tensor) -> Tensor:
    """Constants of Molchanov et al. (2017)."""
    ratio = logvar - (mu.square() + 1e-16).log()
    return (0.5 * F.softplus(-ratio) - 0.63576 * torch.sigmoid(1.87320 + 1.48695 * ratio) + 0.63576).sum(-1)


def composite_loss(
    model: OVIB, batch: Batch, hypers: dict[str, float], prior: str, bfloat16: bool = False
) -> tuple[Tensor, dict[str, Tensor]]:
    """The objective and its unweighted terms; `bfloat16` runs the matrix products of the network under autocast."""
    views = batch.view_mask[:, :, None]
    x = (batch.x * views).flatten(1)
    with torch.autocast("cpu", dtype=torch.bfloat16, enabled=bfloat16):
        mu, logvar = model.encode(x)
        z = mu + torch.exp(0.5 * logvar) * batch.noise
        descriptor = (model.decode(z, batch.prefix_mask).view_as(batch.x) * views).flatten(1)
        position = model.locate(descriptor)
    kl = {"gaussian": gaussian_kl, "ard": ard_kl}[prior]
    W = model.mean.weight
    terms = {
        "reconstruction": (x - descriptor).square().sum(-1).mean() / batch.x.shape[2],
        "localization": (batch.y - position).square().sum(-1).mean(),
        "rate": kl(mu, logvar).mean(),
        "orthogonality": (W @ W.T - torch.eye(W.shape[0])).square().sum() / W.shape[0] ** 2,
    }
    loss = terms["reconstruction"] + hypers["alpha"] * terms["localization"]
    loss = loss + hypers["beta"] * terms["rate"] + hypers["gamma"] * terms["orthogonality"]
    return loss, terms


def make_optimizer(model: OVIB, hypers: dict[str, float], static: TrainConfig) -> torch.optim.AdamW:
    """AdamW in which linear paths learn at their share of the rate."""
    groups: dict[float, list[Tensor]] = {}
    for name, parameter in model.named_parameters():
        slow = static.arch.linear and name.split(".")[0] in LINEAR_PATHS
        groups.setdefault(static.linear_lr if slow else 1.0, []).append(parameter)
    return torch.optim.AdamW(
        [{"params": parameters, "lr": hypers["lr"] * share} for share, parameters in groups.items()],
        weight_decay=hypers["weight_decay"],
        eps=1e-8,
        fused=True,
    )


def make_scheduler(
    optimizer: torch.optim.Optimizer, warmup: int, total: int, decay: str = "linear"
) -> torch.optim.lr_scheduler.LambdaLR:
    """Linear warm-up, then linear decay as in `ovibjax.encoder.epochs.make_optimizer`, or the former cosine."""
    if decay not in DECAYS:
        raise ValueError(f"decay is one of {', '.join(DECAYS)}, not {decay!r}")
    warmup = max(1, min(warmup, total // 5))

    def factor(step: int) -> float:
        left = min(max((total - step) / max(total - warmup, 1), 0.0), 1.0)
        return min((step + 1) / warmup, left if decay == "linear" else 0.5 * (1.0 - math.cos(math.pi * left)))

    return torch.optim.lr_scheduler.LambdaLR(optimizer, factor)


def train_step(
    model: OVIB,
    optimizer: torch.optim.Optimizer,
    batch: Batch,
    hypers: dict[str, float],
    static: TrainConfig,
    bfloat16: bool = False,
) -> Tensor:
    """One step on one minibatch; its loss and terms, in the order of `TERMS`."""
    loss, terms = composite_loss(model, batch, hypers, static.prior, bfloat16)
    optimizer.zero_grad()
    loss.backward()
    if static.clip is not None:
        nn.utils.clip_grad_norm_(model.parameters(), static.clip)
    optimizer.step()
    return torch.stack([loss.detach(), *(terms[name].detach() for name in TERMS[1:])])


def train_member(
    seed: int,
    hypers: dict[str, float],
    x: np.ndarray,
    y: np.ndarray,
    static: TrainConfig,
    *,
    bfloat16: bool = False,
    decay: str = "linear",
) -> tuple[OVIB, dict[str, float]]:
    """Train one member; the model, and the mean loss and terms over its last epoch.

    Args:
        seed: seeds initial weights, order, prefixes and noise.
        hypers: alpha, beta, gamma, lr, weight_decay; every example is nested.
        x: [N, M, r] features.
        y: [N, 3] standardised positions.
        static: the configuration given to `fit`.
        bfloat16: matrix products under autocast; parameters, optimizer and loss stay in float32.
        decay: of the learning rate, "linear" as in `fit`, or "cosine".
    """
    generator = torch.Generator().manual_seed(seed)
    assert hypers.get("nesting", 1.0) == 1.0
    features, targets = (torch.tensor(np.asarray(array, np.float32)) for array in (x, y))
    lengths = torch.tensor(static.prefixes)
    coordinates = torch.arange(static.arch.latent)
    n = features.shape[0]
    size, per_epoch, epochs = schedule_of(static.steps, static.batch, n)
    view_mask = torch.as_tensor(view_rows(static, size)[0])

    model = OVIB(static.arch)
    initialise(model, generator)
    linear_start(model, features)
    optimizer = make_optimizer(model, hypers, static)
    scheduler = make_scheduler(optimizer, static.warmup, epochs * per_epoch, decay)
    trace = torch.empty(per_epoch, len(TERMS))
    for _ in range(epochs):
        order = torch.randperm(n, generator=generator)
        for step in range(per_epoch):
            index = order[step * size : (step + 1) * size]
            length = lengths[torch.randint(len(lengths), (size,), generator=generator)]
            batch = Batch(
                x=features[index],
                y=targets[index],
                view_mask=view_mask,
                prefix_mask=(coordinates < length[:, None]).float(),
                noise=torch.randn(size, static.arch.latent, generator=generator),
            )
            trace[step] = train_step(model, optimizer, batch, hypers, static, bfloat16)
            scheduler.step()
    return model, dict(zip(TERMS, trace.mean(0).tolist(), strict=True))

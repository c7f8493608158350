"""The PyTorch peer of `ovibjax.encoder.train.fit`: one member per call, to be looped over by a benchmark.

The same model, objective, optimizer, schedule, batch, steps and sampling distributions, written as one writes it in
eager PyTorch: data in memory, indexed by a permutation per epoch; AdamW in its fused form, which is the fastest on a
CPU. The draws come from a torch generator, so a member agrees with its JAX twin in distribution, not number by number.
The caller chooses the number of threads (`torch.set_num_threads`).
"""

import math
from typing import Any, NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ovibjax.encoder.model import Architecture, dense_layers
from ovibjax.encoder.train import TrainConfig, view_rows

TERMS = ("loss", "reconstruction", "localization", "rate", "orthogonality")


class OVIB(nn.Module):
    """The network; layers carry the names of the flax module."""

    def __init__(self, arch: Architecture) -> None:
        super().__init__()
        features = arch.n_views * arch.view_dim
        self.encoder_1 = nn.Linear(features, arch.hidden)
        self.encoder_2 = nn.Linear(arch.hidden, arch.last_hidden)
        self.mean = nn.Linear(arch.last_hidden, arch.latent)
        self.logvar = nn.Linear(arch.last_hidden, arch.latent)
        self.decoder_1 = nn.Linear(arch.latent, arch.last_hidden)
        self.decoder_2 = nn.Linear(arch.last_hidden, arch.hidden)
        self.descriptor = nn.Linear(arch.hidden, features)
        self.head_1 = nn.Linear(features, arch.head)
        self.head_2 = nn.Linear(arch.head, 3)

    def encode(self, x: Tensor) -> tuple[Tensor, Tensor]:
        hidden = gelu(self.encoder_2(gelu(self.encoder_1(x))))
        # float() matters under autocast alone: the loss is computed in float32.
        return self.mean(hidden).float(), self.logvar(hidden).float().clamp(-12.0, 6.0)

    def decode(self, z: Tensor) -> Tensor:
        return self.descriptor(gelu(self.decoder_2(gelu(self.decoder_1(z))))).float()

    def locate(self, descriptor: Tensor) -> Tensor:
        return self.head_2(gelu(self.head_1(descriptor))).float()


def gelu(x: Tensor) -> Tensor:
    return F.gelu(x, approximate="tanh")


@torch.no_grad()
def initialise(model: OVIB, arch: Architecture, generator: torch.Generator) -> None:
    """The initial distributions of the flax module: He or LeCun normal, truncated at two deviations; zero biases."""
    plain = (model.mean, model.descriptor, model.head_2)
    for layer in model.children():
        assert isinstance(layer, nn.Linear)
        nn.init.zeros_(layer.bias)
        if layer is model.logvar:
            nn.init.normal_(layer.weight, std=math.sqrt(0.01 / layer.in_features), generator=generator)
            nn.init.constant_(layer.bias, arch.logvar_bias)
            continue
        # flax widens the truncated normal, so that its deviation after truncation is the wanted one.
        std = math.sqrt((1.0 if layer in plain else 2.0) / layer.in_features) / 0.87962566103423978
        nn.init.trunc_normal_(layer.weight, std=std, a=-2.0 * std, b=2.0 * std, generator=generator)


@torch.no_grad()
def load_params(model: OVIB, params: dict[str, Any]) -> None:
    """Copy a tree of flax parameters into the module."""
    layers = dense_layers(params)
    for name, layer in model.named_children():
        assert isinstance(layer, nn.Linear)
        layer.weight.copy_(torch.tensor(np.asarray(layers[name]["kernel"]).T))
        layer.bias.copy_(torch.tensor(np.asarray(layers[name]["bias"])))


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
        z = (mu + torch.exp(0.5 * logvar) * batch.noise) * batch.prefix_mask
        descriptor = (model.decode(z).view_as(batch.x) * views).flatten(1)
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


def make_scheduler(optimizer: torch.optim.Optimizer, warmup: int, total: int) -> torch.optim.lr_scheduler.LambdaLR:
    """Linear warm-up and cosine decay, as `ovibjax.encoder.train.make_optimizer`."""
    warmup = max(1, min(warmup, total // 5))

    def factor(step: int) -> float:
        fall = min(max((step - warmup) / max(total - warmup, 1), 0.0), 1.0)
        return min((step + 1) / warmup, 0.5 * (1.0 + math.cos(math.pi * fall)))

    return torch.optim.lr_scheduler.LambdaLR(optimizer, factor)


def train_member(
    seed: int,
    hypers: dict[str, float],
    x: np.ndarray,
    y: np.ndarray,
    static: TrainConfig,
    *,
    bfloat16: bool = False,
) -> dict[str, float]:
    """Train one member; the mean loss and terms over its last epoch.

    Args:
        seed: seeds initial weights, order, prefixes and noise.
        hypers: alpha, beta, gamma, lr, weight_decay; every example is nested.
        x: [N, M, r] features.
        y: [N, 3] standardised positions.
        static: the configuration given to `fit`.
        bfloat16: matrix products under autocast; parameters, optimizer and loss stay in float32.
    """
    generator = torch.Generator().manual_seed(seed)
    assert hypers.get("nesting", 1.0) == 1.0
    features, targets = (torch.tensor(np.asarray(array, np.float32)) for array in (x, y))
    lengths = torch.tensor(static.prefixes)
    coordinates = torch.arange(static.arch.latent)
    n = features.shape[0]
    size = min(static.batch, n)
    view_mask = torch.as_tensor(view_rows(static, size)[0])
    per_epoch = n // size
    epochs = -(-static.steps // per_epoch)

    model = OVIB(static.arch)
    initialise(model, static.arch, generator)
    optimizer = torch.optim.AdamW(
        model.parameters(), lr=hypers["lr"], weight_decay=hypers["weight_decay"], eps=1e-8, fused=True
    )
    scheduler = make_scheduler(optimizer, static.warmup, epochs * per_epoch)
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
            loss, terms = composite_loss(model, batch, hypers, static.prior, bfloat16)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            scheduler.step()
            trace[step] = torch.stack([loss.detach(), *(terms[name].detach() for name in TERMS[1:])])
    return dict(zip(TERMS, trace.mean(0).tolist(), strict=True))

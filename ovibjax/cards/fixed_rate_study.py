"""The conference version as data: fixed-rate models over two weights, the attention baseline, and encoding times."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray

from ovibjax.cards.job import Sweep
from ovibjax.edge.member import DIMS, UNITS, FuseAndLocate, TrainAndJudge
from ovibjax.encoder.attention import AttentionConfig, init_attention, predict
from ovibjax.encoder.model import Architecture, encode, init
from ovibjax.encoder.train import TrainConfig, fixed_rate
from ovibjax.encoder.training_data import MemberData
from ovibjax.link.latency import compute_ms_at, measure_host
from ovibjax.sweep.work import Along
from ovibjax.views import full_mode

K = 16
"""The fixed rate: floats sent."""


@dataclass(frozen=True)
class FixedRateStudy:
    """What the study found.

    Attributes:
        trained: errors and active dimensions [point, seed]; coordinates beta and gamma along `point`.
        fusion: the attention baseline [seed].
        host_ms: encoding one frame on this machine, by method.
    """

    trained: xarray.Dataset
    fusion: xarray.Dataset
    host_ms: dict[str, float]

    def at(self, beta: float, gamma: float, metric: str = "test_mean_m") -> np.ndarray:
        """[seeds] a metric at one point."""
        match = np.isclose(self.trained.beta.values, beta) & np.isclose(self.trained.gamma.values, gamma)
        return self.trained[metric].values[int(np.flatnonzero(match)[0])]

    def best(self) -> tuple[float, float]:
        """(beta, gamma) with the lowest mean validation error."""
        point = int(np.argmin(self.trained.val_mean_m.mean("seed").values))
        return float(self.trained.beta[point]), float(self.trained.gamma[point])


def train_config(member: MemberData, steps: int | None, precision: str) -> TrainConfig:
    """Static choices of a fixed-rate model on these data."""
    views, dim = member.train.x.shape[1:]
    arch = Architecture(n_views=views, view_dim=dim)
    return fixed_rate(TrainConfig(arch, steps=steps, precision=precision), K)


def train_grid(
    sweep: Sweep,
    points: Sequence[tuple[float, float]],
    static: TrainConfig,
    members: list[MemberData],
    seeds: list[int],
) -> xarray.Dataset:
    """Fixed-rate models with the ARD prior (paper, eq. "ardkl") at every point and seed.

    Args:
        sweep: runs a sweep.
        points: weights (beta, gamma) of the ARD term and of the orthogonality penalty.
        static: choices of a model, see `train_config`.
        members: data per seed.
        seeds: seeds, common to all points.

    Returns:
        Errors and active dimensions, [point, seed].
    """
    beta, gamma = zip(*points, strict=True)
    dataset = sweep(
        "training fixed-rate models",
        TrainAndJudge(static, (K,), (full_mode(static.arch.n_views),)),
        {"beta": beta, "gamma": gamma, "seed": seeds},
        Along("seed", members),
        zipped=[["beta", "gamma"]],
        dims=DIMS,
        units=UNITS,
    )
    return dataset.squeeze(["mode", "prefix"]).rename_dims({"beta_gamma": "point"})


def train_fusion(sweep: Sweep, steps: int, members: list[MemberData], seeds: list[int]) -> xarray.Dataset:
    """The baseline: attention over all views, without a bottleneck.

    Args:
        sweep: runs a sweep.
        steps: training steps.
        members: data per seed.
        seeds: the seeds.

    Returns:
        Mean validation and test errors, [seed].
    """
    views, dim = members[0].train.x.shape[1:]
    return sweep(
        "fusion baseline",
        FuseAndLocate(AttentionConfig(n_views=views, view_dim=dim, steps=steps)),
        {"seed": seeds},
        Along("seed", members),
        units={"val_mean_m": "m", "test_mean_m": "m"},
    )


def time_encoders(member: MemberData) -> dict[str, float]:
    """Median milliseconds per frame on this machine, by method; untrained weights cost the same."""
    views, dim = member.train.x.shape[1:]
    x = member.test_x[:1]
    cost = {}
    for latent in (K, 128):
        arch = Architecture(n_views=views, view_dim=dim, latent=latent)
        params = _any_weights(jax.eval_shape(lambda key, arch=arch: init(key, arch), jax.random.key(0)))
        run_once = jax.jit(lambda p, v, arch=arch: encode(p, v.reshape(1, -1), arch)[0])
        cost[f"O-VIB, K = {latent}"] = _median_ms(lambda _, f=run_once, p=params: f(p, x))
    static = AttentionConfig(n_views=views, view_dim=dim)
    fusion = _any_weights(jax.eval_shape(lambda key: init_attention(key, static), jax.random.key(0)))
    mask = jnp.ones(views, jnp.float32)
    fuse = jax.jit(lambda p, v: predict(p, v, mask, static))
    return cost | {"attention fusion": _median_ms(lambda _: fuse(fusion, x))}


def _any_weights(shapes: Any) -> Any:
    """Small random numbers of these shapes; drawn by NumPy: initialisers take longer to compile than the rest."""
    rng = np.random.default_rng(0)
    return jax.tree.map(lambda leaf: jnp.asarray(0.05 * rng.standard_normal(leaf.shape), leaf.dtype), shapes)


def _median_ms(encode_once: Any) -> float:
    return float(compute_ms_at(measure_host(encode_once, [1]), 1))


def table_rows(found: FixedRateStudy) -> list[dict[str, Any]]:
    """One tidy row per member."""
    rows: list[dict[str, Any]] = []
    for point in range(found.trained.sizes["point"]):
        for seed in found.trained.seed.values:
            part = found.trained.isel(point=point).sel(seed=seed)
            known = {"method": "ovib_fixed", "k": K, "beta": float(part.beta), "gamma": float(part.gamma)}
            errors = {name: float(part[name]) for name in ("val_mean_m", "test_mean_m", "test_p90_m", "eta")}
            more = {"active_dims": int(part.active_dims), "diverged": bool(part.diverged)}
            rows.append(known | {"seed": int(seed)} | errors | more)
    for seed in found.fusion.seed.values:
        part = found.fusion.sel(seed=seed)
        errors = {name: float(part[name]) for name in ("val_mean_m", "test_mean_m")}
        blank = dict.fromkeys(rows[0], "")
        rows.append(blank | {"method": "attention_fusion", "seed": int(seed), "diverged": bool(part.diverged)} | errors)
    return rows

"""The encoder ablation as data: variants and seeds trained in one sweep, coordinate orderings judged in another."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray

from ovibjax.cards.job import Sweep
from ovibjax.cards.recipe_study import RECIPE_VARIANTS, train_recipe
from ovibjax.edge.judging import Trained, judge_prefixes
from ovibjax.edge.member import DIMS, ORDERINGS, UNITS, JudgeOrdering, TrainAndJudge
from ovibjax.encoder.loss import BETA, GAMMA
from ovibjax.encoder.orthogonality import SingularValues, singular_values
from ovibjax.encoder.pca import fit_pca
from ovibjax.encoder.train import TrainConfig
from ovibjax.encoder.training_data import MemberData
from ovibjax.sweep.select import tree_of
from ovibjax.sweep.work import Along
from ovibjax.views import full_mode, mode_mask


@dataclass(frozen=True)
class Ablation:
    """What the ablation found.

    Attributes:
        trained: errors of every variant of the paper's [variant, seed, prefix].
        recipe: errors of those of `RECIPE_VARIANTS` that were trained, [variant, seed, prefix].
        orders: mean test errors of the full model's coordinates in other orders [ordering, seed, prefix].
        pca: [seeds, prefixes] mean test errors of the linear code under the full model's localizer.
        spectra: singular values of W per orthogonality weight, leading axis the seeds.
    """

    trained: xarray.Dataset
    recipe: xarray.Dataset
    orders: xarray.DataArray
    pca: np.ndarray
    spectra: dict[float, SingularValues]

    @property
    def ks(self) -> list[int]:
        """Prefixes judged."""
        return [int(k) for k in self.trained.prefix.values]

    def at(self, variant: str, k: int, metric: str = "test_mean_m") -> np.ndarray:
        """[seeds] a metric of one variant at one prefix; `full` is the variant with the paper's weights."""
        if variant == "pca":
            return self.pca[:, self.ks.index(k)]
        if variant in RECIPE_VARIANTS:
            return self.recipe[metric].sel(variant=variant, prefix=k).values
        return self.trained[metric].sel(variant=named(GAMMA) if variant == "full" else variant, prefix=k).values

    def selected_gamma(self, k: int) -> float:
        """The positive orthogonality weight with the lowest mean validation error at a prefix."""
        swept = [str(v) for v in self.trained.variant.values if str(v).startswith("gamma_")]
        means = [self.at(name, k, "val_mean_m").mean() for name in swept]
        return float(self.trained.gamma.sel(variant=swept[int(np.argmin(means))]))

    def random_errors(self) -> np.ndarray:
        """[seeds, prefixes] errors averaged over the random permutations."""
        return self.orders.sel(ordering=list(ORDERINGS[1:-1])).mean("ordering").values


def named(gamma: float) -> str:
    """Name of the variant with an orthogonality weight."""
    return f"gamma_{gamma:g}" if gamma > 0 else "no_orthogonality"


def ablate(
    sweep: Sweep,
    static: TrainConfig,
    gammas: tuple[float, ...],
    recipe: Sequence[str],
    ks: tuple[int, ...],
    members: list[MemberData],
    seeds: list[int],
) -> Ablation:
    """Train every variant on every seed, those of the paper in one sweep, then judge orderings and PCA.

    Args:
        sweep: runs a sweep.
        static: architecture and steps.
        gammas: positive orthogonality weights; the paper's must be among them.
        recipe: which of `RECIPE_VARIANTS` to train, at least one.
        ks: prefixes judged.
        members: data per seed.
        seeds: seeds, common to all variants.

    Returns:
        The ablation.
    """
    variants = {named(gamma): (BETA, gamma, 1.0) for gamma in (0.0, *gammas)}
    variants |= {"no_rate": (0.0, GAMMA, 1.0), "no_nesting": (BETA, GAMMA, 0.0)}
    beta, gamma, nesting = zip(*variants.values(), strict=True)
    mode = full_mode(static.arch.n_views)
    coords = {"prefix": list(ks)}
    dataset = sweep(
        "training and judging variants",
        TrainAndJudge(static, ks, (mode,), keep_params=True),
        {"variant": list(variants), "beta": beta, "gamma": gamma, "nesting": nesting, "seed": seeds},
        Along("seed", members),
        zipped=[["variant", "beta", "gamma", "nesting"]],
        dims=DIMS,
        coords=coords | {"mode": [mode]},
        units=UNITS,
    )
    trained = dataset.isel(mode=0).swap_dims({dataset.variant.dims[0]: "variant"})
    changed = train_recipe(sweep, static, recipe, ks, members, seeds)
    chosen = {"variant": named(GAMMA)}
    params = [{"params": tree_of(trained, "params", chosen | {"seed": seed})} for seed in seeds]
    full = [Trained(*pair) for pair in zip(members, params, strict=True)]
    orders = sweep(
        "orderings of coordinates",
        JudgeOrdering(static.arch, ks),
        {"ordering": list(ORDERINGS), "seed": seeds},
        Along("seed", full),
        dims={"test_mean_m": ["prefix"]},
        coords=coords,
        stage="judge",
    )
    return Ablation(trained, changed, orders.test_mean_m, judge_pca(static, ks, full), spectra_by_gamma(trained))


def judge_pca(static: TrainConfig, ks: tuple[int, ...], full: list[Trained]) -> np.ndarray:
    """[seeds, prefixes] mean test errors of the linear code under each full model's localizer."""
    arch = static.arch
    mask = mode_mask(full_mode(arch.n_views), arch.n_views)

    def one(trained: Trained) -> np.ndarray:
        pca = fit_pca(trained.data.train.x, arch.latent)
        judge = jax.jit(judge_prefixes, static_argnames="arch")
        judged = judge(trained, arch=arch, view_mask=mask, prefixes=jnp.array(ks), pca=pca)
        return np.asarray(judged.test_error_m.mean(axis=1))

    return np.stack([one(trained) for trained in full])


def spectra_by_gamma(trained: xarray.Dataset) -> dict[float, SingularValues]:
    """Singular values of W against Proposition 1's bound, per orthogonality weight, leading axis the seeds."""
    found = {}
    for variant in trained.variant.values:
        if str(variant) in ("no_rate", "no_nesting"):
            continue
        part = trained.sel(variant=variant)
        projections = jnp.swapaxes(jnp.asarray(part["params.mean.kernel"].values), 1, 2)
        found[float(part.gamma)] = jax.device_get(jax.vmap(singular_values)(projections))
    return found


def table_rows(ablation: Ablation) -> list[dict[str, Any]]:
    """One tidy row per member and prefix, then per ordering, seed and prefix."""
    rows: list[dict[str, Any]] = []
    metrics, weights = ("val_mean_m", "test_mean_m", "test_p90_m", "eta"), ("beta", "gamma", "nesting")
    paper = dict(zip(weights, (BETA, GAMMA, 1.0), strict=True))
    trained = ablation.trained
    for dataset, variant in [(d, v) for d in (trained, ablation.recipe) for v in d.variant.values]:
        for seed in trained.seed.values:
            part = dataset.sel(variant=variant, seed=seed)
            known = {"variant": str(variant), "ordering": "learned", "seed": int(seed)}
            known |= {name: float(part[name]) if name in part.coords else paper[name] for name in weights}
            for i, k in enumerate(ablation.ks):
                errors = {name: float(part[name][i]) for name in metrics}
                rows.append(known | {"k": k, "diverged": bool(part.diverged)} | errors)
    blank = dict.fromkeys((*weights, "diverged", *metrics), "")
    for i, seed in enumerate(trained.seed.values):
        for j, k in enumerate(ablation.ks):
            point = {"seed": int(seed), "k": k}
            for ordering in ORDERINGS[1:]:
                error = float(ablation.orders.sel(ordering=ordering, seed=seed, prefix=k))
                name = {"variant": named(GAMMA), "ordering": ordering}
                rows.append({**rows[0], **blank, **point, **name, "test_mean_m": error})
            name = {"variant": "pca", "ordering": "learned"}
            rows.append({**rows[0], **blank, **point, **name, "test_mean_m": float(ablation.pca[i, j])})
    return rows

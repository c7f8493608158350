"""The encoder ablation as data: variants and seeds trained in one sweep, coordinate orderings judged in another."""

from collections.abc import Mapping, Sequence
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
from ovibjax.encoder.loss import ALPHA, BETA, GAMMA
from ovibjax.encoder.orthogonality import SingularValues, singular_values
from ovibjax.encoder.pca import fit_pca
from ovibjax.encoder.train import TrainConfig
from ovibjax.encoder.training_data import MemberData
from ovibjax.report.claims import interval
from ovibjax.sweep.select import tree_of
from ovibjax.sweep.work import Along
from ovibjax.views import full_mode, mode_mask

Weights = tuple[float, float, float, float]
"""Weights (alpha, beta, gamma) and the share of examples that are nested."""


@dataclass(frozen=True)
class Ablation:
    """What the ablation found.

    Attributes:
        trained: errors of every variant of the paper's [variant, seed, prefix].
        recipe: errors of those of `RECIPE_VARIANTS` that were trained, [variant, seed, prefix].
        orders: the full model's coordinates in other orders: mean test errors [ordering, seed, prefix], and those of
            every test frame [ordering, seed, prefix, frame].
        pca: [seeds, prefixes] mean test errors of the linear code under the full model's localizer.
        spectra: singular values of W per orthogonality weight, leading axis the seeds.
    """

    trained: xarray.Dataset
    recipe: xarray.Dataset
    orders: xarray.Dataset
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

    def order_m(self, order: str) -> np.ndarray:
        """[seeds, prefixes] mean test errors in an order: learned, tail_first, or the mean of random ones."""
        return self.orders.test_mean_m.sel(ordering=permutations(order)).mean("ordering").values

    def half_over_frames_m(self, order: str) -> np.ndarray:
        """[prefixes] half-width of the 95 % interval over the test frames of a seed, mean over seeds."""
        # The paper: "Panel (b) reports 95 % confidence intervals over 750 test frames. The teal band additionally shows
        # standard deviation across eight random coordinate permutations."
        errors = self.orders.test_error_m.sel(ordering=permutations(order)).mean("ordering")
        of_seed = [[interval(errors.sel(seed=s, prefix=k).values).half for k in self.ks] for s in errors.seed.values]
        return np.mean(of_seed, axis=0)

    def deviation_of_permutations_m(self) -> np.ndarray:
        """[prefixes] standard deviation across the random permutations, mean over seeds."""
        return self.orders.test_mean_m.sel(ordering=permutations("random")).std("ordering", ddof=1).mean("seed").values


def permutations(order: str) -> list[str]:
    """Those of `ORDERINGS` that an order stands for: all eight if it is random."""
    return list(ORDERINGS[1:-1]) if order == "random" else [order]


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
    variants: dict[str, Weights] = {named(gamma): (ALPHA, BETA, gamma, 1.0) for gamma in (0.0, *gammas)}
    variants |= {"no_rate": (ALPHA, 0.0, GAMMA, 1.0), "no_nesting": (ALPHA, BETA, GAMMA, 0.0)}
    trained = train_variants(sweep, static, ks, variants, members, seeds)
    changed = train_recipe(sweep, static, recipe, ks, members, seeds)
    chosen = {"variant": named(GAMMA)}
    params = [{"params": tree_of(trained, "params", chosen | {"seed": seed})} for seed in seeds]
    full = [Trained(*pair) for pair in zip(members, params, strict=True)]
    orders = sweep(
        "orderings of coordinates",
        JudgeOrdering(static.arch, ks),
        {"ordering": list(ORDERINGS), "seed": seeds},
        Along("seed", full),
        dims={"test_mean_m": ["prefix"], "test_error_m": ["prefix", "frame"]},
        coords={"prefix": list(ks)},
        stage="judge",
    )
    return Ablation(trained, changed, orders, judge_pca(static, ks, full), spectra_by_gamma(trained))


def train_variants(
    sweep: Sweep,
    static: TrainConfig,
    ks: tuple[int, ...],
    variants: Mapping[str, Weights],
    members: list[MemberData],
    seeds: list[int],
) -> xarray.Dataset:
    """Train and judge variants that differ in their weights, in one program.

    A second call of equal `static` and `ks` takes the program of the first.

    Args:
        sweep: runs a sweep.
        static: architecture and steps.
        ks: prefixes judged.
        variants: weights by name.
        members: data per seed.
        seeds: seeds, common to all variants.

    Returns:
        Members [variant, seed], with their parameters.
    """
    mode = full_mode(static.arch.n_views)
    names = ("alpha", "beta", "gamma", "nesting")
    dataset = sweep(
        "training and judging variants",
        TrainAndJudge(static, ks, (mode,), keep_params=True),
        {
            "variant": list(variants),
            **dict(zip(names, zip(*variants.values(), strict=True), strict=True)),
            "seed": seeds,
        },
        Along("seed", members),
        zipped=[["variant", *names]],
        dims=DIMS,
        coords={"prefix": list(ks), "mode": [mode]},
        units=UNITS,
    )
    return dataset.isel(mode=0).swap_dims({dataset.variant.dims[0]: "variant"})


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
    metrics, weights = ("val_mean_m", "test_mean_m", "test_p90_m", "eta"), ("alpha", "beta", "gamma", "nesting")
    paper = dict(zip(weights, (ALPHA, BETA, GAMMA, 1.0), strict=True))
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
                error = float(ablation.orders.test_mean_m.sel(ordering=ordering, seed=seed, prefix=k))
                name = {"variant": named(GAMMA), "ordering": ordering}
                rows.append({**rows[0], **blank, **point, **name, "test_mean_m": error})
            name = {"variant": "pca", "ordering": "learned"}
            rows.append({**rows[0], **blank, **point, **name, "test_mean_m": float(ablation.pca[i, j])})
    return rows

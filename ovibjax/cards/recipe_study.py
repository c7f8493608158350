"""What our training recipe adds to the paper's, each taken away alone and all together; PCA's code with our decoder."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import xarray

from ovibjax.cards.job import Sweep
from ovibjax.edge.member import DIMS, UNITS, TrainAndJudge
from ovibjax.encoder.loss import LR
from ovibjax.encoder.recipe import PAPER_LR, PAPER_PREFIXES
from ovibjax.encoder.train import TrainConfig, paper_recipe
from ovibjax.encoder.training_data import MemberData
from ovibjax.sweep.work import Along
from ovibjax.views import full_mode

RECIPE_VARIANTS = ("no_linear_start", "no_completion", "gelu", "paper_prefixes", "paper_recipe", "pca_completed")
"""Names of the changes: a dense network, a decoder that does not complete, GELU for the sine, prefixes drawn evenly,
the paper's recipe taken literally, and principal coordinates in place of the learned code."""


def changed(variant: str, static: TrainConfig, n: int) -> TrainConfig:
    """The recipe as one of `RECIPE_VARIANTS` has it.

    Args:
        variant: one of `RECIPE_VARIANTS`.
        static: the recipe.
        n: training examples.

    Returns:
        The static choices of the variant.
    """
    if variant == "paper_recipe":
        return paper_recipe(static, n)
    if variant == "paper_prefixes":
        return replace(static, prefixes=tuple(min(k, static.arch.latent) for k in PAPER_PREFIXES))
    change: dict[str, dict[str, Any]] = {
        "no_linear_start": {"kind": "dense"},
        "no_completion": {"kind": "linear"},
        "gelu": {"wave": "gelu"},
        "pca_completed": {"encoder": "principal"},
    }
    return replace(static, arch=replace(static.arch, **change[variant]))


def train_recipe(
    sweep: Sweep,
    static: TrainConfig,
    variants: Sequence[str],
    ks: tuple[int, ...],
    members: list[MemberData],
    seeds: list[int],
) -> xarray.Dataset:
    """Train and judge variants of the recipe on every seed; each is a program of its own.

    Args:
        sweep: runs a sweep.
        static: the recipe.
        variants: some of `RECIPE_VARIANTS`, at least one.
        ks: prefixes judged.
        members: data per seed.
        seeds: seeds, common to all variants.

    Returns:
        Errors [variant, seed, prefix].
    """
    mode, n = full_mode(static.arch.n_views), len(members[0].train.x)
    trained = [
        sweep(
            f"training {variant.replace('_', ' ')}",
            TrainAndJudge(changed(variant, static, n), ks, (mode,), lr=PAPER_LR if variant == "paper_recipe" else LR),
            {"seed": seeds},
            Along("seed", members),
            dims=DIMS,
            coords={"prefix": list(ks), "mode": [mode]},
            units=UNITS,
        )
        for variant in variants
    ]
    return xarray.concat(trained, xarray.DataArray(list(variants), dims="variant", name="variant")).isel(mode=0)

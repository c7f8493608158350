"""Where the rate and orthogonality terms matter: what each is worth at several weights alpha of localization.

The paper gives (alpha, beta, gamma) = (1, 1e-3, 0.1) and not the unit of its positions. In standardised units, which
are ours, the square of an error of 4 m is 0.001, a hundredth of what the rate term costs; square metres, which are an
alpha of the squared scale of positions, turn that round.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray

from ovibjax.cards.ablation_study import Weights, train_variants
from ovibjax.cards.job import Sweep
from ovibjax.encoder.loss import ALPHA, BETA, GAMMA
from ovibjax.encoder.train import TrainConfig
from ovibjax.encoder.training_data import MemberData
from ovibjax.report.claims import interval

ARMS = {"full": (BETA, GAMMA), "no_rate": (0.0, GAMMA), "no_orthogonality": (BETA, 0.0)}
"""Weights (beta, gamma) of the model with both terms, and without either."""

PREFIXES = (16, 35)
"""Prefixes that effects are stated at: a short one, and the paper's."""


@dataclass(frozen=True)
class AlphaEffects:
    """Errors with and without a term, at every alpha.

    Attributes:
        by_alpha: per alpha, members [variant, seed, prefix] with the variants of `ARMS`; the first is the paper's.
    """

    by_alpha: Mapping[float, xarray.Dataset]

    def gain_m(self, arm: str, alpha: float, k: int) -> np.ndarray:
        """[seeds] error without a term minus error with it, paired: what the term is worth, metres."""
        error = self.by_alpha[alpha].test_mean_m.sel(prefix=k)
        return np.asarray(error.sel(variant=arm).values - error.sel(variant="full").values)

    def rate_share(self, alpha: float) -> float:
        """How many times the weighted localization term the weighted rate term is at the end of training."""
        full = self.by_alpha[alpha].sel(variant="full")
        return float(BETA * full.rate.mean() / (alpha * full.localization.mean()))

    def rows(self) -> list[dict[str, Any]]:
        """One row per alpha and prefix: error of the full model, and what each term is worth."""
        return [
            {
                "alpha": f"{alpha:.0f}",
                "k": k,
                "full_m": interval(errors.test_mean_m.sel(variant="full", prefix=k).values).text(),
                "rate_is_worth_m": interval(self.gain_m("no_rate", alpha, k)).text(),
                "orthogonality_is_worth_m": interval(self.gain_m("no_orthogonality", alpha, k)).text(),
                "rate_term_over_localization": f"{self.rate_share(alpha):.2g}",
            }
            for alpha, errors in self.by_alpha.items()
            for k in PREFIXES
        ]


def alpha_text(alpha: float) -> str:
    """An alpha to two digits, as figures and claims write it."""
    return f"{float(f'{alpha:.2g}'):,g}"


def metres_alpha(members: Sequence[MemberData]) -> float:
    """The alpha at which localization counts in square metres: the squared scale of positions, 1.6e4 for the town."""
    return float(np.mean([float(member.standardizer.scale_m) ** 2 for member in members]))


def alpha_effects(
    sweep: Sweep,
    static: TrainConfig,
    trained: xarray.Dataset,
    alphas: Sequence[float],
    members: list[MemberData],
    seeds: list[int],
) -> AlphaEffects:
    """Train all arms at further alphas; those of the paper's alpha are there already.

    Args:
        sweep: runs a sweep.
        static: architecture and steps, those of `trained`: the program is the same.
        trained: the ablation's members, on these seeds and maybe more.
        alphas: further weights of localization.
        members: data per seed.
        seeds: seeds.

    Returns:
        The effects, on these seeds.
    """
    variants: dict[str, Weights] = {
        f"{arm} {alpha:g}": (alpha, beta, gamma, 1.0) for alpha in alphas for arm, (beta, gamma) in ARMS.items()
    }
    ks = tuple(int(k) for k in trained.prefix.values)
    further = train_variants(sweep, static, ks, variants, members, seeds)
    at_papers = {"full": f"gamma_{GAMMA:g}"}
    by_alpha = {ALPHA: trained.sel(seed=seeds, variant=[at_papers.get(arm, arm) for arm in ARMS])}
    by_alpha |= {alpha: further.sel(variant=[f"{arm} {alpha:g}" for arm in ARMS]) for alpha in alphas}
    return AlphaEffects({alpha: part.assign_coords(variant=list(ARMS)) for alpha, part in by_alpha.items()})

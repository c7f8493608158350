"""The paper's claims about the encoder's components, by stated rules; Lemmas and Proposition; our recipe's parts."""

from collections.abc import Sequence

import numpy as np
from scipy.stats import ttest_rel

from ovibjax.cards.ablation_drawing import NAMES
from ovibjax.cards.ablation_study import Ablation, named
from ovibjax.encoder.bound_margins import check_bounds
from ovibjax.encoder.loss import GAMMA
from ovibjax.report.claims import Claim, interval

K = 35
"""Prefix at which the paper compares variants."""


def judge_claims(gammas: Sequence[float], found: Ablation) -> list[Claim]:
    """The paper's claims about the encoder, by stated rules.

    Args:
        gammas: positive orthogonality weights.
        found: the ablation.

    Returns:
        The claims, judged.
    """
    return [
        _nesting(found, 16, "-"),
        _nesting(found, K, "116.19 / 8.75 m = 13.3"),
        _ordering(found, "random orders", found.random_errors()),
        _ordering(found, "tail-first", found.orders.sel(ordering="tail_first").values),
        _component(found, "no_rate", "The rate term helps", "9.44 - 8.75 = 0.69 m"),
        _component(found, "no_orthogonality", "The orthogonality penalty helps", "9.30 - 8.75 = 0.55 m"),
        _gamma(gammas, found),
        _recipe(found),
        *_theory(found),
    ]


def _nesting(found: Ablation, k: int, paper: str) -> Claim:
    full, without = found.at("full", k), found.at("no_nesting", k)
    ratio = interval(without / full).text("", 1)
    return Claim.ratio_at_least(
        f"Nesting is needed at short prefixes: without it the error at k = {k} is 10 times larger",
        paper,
        f"{interval(without).text()} / {interval(full).text('m')}, ratio {ratio}",
        10.0,
        without,
        full,
    )


def _ordering(found: Ablation, name: str, other: np.ndarray) -> Claim:
    worse = other - found.orders.sel(ordering="learned").values
    half = found.ks.index(min(found.ks, key=lambda k: abs(k - 64)))
    behind = [k for i, k in enumerate(found.ks) if worse[:, i].mean() <= 0]
    first = min(behind, default=found.ks[-1])
    at_half = interval(worse[:, half]).text("m")
    return Claim.at_least(
        f"The learned order beats {name} until most coordinates are kept",
        "until most coordinates are retained",
        f"{name} worse by {at_half} at k = {found.ks[half]}, on average at every k below {first}",
        0.0,
        *worse.T[: half + 1],
        rule=f"paired interval above zero at every prefix up to {found.ks[half]}",
    )


def _component(found: Ablation, variant: str, text: str, paper: str) -> Claim:
    ablated, full = found.at(variant, K), found.at("full", K)
    gain, p = interval(ablated - full).text("m"), float(ttest_rel(ablated, full).pvalue)
    return Claim.less(
        f"{text} at k = {K}: error without it minus error of Full",
        paper,
        f"{gain} (paired t-test over {len(full)} common seeds: p = {p:.2g})",
        full,
        ablated,
        strict=True,
    )


def _gamma(gammas: Sequence[float], found: Ablation) -> Claim:
    base = found.at("full", K, "val_mean_m")
    larger = [gamma for gamma in gammas if gamma > GAMMA]
    gains = {gamma: found.at(named(gamma), K, "val_mean_m") - base for gamma in larger}
    return Claim.at_least(
        "Larger orthogonality weights do not improve the validation error",
        "validation selects γ = 0.1",
        f"selected γ = {found.selected_gamma(K):g}; validation error minus that of γ = 0.1: "
        + ", ".join(f"{interval(gain).text('m')} at γ = {gamma:g}" for gamma, gain in gains.items()),
        0.0,
        *gains.values(),
        rule="paired interval of every larger weight above zero",
    )


def _recipe(found: Ablation) -> Claim:
    parts = []
    for name in found.recipe.variant.values:
        worse = {k: interval(found.at(str(name), k) - found.at("full", k)) for k in (16, K)}
        parts.append(f"{NAMES[str(name)]} " + " / ".join(span.text() for span in worse.values()))
    return Claim.reported(
        f"What our recipe adds: error minus that of Full at k = 16 / {K}, each taken away alone",
        "-",
        "; ".join(parts) + " m",
        "not claims of the paper; the last one keeps PCA's code and trains decoder and localizer only",
    )


def _theory(found: Ablation) -> list[Claim]:
    spectra = found.spectra.values()
    texts = [
        f"γ = {gamma:g}: {s.values.min():.3f} to {s.values.max():.3f}, ε = {float(s.epsilon.max()):.2g}"
        for gamma, s in found.spectra.items()
    ]
    inside = all(
        np.all(s.values >= s.lower[:, None] - 1e-4) and np.all(s.values <= s.upper[:, None] + 1e-4) for s in spectra
    )
    proposition = Claim.true(
        "Proposition 1: the singular values of the trained projection W lie within sqrt(1 - ε) and sqrt(1 + ε)",
        "a theorem",
        "; ".join(texts),
        inside,
        "every seed; where ε is 1 or more the proposition promises nothing from below",
    )
    bounds = [
        Claim.true(
            check.statement,
            "a theorem",
            f"identity within {check.deviation:.1e}, smallest gap {check.gap_nats:.2g} nats",
            check.deviation < 1e-4 and check.gap_nats >= 0,
            "1,000 random linear-Gaussian models, all terms in closed form: identity to 1e-4, no negative gap",
        )
        for check in check_bounds()
    ]
    return [proposition, *bounds]

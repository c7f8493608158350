"""What bytes buy: claims of the study of real bytes, all of them ours."""

from collections.abc import Sequence

import numpy as np

from ovibjax.cards.bytes_choice import at_prefix, chosen, one_price
from ovibjax.cards.bytes_coding import PQ_BYTES
from ovibjax.cards.bytes_study import BytesRuns
from ovibjax.report.claims import Claim, interval

BUDGETS = (4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 40)
"""Bytes of code at which methods are compared."""

GOALS_M = {5: 8.0, 8: 5.0, 16: 3.5, 32: 2.8}
"""What training for bits was expected to reach, by bytes of code."""


def bytes_claims(found: BytesRuns, coding_us: dict[str, float], embedded: bool) -> list[Claim]:
    """Claims on real bytes.

    Args:
        found: what was found.
        coding_us: time to code and decode one code of 35 coordinates, and of all, in microseconds.
        embedded: whether the data are the embedded town, for which the goals in metres are stated.

    Returns:
        The claims, judged.
    """
    price = one_price(found.rows, BUDGETS)
    pca = "PCA's best, with its own decoder or ours, in any code"
    claims = [
        *([_goal(found, budget, goal_m) for budget, goal_m in GOALS_M.items()] if embedded else []),
        _against(found, "best_pca", pca, BUDGETS, None),
        _against(found, "best_pca", pca, BUDGETS, price),
        _against(found, "ard", "that of a fixed-rate model, in any code", BUDGETS, None),
        _against(found, "pq", "product quantisation", PQ_BYTES, None),
        *_codes_alike(found),
        Claim.true(
            "Streams are as short as their tables allow: none more than 2 bytes above 1.02 times its ideal length",
            "-",
            f"at most {found.excess_bytes:.2f} bytes above it",
            found.excess_bytes <= 2,
            "every stream of every method, prefix and test frame",
        ),
        Claim.true(
            "Coding and decoding a code takes less than 0.2 ms",
            "-",
            ", ".join(f"{name}: {time_us:.0f} us" for name, time_us in coding_us.items()),
            max(coding_us.values()) < 200,
            "processor time of one core here, median over test frames",
        ),
        _surrogate(found),
    ]
    return [claim.as_own() for claim in claims]


def _goal(found: BytesRuns, budget: int, goal_m: float) -> Claim:
    best = chosen(found.rows, "bits", budget)
    error_m = np.array([]) if best is None else best.error_m
    return Claim.at_most(
        f"Trained for bits, {budget} bytes of code localize to {goal_m:g} m",
        "-",
        f"{interval(error_m).text('m')} ({best.name if best else 'nothing is so small'})",
        goal_m,
        error_m,
        rule=f"interval at most {goal_m:g} m; coding chosen on validation",
    )


def gains_m(
    found: BytesRuns, rival: str, budgets: Sequence[int], price: float | None
) -> dict[int, tuple[np.ndarray, str]]:
    """What training for bits gains at equal bytes of code.

    Args:
        found: what was found.
        rival: a method, see `chosen`.
        budgets: bytes of code.
        price: of a bit; the best for each budget if None.

    Returns:
        By budget at which both have something to send: [seeds] the rival's error less ours, and what the rival sends.
    """
    gains = {}
    for budget in budgets:
        ours, theirs = chosen(found.rows, "bits", budget, price), chosen(found.rows, rival, budget)
        if ours is not None and theirs is not None:
            gains[budget] = (theirs.error_m - ours.error_m, theirs.name)
    return gains


def _against(found: BytesRuns, rival: str, words: str, budgets: Sequence[int], price: float | None) -> Claim:
    gains = gains_m(found, rival, budgets, price)
    text = "; ".join(f"{budget} bytes: {interval(gain).text('m')}" for budget, (gain, _) in gains.items())
    prices = "the best price of a bit for each budget" if price is None else f"one price for all, {price:g}"
    return Claim.at_least(
        f"Trained for bits, a code is at least as good as {words}, at equal bytes from {budgets[0]} to {budgets[-1]}, "
        f"with {prices}",
        "-",
        f"its error minus ours at {text or 'no size that both have'}",
        0.0,
        *([gain for gain, _ in gains.values()] or [np.array([])]),
        rule="paired interval not below zero at any budget; both codings chosen on validation",
    )


def _codes_alike(found: BytesRuns) -> list[Claim]:
    step = min(row["step"] for row in found.rows if row["code"] == "entropy" and row["method"] == "ovib")
    claims = []
    for k in (16, 35, 128):
        errors_m = {code: at_prefix(found.rows, code, k, step) for code in ("float32", "int8", "entropy")}
        pairs = [("int8", "float32"), ("entropy", "float32"), ("entropy", "int8")]
        differences = [errors_m[code] - errors_m[other] for code, other in pairs]
        words = [
            f"{code} less {other} {interval(difference).text('m')}"
            for (code, other), difference in zip(pairs, differences, strict=True)
        ]
        claims.append(
            Claim.at_most(
                f"Rounding costs nothing at k = {k}: float32, int8 and entropy-coded prefixes are within 0.3 m",
                "-",
                f"float32 {interval(errors_m['float32']).text('m')}; {', '.join(words)}",
                0.3,
                *differences,
                *(-difference for difference in differences),
                rule="paired interval of every difference within 0.3 m; entropy-coded with the finest step",
            )
        )
    return claims


def surrogate(found: BytesRuns, method: str) -> dict[float, tuple[np.ndarray, float]]:
    """The rate term beside the bits that codes take, by its weight.

    Args:
        found: what was found.
        method: `ovib` or `bits`.

    Returns:
        By setting: [seeds] the rate term of the last epoch in bits, and bits of all coordinates of test frames.
    """
    unit = np.log(2.0) if method == "ovib" else 1.0
    return {
        setting: (np.asarray(rate) / unit, float(found.per_coordinate[name, setting].sum()))
        for (name, setting), rate in sorted(found.rate.items(), key=lambda item: item[0])
        if name == method
    }


def _surrogate(found: BytesRuns) -> Claim:
    """The paper's rate term beside the bits that codes take."""
    text = "; ".join(
        f"β = {beta:g}: {interval(rate).mean * np.log(2):.0f} nats = {interval(rate).mean:.0f} bits, coded {bits:.0f} "
        f"bits"
        for beta, (rate, bits) in surrogate(found, "ovib").items()
    )
    return Claim.reported(
        "What the rate term stands for: its value in training beside the bits of all coordinates, entropy-coded",
        "-",
        text,
        "mean over seeds; coded with the finest step",
    )

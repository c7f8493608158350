"""Which coding of a method is taken within a budget of bytes: by validation error alone."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ovibjax.cards.bytes_coding import KS, Row
from ovibjax.encoder.loss import BETA

CODE, PACKET, COMPACT = "code_bytes", "packet_bytes", "compact_bytes"
"""What a budget is for: the code alone, a packet under the paper's header, one under the compact header."""

NAMES = {
    "bits": "trained for bits",
    "ovib": "O-VIB, entropy-coded",
    "floats": "O-VIB, float32",
    "int8": "O-VIB, int8",
    "ard": "fixed rate (ARD)",
    "pca": "PCA",
    "pca_completed": "PCA, our decoder",
    "pq": "product quantisation",
}
"""Methods that are compared; those without a code in their name may use any."""

_CODES_OF_OVIB = {"floats": "float32", "int8": "int8", "ovib": "entropy"}


class Chosen(NamedTuple):
    """What a method sends within a budget.

    Attributes:
        error_m: [seeds] mean test errors.
        name: setting, step, code and prefix.
    """

    error_m: np.ndarray
    name: str


def chosen(
    rows: list[Row], method: str, budget_bytes: float, price: float | None = None, size: str = CODE
) -> Chosen | None:
    """What a method sends within a budget.

    Args:
        rows: of `BytesRuns`.
        method: one of `NAMES`, or `best_pca` for PCA with either decoder.
        budget_bytes: most bytes, on average over frames and seeds.
        price: of a bit, for `bits`; the best for the budget if None.
        size: what the budget is for, one of `CODE`, `PACKET`, `COMPACT`.

    Returns:
        Its test errors; None if nothing is that small.
    """

    def allowed(row: Row) -> bool:
        if method in _CODES_OF_OVIB:
            return row["method"] == "ovib" and row["setting"] == BETA and row["code"] == _CODES_OF_OVIB[method]
        if method == "best_pca":
            return row["method"] in ("pca", "pca_completed")
        return row["method"] == method and (price is None or row["setting"] == price)

    return best_within(rows, budget_bytes, allowed, size)


def best_within(
    rows: list[Row], budget_bytes: float, allowed: Callable[[Row], bool], size: str = CODE
) -> Chosen | None:
    """The coding of lowest mean validation error whose mean size is within a budget.

    Args:
        rows: of `BytesRuns`.
        budget_bytes: most bytes.
        allowed: which rows may be chosen.
        size: what the budget is for.

    Returns:
        Its test errors; None if nothing is that small.
    """
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in filter(allowed, rows):
        groups.setdefault(tuple(row[name] for name in ("method", "setting", "step", "code", "k")), []).append(row)
    small = {key: each for key, each in groups.items() if _mean(each, size) <= budget_bytes}
    if not small:
        return None
    key = min(small, key=lambda key: _mean(small[key], "val_mean_m"))
    ordered = sorted(small[key], key=lambda row: row["seed"])
    method, setting, step, code, k = key
    text = f"k = {k}, {code}" + (f", step {step:g}" if step else "") + (f", λ {setting:g}" if method == "bits" else "")
    return Chosen(np.array([row["mean_m"] for row in ordered]), text)


def one_price(rows: list[Row], budgets_bytes: Sequence[float]) -> float:
    """The price of a bit that has the lowest validation error on average over budgets."""

    def score(price: float) -> float:
        found = [_validated(rows, budget, price) for budget in budgets_bytes]
        return float(np.mean(found))

    return min(sorted({row["setting"] for row in rows if row["method"] == "bits"}), key=score)


def at_prefix(rows: list[Row], code: str, k: int, step: float = 0.0) -> np.ndarray:
    """[seeds] mean test errors of O-VIB's first k coordinates in a code; with a step where that is `entropy`."""
    mine = [row for row in rows if row["method"] == "ovib" and row["setting"] == BETA and row["k"] == k]
    mine = [row for row in mine if row["code"] == code and (code != "entropy" or row["step"] == step)]
    return np.array([row["mean_m"] for row in sorted(mine, key=lambda row: row["seed"])])


def _validated(rows: list[Row], budget: float, price: float) -> float:
    """Lowest mean validation error within a budget at a price; that of the shortest code where nothing is so small."""
    mine = [row for row in rows if row["method"] == "bits" and row["setting"] == price]
    by_k = {k: [row for row in mine if row["k"] == k] for k in KS}
    fits = [k for k in KS if _mean(by_k[k], CODE) <= budget] or [KS[0]]
    return min(_mean(by_k[k], "val_mean_m") for k in fits)


def _mean(rows: list[Row], name: str) -> float:
    return float(np.mean([row[name] for row in rows]))

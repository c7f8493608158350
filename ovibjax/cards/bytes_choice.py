"""Which coding of a method is taken within a budget of bytes: by validation error alone."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ovibjax.cards.bytes_study import KS, Row


class Chosen(NamedTuple):
    """What a method sends within a budget.

    Attributes:
        error_m: [seeds] mean test errors.
        name: setting, step, code and prefix.
    """

    error_m: np.ndarray
    name: str


def best_within(rows: list[Row], budget_bytes: float, allowed: Callable[[Row], bool]) -> Chosen | None:
    """The coding of lowest mean validation error whose mean size is within a budget.

    Args:
        rows: of `BytesRuns`.
        budget_bytes: of the code alone.
        allowed: which rows may be chosen.

    Returns:
        Its test errors; None if nothing is that small.
    """
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in filter(allowed, rows):
        groups.setdefault(tuple(row[name] for name in ("method", "setting", "step", "code", "k")), []).append(row)
    small = {key: each for key, each in groups.items() if _mean(each, "code_bytes") <= budget_bytes}
    if not small:
        return None
    key = min(small, key=lambda key: _mean(small[key], "val_mean_m"))
    ordered = sorted(small[key], key=lambda row: row["seed"])
    _, setting, step, code, k = key
    text = f"k = {k}, {code}" + (f", step {step:g}" if step else "") + (f", λ {setting:g}" if key[0] == "bits" else "")
    return Chosen(np.array([row["mean_m"] for row in ordered]), text)


def one_price(rows: list[Row], budgets_bytes: Sequence[float]) -> float:
    """The price of a bit that has the lowest validation error on average over budgets."""

    def score(price: float) -> float:
        found = [_validated(rows, budget, price) for budget in budgets_bytes]
        return float(np.mean(found))

    return min(sorted({row["setting"] for row in rows if row["method"] == "bits"}), key=score)


def _validated(rows: list[Row], budget: float, price: float) -> float:
    """Lowest mean validation error within a budget at a price; that of the shortest code where nothing is so small."""
    mine = [row for row in rows if row["method"] == "bits" and row["setting"] == price]
    by_k = {k: [row for row in mine if row["k"] == k] for k in KS}
    fits = [k for k in KS if _mean(by_k[k], "code_bytes") <= budget] or [KS[0]]
    return min(_mean(by_k[k], "val_mean_m") for k in fits)


def _mean(rows: list[Row], name: str) -> float:
    return float(np.mean([row[name] for row in rows]))

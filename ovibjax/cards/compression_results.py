"""Outcomes of all methods and seeds regrouped for tables, claims and figures."""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from ovibjax.cards.compression_methods import FIXED, SPARSE_PREFIXES, Outcome, prefixes_of
from ovibjax.edge.judging import Judged, one_standard_error_choice
from ovibjax.link.payload import representation_bytes


@dataclass(frozen=True)
class Results:
    """Outcomes of the finished seeds, and what they lead to.

    Attributes:
        judged: per method, one `Judged` per seed.
        recoded: the same of `ovib` and `pca` with the database passed through the code, at `SPARSE_PREFIXES`.
        raw_mode_m: per view mode, mean raw error per seed.
        outcomes: per seed, the trained methods.
        raw_floats: floats of an uncompressed frame.
        chosen: prefix selected on validation.
    """

    judged: dict[str, list[Judged]]
    recoded: dict[str, list[Judged]]
    raw_mode_m: dict[str, np.ndarray]
    outcomes: dict[int, dict[str, Outcome]]
    raw_floats: int
    chosen: int

    @property
    def fixed(self) -> list[int]:
        """Latent dimensions of the fixed-rate models that were trained."""
        return [k for k in FIXED if f"fixed_{k}" in self.judged]

    def mean_m(self, method: str) -> np.ndarray:
        """[seeds, prefixes] mean test errors."""
        return np.stack([judged.test_error_m.mean(axis=1) for judged in self.judged[method]])

    def at(self, method: str, k: int) -> np.ndarray:
        """[seeds] mean test error at one prefix."""
        index = int(np.flatnonzero(prefixes_of(method) == k)[0])
        return np.array([judged.test_error_m[index].mean() for judged in self.judged[method]])

    def recoded_m(self, method: str) -> np.ndarray:
        """[seeds, SPARSE_PREFIXES] mean test errors with the database passed through the code."""
        return np.stack([judged.test_error_m.mean(axis=1) for judged in self.recoded[method]])

    def recoded_at(self, method: str, k: int) -> np.ndarray:
        """[seeds] the same at one prefix."""
        return self.recoded_m(method)[:, SPARSE_PREFIXES.index(k)]

    def payload_bytes(self, method: str, k: int) -> int:
        """Bytes of one representation: header and prefix, or raw float32 features."""
        return 4 * self.raw_floats if method == "raw" else representation_bytes(k)


def collect(outcomes: dict[int, dict[str, Outcome]], raw_floats: int) -> Results:
    """Regroup outcomes by method and choose the prefix on the validation frames of all seeds together."""
    per_seed = [{k: v for o in by_method.values() for k, v in o.judged.items()} for by_method in outcomes.values()]
    judged = {method: [one[method] for one in per_seed] for method in per_seed[0]}
    ovib = [by_method["ovib"] for by_method in outcomes.values()]
    val = np.concatenate([j.val_error_m for j in judged["ovib"]], axis=1)
    return Results(
        judged=judged,
        recoded={method: [o.recoded[method] for o in ovib] for method in ("ovib", "pca")},
        raw_mode_m={mode: np.array([o.raw_mode_m[mode] for o in ovib]) for mode in ovib[0].raw_mode_m},
        outcomes=outcomes,
        raw_floats=raw_floats,
        chosen=int(one_standard_error_choice(jnp.asarray(val), jnp.asarray(prefixes_of("ovib")))),
    )


def table_rows(results: Results) -> list[dict[str, Any]]:
    """One tidy row per method, prefix and seed."""
    rows = []
    recoded = {f"{method}_recoded": per_seed for method, per_seed in results.recoded.items()}
    for method, per_seed in (results.judged | recoded).items():
        ks = [results.raw_floats] if method == "raw" else prefixes_of(method).tolist()
        for seed, judged in zip(results.outcomes, per_seed, strict=True):
            for i, k in enumerate(ks):
                error = judged.test_error_m[i]
                row = {
                    "method": "ovib_fixed" if method.startswith("fixed_") else method,
                    "k": k,
                    "seed": seed,
                }
                row |= {"payload_bytes": results.payload_bytes(method, k), "mean_m": f"{error.mean():.4f}"}
                rows.append(row | {"p90_m": f"{np.percentile(error, 90):.4f}", "eta": f"{judged.eta[i]:.2f}"})
    return rows

"""What coded prefixes buy in the whole system: requests, bytes, route error and edge latency, by code."""

from typing import Any, NamedTuple

import numpy as np
import xarray

from ovibjax.cards.control_study import drives_of
from ovibjax.cards.job import Job
from ovibjax.report.claims import Claim, interval
from ovibjax.runtime.progress import progress_bar
from ovibjax.system.data import SystemSize
from ovibjax.system.grids import sweep_system

SYSTEM_KS = (16, 32)
RULES = ("fifo", "voi_lyapunov")
CODES = ("float32", "int8", "entropy")
METRICS = ("mean_route_m", "requests", "kb", "free_kb", "residual_m")


class CodedSystemSize(NamedTuple):
    """How much is replayed.

    Attributes:
        seeds: how many.
        scene: preset of the drives.
        size: how much is trained and replayed.
    """

    seeds: int
    scene: str
    size: SystemSize


def measure_system(job: Job, size: CodedSystemSize) -> xarray.Dataset:
    """The whole system with prefixes as floats under the paper's header, and coded under a compact one.

    Args:
        job: runs the sweep; the embedded scene is driven through.
        size: how much is replayed.

    Returns:
        Metrics of `system.chain` by seed, code and k, and of the queue by V and rule.
    """
    with job.stage("render"), progress_bar("rendering the routes", 1) as update:
        drives, training = drives_of(size.scene, None, update)
    seeds = [job.seed + i for i in range(size.seeds)]

    def compute(**options: Any) -> xarray.Dataset:
        scene, along = (drives, training, size.size), (SYSTEM_KS, (8.0,), RULES)
        return sweep_system(scene, {"seed": seeds}, along, coding=(CODES, True), **options)

    return job.kept("replaying the system by code", compute, stage="replay")


def system_rows(found: xarray.Dataset) -> list[dict[str, Any]]:
    """One row per code, prefix and seed."""
    rows = []
    for code in found.code.values:
        for k in found.k.values:
            for seed in found.seed.values:
                part = found.sel(code=code, k=k, seed=seed)
                row: dict[str, Any] = {"code": str(code), "k": int(k), "seed": int(seed)}
                row |= {name: f"{float(part[name]):.4g}" for name in METRICS}
                for rule in RULES:
                    value = part.top_edge_p95_ms.sel(V=8.0, scheduler=rule)
                    row[f"edge_p95_ms_{rule}"] = f"{float(value):.4g}"
                rows.append(row)
    return rows


def system_claims(found: xarray.Dataset) -> list[Claim]:
    """What codes change on routes, paired over seeds; ours, the paper sends floats."""
    claims = []
    for code in CODES[1:]:
        errors_m = [_of(found, "mean_route_m", name, k) for k in SYSTEM_KS for name in (code, "float32")]
        worse_m = [errors_m[i] - errors_m[i + 1] for i in range(0, len(errors_m), 2)]
        kb = [[interval(_of(found, "kb", name, k)).mean for name in ("float32", code)] for k in SYSTEM_KS]
        asked = [[interval(_of(found, "requests", name, k)).mean for name in ("float32", code)] for k in SYSTEM_KS]
        words = "; ".join(
            f"k = {k}: {interval(worse).text('m')}, {before_kb:.2f} to {after_kb:.2f} KB, "
            f"{before:.1f} to {after:.1f} requests"
            for k, worse, (before_kb, after_kb), (before, after) in zip(SYSTEM_KS, worse_m, kb, asked, strict=True)
        )
        claim = Claim.at_most(
            f"With {code} prefixes under a compact header routes are as accurate as with floats, to 0.3 m, at the same "
            "payload budget",
            "-",
            f"error minus that with floats, payload and requests of a route at {words}",
            0.3,
            *worse_m,
            rule="paired interval of the difference at most 0.3 m at either prefix",
        )
        claims.append(claim.as_own())
    return claims


def _of(found: xarray.Dataset, name: str, code: str, k: int) -> np.ndarray:
    values: np.ndarray = found[name].sel(code=code, k=k).values
    return values

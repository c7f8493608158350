"""What coded prefixes buy in the whole system at one payload budget: requests, route error and edge latency, by code.

Every code has prices of its own, selected on tuning seeds so that a route keeps the budget by them: who pays fewer
bytes for a request may send more of them.
"""

from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import xarray
from matplotlib.axes import Axes

from ovibjax.cards.control_study import drives_of
from ovibjax.cards.job import Job
from ovibjax.control.controller import PAPER_BUDGET_KB
from ovibjax.control.voi import Prices
from ovibjax.report import figures as fig
from ovibjax.report.claims import Claim, interval
from ovibjax.report.panels import Bar, bars
from ovibjax.runtime.progress import progress_bar
from ovibjax.system.data import SystemSize
from ovibjax.system.grids import sweep_system
from ovibjax.system.pricing import lowest_risk_prices, random_prices, search_prices

SYSTEM_KS = (16, 32)
RULES = ("fifo", "voi_lyapunov")
CODES = ("float32", "int8", "entropy")
METRICS = ("mean_route_m", "requests", "kb", "free_kb", "residual_m")
COLOURS = dict(zip(CODES, (fig.SKY, fig.PURPLE, fig.BLUE), strict=True))


class CodedSystemSize(NamedTuple):
    """How much is replayed.

    Attributes:
        seeds: how many that routes are judged on.
        scene: preset of the drives.
        size: how much is trained and replayed.
        tuning_seeds: seeds 0, 1, ... that prices are selected on.
        candidates: prices tried.
    """

    seeds: int
    scene: str
    size: SystemSize
    tuning_seeds: int
    candidates: int


def measure_system(job: Job, size: CodedSystemSize) -> xarray.Dataset:
    """The whole system with prefixes as floats under the paper's header, and coded under a compact one.

    Args:
        job: runs the sweeps; the embedded scene is driven through.
        size: how much is replayed.

    Returns:
        Metrics of `system.chain` by seed, code and k, and of the queue by V and rule; with the prices `lambda_b` and
        `lambda_d` by code and k.
    """
    with job.stage("render"), progress_bar("rendering the routes", 1) as update:
        drives, training = drives_of(size.scene, None, update)
    scene, coding, seeds = (drives, training, size.size), (CODES, True), [job.seed + i for i in range(size.seeds)]
    tried = random_prices(size.candidates)
    search = partial(search_prices, scene, range(size.tuning_seeds), SYSTEM_KS, coding, tried)
    prices = lowest_risk_prices(job.kept("searching prices by code", search, stage="replay"), tried)

    def compute(**options: Any) -> xarray.Dataset:
        along = (SYSTEM_KS, (8.0,), RULES)
        return sweep_system(scene, {"seed": seeds}, along, coding=coding, prices=prices, **options)

    found = job.kept("replaying the system by code", compute, stage="replay")
    return with_prices(found, prices)


def with_prices(found: xarray.Dataset, prices: Prices) -> xarray.Dataset:
    """Metrics with the prices [codes, K] that they were found at."""
    dims = ("code", "k")
    return found.assign(lambda_b=(dims, prices.bandwidth_m_per_s), lambda_d=(dims, prices.delay_m_per_s))


def system_rows(found: xarray.Dataset) -> list[dict[str, Any]]:
    """One row per code, prefix and seed."""
    rows = []
    for code in found.code.values:
        for k in found.k.values:
            for seed in found.seed.values:
                part = found.sel(code=code, k=k, seed=seed)
                row: dict[str, Any] = {"code": str(code), "k": int(k), "seed": int(seed)}
                for name in (*METRICS, "lambda_b", "lambda_d"):
                    row[name] = f"{float(part[name]):.4g}"
                for rule in RULES:
                    queue = part.sel(V=8.0, scheduler=rule)
                    row[f"edge_p95_ms_{rule}"] = f"{float(queue.top_edge_p95_ms):.4g}"
                    row[f"unserved_{rule}"] = f"{float(queue.unserved):g}"
                rows.append(row)
    return rows


def system_claims(found: xarray.Dataset) -> list[Claim]:
    """What codes change on routes at one budget, paired over seeds; ours, the paper sends floats."""
    claims = []
    for code in CODES[1:]:
        gains_m = [_of(found, "mean_route_m", "float32", k) - _of(found, "mean_route_m", code, k) for k in SYSTEM_KS]
        words = "; ".join(
            f"k = {k}: {interval(gain).text('m')} ({_told(found, 'float32', k)}; {_told(found, code, k)})"
            for k, gain in zip(SYSTEM_KS, gains_m, strict=True)
        )
        claims.append(
            Claim.above_zero(
                f"With {code} prefixes under a compact header a route of {PAPER_BUDGET_KB} KB has a lower error than "
                "with floats",
                "-",
                f"error with floats minus that with {code} at {words}",
                *gains_m,
                rule="paired interval above zero at both prefixes; prices of each code selected on tuning seeds",
            ).as_own()
        )
    return claims


def _told(found: xarray.Dataset, code: str, k: int) -> str:
    """Error, requests, payload and edge latency of a code in words."""
    error, requests, kb = (interval(_of(found, name, code, k)) for name in ("mean_route_m", "requests", "kb"))
    p95 = [interval(latency_ms(found, code, k, rule)).mean for rule in RULES]
    return (
        f"{code} {error.text('m')}, {requests.text(digits=1)} requests, {kb.text('KB')}, edge p95 {p95[0]:.0f} ms "
        f"with FIFO, {p95[1]:.0f} ms with VOI-Lyapunov"
    )


def latency_ms(found: xarray.Dataset, code: str, k: int, rule: str) -> np.ndarray:
    """[seeds] 95th percentile of the edge latency of requests in the top decile of VOI."""
    values: np.ndarray = found.top_edge_p95_ms.sel(code=code, k=k, V=8.0, scheduler=rule).values
    return values


def draw_system(ax: Axes, found: xarray.Dataset) -> None:
    """Route error by code and prefix, with requests and edge latency."""
    rows = []
    for k, code in product(SYSTEM_KS, CODES):
        asked = interval(_of(found, "requests", code, k)).mean
        p95 = interval(latency_ms(found, code, k, "voi_lyapunov")).mean
        text = f"{asked:.0f} requests, {p95:.0f} ms"
        rows.append(Bar(f"{code}, k = {k}", interval(_of(found, "mean_route_m", code, k)), COLOURS[code], text=text))
    bars(ax, rows)
    ax.set_xlim(0, 1.9 * max(row.value.mean + row.value.cap for row in rows))
    ax.set_xlabel(f"mean route error (m) within {PAPER_BUDGET_KB} KB a route")


def _of(found: xarray.Dataset, name: str, code: str, k: int) -> np.ndarray:
    values: np.ndarray = found[name].sel(code=code, k=k).values
    return values

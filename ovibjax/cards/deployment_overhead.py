"""What deploying each method costs: models, storage, rates, latency of encoding and transmission."""

from typing import Any

import jax
import numpy as np

from ovibjax.cards.compression_methods import FIXED, LATENT, architecture_of, train_config
from ovibjax.cards.compression_results import Results
from ovibjax.encoder.model import encode, init, parameter_bytes
from ovibjax.encoder.training_data import MemberData
from ovibjax.link.latency import JETSON, LatencyProfile, kbytes_per_s, measure_host, semantic_latency_ms

LINK_KB_PER_S = 8
"""The link throughput at which the paper states latency."""

PAPER_LATENCY_MS = {16: 42.0, 35: 52.0, 32: 50.4, 128: 100.6}
"""The paper's latency at this throughput, by prefix length."""


def measure_encoder(results: Results, data: MemberData) -> LatencyProfile:
    """Time to encode one frame on this machine, after feature extraction."""
    arch = architecture_of(data)
    params = next(iter(results.outcomes.values()))["ovib"].params
    x = data.test_x[:1].reshape(1, -1)
    jitted = jax.jit(lambda params, x: encode(params, x, arch)[0])
    return measure_host(lambda k: np.asarray(jitted(params, x))[:, :k], (16, 32, 35, 128))


def overhead_rows(results: Results, data: MemberData, host: LatencyProfile, basis_bytes: int) -> list[dict[str, Any]]:
    """The paper's table "Deployment overhead", with a column for this machine.

    Args:
        results: outcomes of all methods.
        data: data of any seed.
        host: encoding times of this machine.
        basis_bytes: size of the per-view basis; storage adds encoder, decoder and localizer head in float32.

    Returns:
        One row per deployment.
    """

    def size_mb(method: str) -> float:
        arch = train_config(method, data, None, "float32").arch
        return (parameter_bytes(jax.eval_shape(lambda key: init(key, arch), jax.random.key(0))) + basis_bytes) / 1e6

    def latency(profile: LatencyProfile, k: int) -> float:
        return float(semantic_latency_ms(profile, k, kbytes_per_s(LINK_KB_PER_S)))

    def row(name: str, models: int, storage_mb: float, rates: int, ks: tuple[int, ...]) -> dict[str, Any]:
        paper = [str(PAPER_LATENCY_MS[k]) for k in ks if k in PAPER_LATENCY_MS]
        span = ["-".join(f"{latency(profile, k):.1f}" for k in ks) for profile in (JETSON, host)]
        return {
            "method": name,
            "models": models,
            "storage_mb": f"{storage_mb:.1f}",
            "rates": rates,
            "jetson_ms": span[0],
            "paper_ms": "-".join(paper) if len(paper) == len(ks) else "-",
            "this_host_ms": span[1],
        }

    small, large = (size_mb(f"fixed_{k}") for k in FIXED)
    scalable = size_mb("ovib")
    rows = [
        row("Fixed-rate O-VIB-32", 1, small, 1, (32,)),
        row("Fixed-rate O-VIB-128", 1, large, 1, (128,)),
        row("Fixed-rate bank {32 128}", 2, small + large, 2, FIXED),
        row("Scalable O-VIB k=35", 1, scalable, LATENT, (35,)),
        row("Scalable O-VIB k=16", 1, scalable, LATENT, (16,)),
    ]
    if results.chosen not in (16, 35):
        rows.append(row(f"Scalable O-VIB k={results.chosen} (selected)", 1, scalable, LATENT, (results.chosen,)))
    return rows

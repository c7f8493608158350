"""Bits, not floats (not in the paper): error against the bytes that codes and packets really take."""

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ovibjax.cards.bytes_choice import at_prefix
from ovibjax.cards.bytes_claims import bytes_claims
from ovibjax.cards.bytes_codecs import codec_claim, codec_rows, judge_stills
from ovibjax.cards.bytes_coding import Row
from ovibjax.cards.bytes_drawing import (
    Everything,
    draw_code_bytes,
    draw_coordinates,
    draw_gains,
    draw_packets,
    draw_surrogate,
)
from ovibjax.cards.bytes_study import BytesRuns, BytesSize, measure
from ovibjax.cards.bytes_system import CodedSystemSize, draw_system, measure_system, system_claims, system_rows
from ovibjax.cards.codec_frontier import RIVAL_K, Frontier
from ovibjax.cards.job import Job
from ovibjax.encoder.model import Architecture
from ovibjax.encoder.pca import fit_pca, pca_coordinates
from ovibjax.encoder.train import TrainConfig
from ovibjax.encoder.training_data import MemberData, member_data
from ovibjax.features.basis import ViewBasis
from ovibjax.link.codes.coder import Coder
from ovibjax.link.codes.tables import fit_table
from ovibjax.report import panels
from ovibjax.report.claims import write_claims
from ovibjax.report.rows import write_rows
from ovibjax.runtime.precision_choice import faster_precision
from ovibjax.system.data import SystemSize

TITLE = "Bits, not floats"

PRESETS = {
    "smoke": BytesSize(2, 60, (1e-3,), (), (0.5,), (8,)),
    "quick": BytesSize(3, None, (1e-3, 3e-3), (1e-2,), (0.5, 1.0, 1.5), (8, 16)),
    "full": BytesSize(5, 4000, (5e-4, 1e-3, 2e-3, 4e-3), (1e-4, 1e-2), (0.5, 1.0, 1.5, 2.5), (8, 16, 32)),
}

REQUESTS = 128
"""More than there are in a route's payload budget, whatever the code."""

SYSTEM = {
    "smoke": CodedSystemSize(2, "smoke", SystemSize(20, 256, clients=2, fleet=4, requests=REQUESTS), 1, 8),
    "quick": CodedSystemSize(3, "full", SystemSize(requests=REQUESTS), 2, 128),
    "full": CodedSystemSize(20, "full", SystemSize(requests=REQUESTS), 4, 256),
}

PANELS = {
    "error by bytes of code": draw_code_bytes,
    "error by bytes of packet": draw_packets,
    "bits of each coordinate": draw_coordinates,
    "the rate term against coded bits": draw_surrogate,
    "against PCA at equal bytes": draw_gains,
}

Prepared = Mapping[int, tuple[MemberData, ViewBasis]]


def run(job: Job) -> None:
    """Run the card: train, code, judge, time; tables, claims and figure."""
    started = time.perf_counter()
    size = PRESETS[job.preset]
    seeds = [job.seed + i for i in range(size.seeds)]
    with job.stage("features"):
        prepared = {seed: member_data(job.features, seed, job.rank) for seed in seeds}
    members = [member for member, _ in prepared.values()]
    views, dim = members[0].train.x.shape[1:]
    static = TrainConfig(Architecture(n_views=views, view_dim=dim), precision=faster_precision())
    found = measure(job, size, static, members, seeds)
    with job.stage("time"):
        coding_us = coding_times_us(members[0])
    rows, claims = [table_row(row) for row in found.rows], bytes_claims(found, coding_us, job.embedded)
    everything = Everything(found, None, None)
    if job.embedded:  # frames are rendered, and routes driven, in the embedded town
        stills = image_codecs(job, prepared, found)
        rows += [dict.fromkeys(rows[0], "") | row for row in codec_rows(stills)]
        system = measure_system(job, SYSTEM[job.preset])
        write_rows(job.out / "system.csv", system_rows(system))
        claims += [codec_claim(stills), *system_claims(system)]
        everything = Everything(found, stills, system)
    write_rows(job.out / "table.csv", rows)
    write_claims(job.out / "claims.json", claims)
    with job.stage("draw"):
        shown = PANELS if everything.system is None else PANELS | {"routes at one payload budget": draw_routes}
        panels.draw_panels(job.out / "figure.png", everything, shown, 2, height_in=2.5)
    job.record(*(TITLE, caption(size), seeds, started), precision=static.precision, coding_us=coding_us)


def draw_routes(ax: Axes, found: Everything) -> None:
    """The whole system by code."""
    assert found.system is not None
    draw_system(ax, found.system)


def image_codecs(job: Job, prepared: Prepared, found: BytesRuns) -> Frontier:
    """Image codecs under the localizers of `ovib`."""
    return judge_stills(job, prepared, found.params, at_prefix(found.rows, "float32", RIVAL_K))


def coding_times_us(member: MemberData, frames: int = 200) -> dict[str, float]:
    """Median processor time to code and decode one code by itself, in microseconds, by its length."""
    flat = [x.reshape(x.shape[0], -1) for x in (member.train.x, member.test_x)]
    pca = fit_pca(member.train.x, Architecture.latent)
    training, test = (np.asarray(pca_coordinates(pca, x)) for x in flat)
    coder, found = Coder("entropy", fit_table("entropy", training)), {}
    for k in (35, training.shape[1]):
        times_us = []
        for code in test[:frames, :k]:
            began = time.process_time_ns()
            coder.decode(coder.encode(code), k)
            times_us.append((time.process_time_ns() - began) / 1000)
        found[f"k = {k}"] = round(float(np.median(times_us)), 1)
    return found


def table_row(row: Row) -> dict[str, Any]:
    """A row of the table, with as many digits as mean something."""
    digits = {name: f"{row[name]:.2f}" for name in ("code_bytes", "ideal_bytes", "packet_bytes", "compact_bytes")}
    return row | digits | {name: f"{row[name]:.4f}" for name in ("val_mean_m", "mean_m")}


def caption(size: BytesSize) -> str:
    """What the reader of the figure needs to know."""
    return (
        "(a) Lowest error within so many bytes of code, coding chosen on validation; streams of test frames, coded one "
        "by one; PCA and fixed-rate models in their best code. (b) Whole packets: the paper's header is 20 bytes and 4 "
        "per view, the compact one about 13; colours as in (a); grey: image codecs on a few frames of 400 x 300 px. "
        "(c) Ideal length of each coordinate; solid: the paper's rate term by its weight β, step 0.5; dashed: trained "
        "for bits, by the price λ of a bit. (d) The rate as training counts it, nats as bits, or length under the "
        "learned prior, and as tables code all 128 coordinates. (e) Paired differences from PCA's best, with its own "
        "decoder or ours. Steps and tables are fitted on training codes. PCA and product quantisation are judged with "
        f"O-VIB's localizer; the database holds uncompressed descriptors. {size.seeds} seeds; every view. (f) Whole "
        "system, coded prefixes under a compact header: VOI-Control with prices of each code selected on tuning seeds "
        "within 2.1 KB a route; requests of a route, and 95th percentile of the latency at an edge of 30 clients under "
        "VOI-Lyapunov, top decile of VOI (system.csv)."
    )

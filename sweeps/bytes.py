"""Bits, not floats (not in the paper): error against the bytes that codes and packets really take."""

import time
from typing import Any

import numpy as np

from ovibjax.cards.bytes_results import bytes_claims, draw_code_bytes, draw_coordinates, draw_gains, draw_packets
from ovibjax.cards.bytes_study import BytesSize, Row, measure
from ovibjax.cards.bytes_system import CodedSystemSize, measure_system, system_claims, system_rows
from ovibjax.cards.job import Job
from ovibjax.encoder.loss import BETA
from ovibjax.encoder.model import Architecture
from ovibjax.encoder.pca import fit_pca, pca_coordinates
from ovibjax.encoder.train import TrainConfig
from ovibjax.encoder.training_data import MemberData, member_data
from ovibjax.link.codes.coder import Coder
from ovibjax.link.codes.tables import fit_table
from ovibjax.report import panels
from ovibjax.report.claims import write_claims
from ovibjax.report.rows import write_rows
from ovibjax.system.data import SystemSize

TITLE = "Bits, not floats"

PRESETS = {
    "smoke": BytesSize(2, 60, (1e-3,), (BETA,), (0.5,)),
    "quick": BytesSize(3, None, (1e-3, 3e-3), (BETA,), (0.5, 1.0, 1.5)),
    "full": BytesSize(5, 4000, (5e-4, 1e-3, 2e-3, 4e-3), (1e-4, BETA, 1e-2), (0.5, 1.0, 1.5, 2.5)),
}

SYSTEM = {
    "smoke": CodedSystemSize(2, "smoke", SystemSize(20, 256, clients=2, fleet=4)),
    "quick": CodedSystemSize(3, "full", SystemSize()),
    "full": CodedSystemSize(20, "full", SystemSize()),
}

PANELS = {
    "error by bytes of code": draw_code_bytes,
    "error by bytes of packet": draw_packets,
    "bits of each coordinate": draw_coordinates,
    "against PCA at equal bytes": draw_gains,
}


def run(job: Job) -> None:
    """Run the card: train, code, judge, time; tables, claims and figure."""
    started = time.perf_counter()
    size = PRESETS[job.preset]
    seeds = [job.seed + i for i in range(size.seeds)]
    with job.stage("features"):
        members = [member_data(job.features, seed, job.rank)[0] for seed in seeds]
    views, dim = members[0].train.x.shape[1:]
    found = measure(job.sweep, size, TrainConfig(Architecture(n_views=views, view_dim=dim)), members, seeds)
    with job.stage("time"):
        coding_us = coding_times_us(members[0])
    write_rows(job.out / "table.csv", [table_row(row) for row in found.rows])
    claims = bytes_claims(found, coding_us, job.embedded)
    if job.embedded:  # routes are driven through the embedded scene
        system = measure_system(job, SYSTEM[job.preset])
        write_rows(job.out / "system.csv", system_rows(system))
        claims += system_claims(system)
    write_claims(job.out / "claims.json", claims)
    with job.stage("draw"):
        panels.draw_panels(job.out / "figure.png", found, PANELS, 2, height_in=2.5)
    job.record(*(TITLE, caption(size), seeds, started), coding_us=coding_us)


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
        "by one. (b) Whole packets: the paper's header is 20 bytes and 4 per view, the compact one about 13. (c) Ideal "
        "length of each coordinate; solid: the paper's rate term by its weight β, step 0.5; dashed: trained for bits, "
        "by the price λ of a bit. (d) Paired differences. Steps and tables are fitted on training codes. PCA and "
        "product quantisation are judged with O-VIB's localizer; the database holds uncompressed descriptors. "
        f"{size.seeds} seeds; every view. system.csv: routes and edge by code, coded prefixes under a compact header."
    )

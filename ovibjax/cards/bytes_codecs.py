"""Image codecs beside codes of a few bytes: a few test frames as JPEG and WebP, under the same frozen localizer."""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from ovibjax.cards.codec_frontier import RIVAL_K, Frontier
from ovibjax.cards.codec_study import CodecPlan, Frozen, judge_codecs, town_coder
from ovibjax.cards.compression_methods import architecture_of, judge_raw_jit
from ovibjax.cards.job import Job
from ovibjax.edge.judging import Trained
from ovibjax.encoder.training_data import MemberData
from ovibjax.features.basis import ViewBasis
from ovibjax.features.images.codecs import LADDERS, STILLS
from ovibjax.report.claims import Claim, interval
from ovibjax.views import full_mode, mode_mask
from ovibjax.world.town.coded import Rung


def _rungs(step: slice) -> tuple[Rung, ...]:
    return tuple((codec, quality) for codec in STILLS for quality in LADDERS[codec][step])


PLANS = {
    "smoke": CodecPlan(frames=2, rungs=(("jpeg", 8),)),
    "quick": CodecPlan(frames=6, rungs=_rungs(slice(0, 3, 2))),
    "full": CodecPlan(frames=12, rungs=_rungs(slice(0, 4))),
}
"""Coding is slow, and what it shows here is a matter of orders of magnitude; `codec_study` has more of it."""


def judge_stills(
    job: Job, prepared: Mapping[int, tuple[MemberData, ViewBasis]], params: Mapping[int, Any], ovib_m: np.ndarray
) -> Frontier:
    """What image codecs reach on the embedded town.

    Args:
        job: the job.
        prepared: data and basis per seed.
        params: trained network per seed, whose localizer judges.
        ovib_m: [seeds] mean test error of O-VIB at k = `RIVAL_K`.

    Returns:
        Errors and payloads; times of encoding are not measured, and no numbers.
    """
    plan = PLANS[job.preset]
    frozen = {}
    with job.stage("judge"):
        for (seed, (data, _)), of_seed_m in zip(prepared.items(), ovib_m, strict=True):
            arch = architecture_of(data)
            raw = judge_raw_jit(Trained(data, params[seed]), arch, mode_mask(full_mode(arch.n_views), arch.n_views))
            frozen[seed] = Frozen(params[seed], jax.device_get(raw.test_error_m), float(of_seed_m))
        unknown_ms = np.full(len(plan.rungs), np.nan)
        return judge_codecs(job.features, prepared, frozen, plan, town_coder(job, plan.rungs), unknown_ms)


def codec_rows(found: Frontier) -> list[dict[str, Any]]:
    """Rows of the table of real bytes; a codec's payload is the whole packet."""
    rows = []
    for r, (codec, quality) in enumerate(found.rungs):
        for s, seed in enumerate(found.seeds):
            row: dict[str, Any] = {"method": "image", "code": codec, "setting": quality, "seed": seed}
            size = f"{found.payload_bytes[s, r]:.2f}"
            rows.append(row | {"packet_bytes": size, "compact_bytes": size, "mean_m": f"{found.mean_m[s, r]:.4f}"})
    return rows


def codec_claim(found: Frontier) -> Claim:
    """Errors and bytes of image codecs, beside O-VIB's."""
    texts = []
    for codec in found.codecs:
        sizes, errors_m = found.of(codec)
        points = zip(sizes.mean(axis=0), errors_m.T, strict=True)
        texts.append(f"{STILLS[codec]} " + ", ".join(f"{size:.0f} bytes {interval(e).text('m')}" for size, e in points))
    return Claim.reported(
        "Image codecs under the same localizer, five views of 400 x 300 px",
        "-",
        f"{'; '.join(texts)}; O-VIB at k = {RIVAL_K}: {interval(found.ovib_m).text('m')}",
        f"mean over test frames; {found.missed}",
    ).as_own()

"""Image codecs in the compression figure: what is coded under each preset, the claims, and how they are drawn."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from ovibjax.cards.codec_frontier import RIVAL_K, CodecPlan, Frontier, judge_codecs
from ovibjax.cards.compression_methods import Outcome
from ovibjax.cards.job import Job
from ovibjax.encoder.data_split import MemberData
from ovibjax.features.basis import ViewBasis
from ovibjax.features.images.codecs import CODECS, LADDERS, NAMES
from ovibjax.link.latency import JETSON, kbytes_per_s, semantic_latency_ms
from ovibjax.link.payload import representation_bytes
from ovibjax.report import figures as fig
from ovibjax.report.claims import Claim, above, interval, weakest
from ovibjax.runtime.progress import progress_bar
from ovibjax.world.town.coded import CodedViews, coded_town, usable
from ovibjax.world.town.layout import TownConfig

COLOURS = {"jpeg": fig.GREEN, "webp": fig.PURPLE, "h264": "#8C6D31", "h265": "#222222"}
MARKERS = {"jpeg": "o", "webp": "v", "h264": "^", "h265": "P"}
PAPER_S = {"jpeg": 4.58, "webp": 2.92, "h264": 5.04, "h265": 3.61}
"""The paper's latency at 8 KB/s."""


def _rungs(step: slice) -> tuple[tuple[str, int], ...]:
    return tuple((codec, quality) for codec in CODECS for quality in LADDERS[codec][step])


PLANS = {
    "smoke": CodecPlan(val=2, test=3, rungs=(("jpeg", 8), ("h265", 41))),
    "quick": CodecPlan(val=10, test=25, rungs=_rungs(slice(0, 3, 2))),
    "full": CodecPlan(val=40, test=80, rungs=_rungs(slice(None))),
}


def code_and_judge(
    job: Job, prepared: Mapping[int, tuple[MemberData, ViewBasis]], outcomes: Mapping[int, Mapping[str, Outcome]]
) -> tuple[Frontier | None, str]:
    """Codecs on the job's data, with a progress bar; coded frames are kept in the cache folder.

    Args:
        job: the job.
        prepared: data and basis per seed.
        outcomes: trained methods of the finished seeds.

    Returns:
        The frontier, None if there is none; and a sentence for the caption, on what was coded or why not.
    """
    if not job.embedded:
        return None, " Image codecs are left out: a feature set has no images."
    plan = PLANS[job.preset]
    rungs, reason = usable(plan.rungs)
    plan = CodecPlan(plan.val, plan.test, rungs)
    n_frames = len(job.features.features)

    def code(frames: NDArray[np.int64]) -> CodedViews:
        with progress_bar("rendering and coding 400 x 300 px", len(frames)) as update:
            return coded_town(TownConfig(), n_frames, frames, rungs, on_frames=update)

    frontier = judge_codecs(job.features, prepared, outcomes, plan, code)
    gap = interval(frontier.plain_m - frontier.native_m)
    note = (
        f" Image codecs code 400 x 300 px renders of {frontier.error_m.shape[2]} test frames per seed, from the "
        "coarsest quality they have; before coding these renders err by "
        f"{gap.text('m')} more than the 64 x 48 px ones that the database is made of."
    )
    return frontier, note + (f" H.264 and H.265 are left out: {reason}." if reason else "")


def claims(frontier: Frontier, link_kb_per_s: float) -> list[Claim]:
    """The paper's claims on image codecs.

    Args:
        frontier: codecs and O-VIB on the same frames.
        link_kb_per_s: throughput, KB/s.

    Returns:
        Two claims.
    """
    own_bytes, rate = representation_bytes(RIVAL_K), kbytes_per_s(link_kb_per_s)
    own_ms = float(semantic_latency_ms(JETSON, RIVAL_K, rate))
    needed = {codec: frontier.equal_error_bytes(codec) for codec in frontier.codecs}
    times = {codec: needed[codec] / own_bytes for codec in needed}
    most = {codec: "at most " if frontier.coarsest_suffices(codec) else "" for codec in needed}
    texts = [f"{NAMES[codec]} {most[codec]}{_times_text(ratio)}" for codec, ratio in times.items()]
    target = interval(frontier.ovib_m)
    size = Claim(
        f"Every codec needs at least 50 times the bytes of O-VIB-{RIVAL_K} for equal error on the frozen localizer",
        "-",
        f"{', '.join(texts)} times {own_bytes} B, for O-VIB's {target.text('m')} on the same frames",
        weakest(_at_least(ratio, 50.0) for ratio in times.values()),
        "whole interval of the ratio at least 50 for every codec; a codec whose coarsest quality is already as "
        "accurate counts with that quality's bytes; one that never is on any seed counts as held",
    )
    # A codec that never gets there is slower than any that does; of the others the mean decides.
    needed_bytes = {codec: float(needed[codec].mean()) for codec in needed}
    fastest = min(needed_bytes, key=needed_bytes.__getitem__)
    ratio = 1e3 * needed[fastest] * 8 / rate / own_ms
    speed = Claim(
        f"At {link_kb_per_s} KB/s O-VIB-{RIVAL_K} is at least 50 times faster than the fastest codec of equal error",
        f"{PAPER_S['webp']} s (WebP) / 50.4 ms = 58",
        f"{NAMES[fastest]}, {most[fastest]}{_times_text(ratio)} times {own_ms:.1f} ms",
        _at_least(ratio, 50.0),
        "whole interval of the ratio at least 50; the codec's time is transmission alone, O-VIB's includes encoding "
        "(Jetson profile)",
    )
    return [size, speed]


def _at_least(ratio: NDArray[np.float64], limit: float) -> str:
    """Verdict over seeds; one on which the codec never reaches the error counts as the largest that is known."""
    known = max(limit, *ratio[np.isfinite(ratio)].tolist(), 0.0)
    return above(interval(np.where(np.isfinite(ratio), ratio, known)), limit)


def _times_text(ratio: NDArray[np.float64]) -> str:
    never = int(np.isinf(ratio).sum())
    if not never:
        return interval(ratio).text("", 1)
    rest = f"{interval(ratio[np.isfinite(ratio)]).text('', 1)}, " if never < len(ratio) else ""
    return f"{rest}never on {never} of {len(ratio)} seeds"


def draw_frontier(ax: Axes, frontier: Frontier) -> None:
    """Payload and error of every codec, with 95 % intervals."""
    for codec in frontier.codecs:
        sizes, errors = frontier.of(codec)
        mean, half = fig.mean_and_half(errors)
        x = sizes.mean(axis=0) / 1024
        ax.errorbar(
            x,
            mean,
            np.stack([np.minimum(half, 0.7 * mean), half]),
            fmt=f"{MARKERS[codec]}-",
            ms=3.5,
            lw=0.9,
            elinewidth=0.6,
            color=COLOURS[codec],
            label=NAMES[codec],
        )


def latency_rows(frontier: Frontier | None, link_kb_per_s: float) -> list[tuple[str, float, float]]:
    """Codecs in the latency panel.

    Args:
        frontier: codecs and O-VIB; None leaves the paper's figures alone.
        link_kb_per_s: throughput, KB/s.

    Returns:
        Per codec: label, transmission in ms at the bytes of equal error (infinite if not reached on every seed), the
        paper's ms.
    """
    rate_bps = kbytes_per_s(link_kb_per_s)
    rows = []
    for codec in frontier.codecs if frontier else CODECS:
        needed_bytes = float(frontier.equal_error_bytes(codec).mean()) if frontier else np.inf
        label = NAMES[codec] if frontier else f"{NAMES[codec]} (paper)"
        rows.append((label, 1e3 * needed_bytes * 8 / rate_bps, 1e3 * PAPER_S[codec]))
    return rows

"""Image codecs judged by the frozen localizer: which frames are coded at which qualities, and how wrong they get.

Frames that a codec has passed through meet the localizer like uncompressed ones: the database holds uncompressed
reference descriptors, and the mixing weight is the one of uncompressed validation frames. Coding is slow and judging
is not, so a random few of each seed's test frames are coded, and what coding adds to their error is added to the error
of all uncompressed test frames: a frame that is lost without any coding no longer decides how a codec does.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ovibjax.cards.codec_frontier import RIVAL_K, Frontier
from ovibjax.cards.codec_timing import encode_times_ms, town_pictures
from ovibjax.cards.compression_methods import Outcome, architecture_of, judge_raw_jit, prefixes_of
from ovibjax.cards.job import Job
from ovibjax.edge.judging import Trained
from ovibjax.encoder.model import Params
from ovibjax.encoder.training_data import MemberData
from ovibjax.features.basis import ViewBasis, project
from ovibjax.features.frames import FeatureSet
from ovibjax.features.images.codecs import CODECS, LADDERS
from ovibjax.features.places import from_origin, origin_of
from ovibjax.features.splits import split_indices
from ovibjax.report.claims import interval
from ovibjax.runtime.progress import progress_bar
from ovibjax.views import full_mode, mode_mask
from ovibjax.world.town.coded import CodedViews, Rung, coded_town, usable
from ovibjax.world.town.layout import TownConfig

_STREAM = 0xC0DE  # keeps the choice of frames apart from other uses of the same seed


@dataclass(frozen=True)
class CodecPlan:
    """What is coded.

    Attributes:
        frames: test frames per seed.
        rungs: codecs and qualities, each codec from its fewest bytes up.
    """

    frames: int
    rungs: tuple[Rung, ...]


class Frozen(NamedTuple):
    """The localizer that codecs are judged by, on one seed, and what it reaches without them.

    Attributes:
        params: the trained network.
        raw_m: [T] errors of the uncompressed test frames.
        ovib_m: mean test error of O-VIB at k = `RIVAL_K`.
    """

    params: Params
    raw_m: NDArray[np.float32]
    ovib_m: float


def _rungs(step: slice) -> tuple[tuple[str, int], ...]:
    return tuple((codec, quality) for codec in CODECS for quality in LADDERS[codec][step])


PLANS = {
    "smoke": CodecPlan(frames=3, rungs=(("jpeg", 8), ("h265", 41))),
    "quick": CodecPlan(frames=5, rungs=_rungs(slice(0, 3, 2))),
    "full": CodecPlan(frames=40, rungs=_rungs(slice(None))),
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
    plan, n_frames = CodecPlan(plan.frames, rungs), len(job.features.features)
    with job.stage("time"):
        encode_ms = encode_times_ms(town_pictures(n_frames, (0, n_frames // 2)), rungs)
    with job.stage("judge"):
        frozen = {seed: _frozen(outcome["ovib"]) for seed, outcome in outcomes.items()}
        frontier = judge_codecs(job.features, prepared, frozen, plan, town_coder(job, rungs), encode_ms)
    gap = interval(frontier.plain_m - frontier.native_m)
    note = (
        f" Image codecs code 400 x 300 px renders of {frontier.error_m.shape[2]} test frames per seed, from the "
        "coarsest quality they have; before coding these renders err by "
        f"{gap.text('m')} more than the 64 x 48 px ones that the database is made of. What coding adds to their error "
        f"is added to that of all test frames; {frontier.missed}."
    )
    return frontier, note + (f" H.264 and H.265 are left out: {reason}." if reason else "")


def town_coder(job: Job, rungs: tuple[Rung, ...]) -> Callable[[NDArray[np.int64]], CodedViews]:
    """What codes frames of the embedded town's drive, with a progress bar, and keeps them in the cache folder."""

    def code(frames: NDArray[np.int64]) -> CodedViews:
        with job.stage("codecs"), progress_bar("rendering and coding 400 x 300 px", len(frames)) as update:
            return coded_town(TownConfig(), len(job.features.features), frames, rungs, on_frames=update)

    return code


def _frozen(ovib: Outcome) -> Frozen:
    of_ovib = int(np.flatnonzero(prefixes_of("ovib") == RIVAL_K)[0])
    judged = ovib.judged
    raw_m = np.asarray(judged["raw"].test_error_m[0])
    return Frozen(ovib.params, raw_m, float(judged["ovib"].test_error_m[of_ovib].mean()))


def choose_rows(n: int, seed: int, count: int) -> NDArray[np.int64]:
    """A random few of a seed's test frames; never more than there are.

    Args:
        n: test frames.
        seed: the split.
        count: how many.

    Returns:
        Ascending positions within the test part.
    """
    return np.sort(np.random.default_rng([seed, _STREAM]).permutation(n)[:count])


def judge_codecs(
    feature_set: FeatureSet,
    prepared: Mapping[int, tuple[MemberData, ViewBasis]],
    frozen: Mapping[int, Frozen],
    plan: CodecPlan,
    code: Callable[[NDArray[np.int64]], CodedViews],
    encode_ms: NDArray[np.float64],
) -> Frontier:
    """Code, decode and localize.

    Args:
        feature_set: what everything was trained on.
        prepared: data and basis per seed.
        frozen: what codecs are judged by, per seed.
        plan: frames and rungs.
        code: the coded views of frames by index; called once with the frames of all seeds.
        encode_ms: [R] time to encode a frame, by rung.

    Returns:
        The frontier, on the seeds of `frozen`.
    """
    tests = {seed: split_indices(len(feature_set.features), seed).test for seed in frozen}
    rows = {seed: choose_rows(len(test), seed, plan.frames) for seed, test in tests.items()}
    frames = np.unique(np.concatenate([tests[seed][rows[seed]] for seed in frozen]))
    coded = code(frames)
    sizes, errors, plain, native, whole, ovib = [], [], [], [], [], []
    places_m = from_origin(feature_set.positions_m, origin_of(feature_set.positions_m))  # as `member_data` has them
    for seed, known in frozen.items():
        mine = tests[seed][rows[seed]]
        at = np.searchsorted(frames, mine)
        features = np.concatenate([coded.plain[at, None], coded.coded[at]], axis=1).swapaxes(0, 1)
        error_m = _judge(prepared[seed], known.params, features, places_m[mine])
        plain.append(error_m[0].mean())
        errors.append(error_m[1:])
        sizes.append(coded.payload_bytes[at].mean(axis=0))
        native.append(known.raw_m[rows[seed]].mean())
        whole.append(known.raw_m.mean())
        ovib.append(known.ovib_m)
    plain_m, native_m, whole_m, ovib_m = (np.array(values, np.float64) for values in (plain, native, whole, ovib))
    return Frontier(
        plan.rungs,
        tuple(frozen),
        payload_bytes=np.stack(sizes),
        error_m=np.stack(errors),
        plain_m=plain_m,
        native_m=native_m,
        whole_m=whole_m,
        ovib_m=ovib_m,
        encode_ms=encode_ms,
    )


def _judge(
    prepared: tuple[MemberData, ViewBasis], params: Params, features: NDArray[np.float32], at_m: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Errors [R, T] of features [R, T, M, d] of test frames at positions [T, 3]."""
    data, basis = prepared
    arch = architecture_of(data)
    mask = mode_mask(full_mode(arch.n_views), arch.n_views)
    count = len(features)
    test_x = jnp.asarray(project(basis, features.reshape(-1, *features.shape[2:])))
    seen = data._replace(test_x=test_x, test_m=jnp.asarray(np.tile(at_m, (count, 1))))
    return np.asarray(judge_raw_jit(Trained(seen, params), arch, mask).test_error_m).reshape(count, -1)

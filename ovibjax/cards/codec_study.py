"""Image codecs judged by the frozen localizer: which frames are coded at which qualities, and how wrong they get.

Frames that a codec has passed through meet the localizer like uncompressed ones: the database holds uncompressed
reference descriptors, and the mixing weight is chosen on validation frames per quality. A random part of each seed's
validation and test frames is coded; O-VIB is compared on the same test frames.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ovibjax.cards.codec_frontier import RIVAL_K, Frontier
from ovibjax.cards.compression_methods import Outcome, architecture_of, judge_raw_jit, prefixes_of
from ovibjax.cards.job import Job
from ovibjax.edge.judging import Trained
from ovibjax.encoder.training_data import MemberData
from ovibjax.features.basis import ViewBasis, project
from ovibjax.features.frames import FeatureSet
from ovibjax.features.images.codecs import CODECS, LADDERS
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
        val: validation frames per seed, which choose the mixing weight.
        test: test frames per seed.
        rungs: codecs and qualities, each codec from its fewest bytes up.
    """

    val: int
    test: int
    rungs: tuple[Rung, ...]


class CodedFrames(NamedTuple):
    """Frames of one seed that are coded: indices into the feature set, and positions within its test part."""

    val: NDArray[np.int64]
    test: NDArray[np.int64]
    test_rows: NDArray[np.int64]


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
        with job.stage("codecs"), progress_bar("rendering and coding 400 x 300 px", len(frames)) as update:
            return coded_town(TownConfig(), n_frames, frames, rungs, on_frames=update)

    with job.stage("judge"):
        frontier = judge_codecs(job.features, prepared, outcomes, plan, code)
    gap = interval(frontier.plain_m - frontier.native_m)
    note = (
        f" Image codecs code 400 x 300 px renders of {frontier.error_m.shape[2]} test frames per seed, from the "
        "coarsest quality they have; before coding these renders err by "
        f"{gap.text('m')} more than the 64 x 48 px ones that the database is made of."
    )
    return frontier, note + (f" H.264 and H.265 are left out: {reason}." if reason else "")


def choose_frames(n: int, seed: int, plan: CodecPlan) -> CodedFrames:
    """A random part of a seed's validation and test frames; never more than there are.

    Args:
        n: frames of the feature set.
        seed: the split.
        plan: how many.

    Returns:
        Ascending indices.
    """
    split = split_indices(n, seed)
    rng = np.random.default_rng([seed, _STREAM])
    val = np.sort(rng.permutation(split.val)[: plan.val])
    rows = np.sort(rng.permutation(len(split.test))[: plan.test])
    return CodedFrames(val, split.test[rows], rows)


def judge_codecs(
    feature_set: FeatureSet,
    prepared: Mapping[int, tuple[MemberData, ViewBasis]],
    outcomes: Mapping[int, Mapping[str, Outcome]],
    plan: CodecPlan,
    code: Callable[[NDArray[np.int64]], CodedViews],
) -> Frontier:
    """Code, decode and localize.

    Args:
        feature_set: what everything was trained on.
        prepared: data and basis per seed.
        outcomes: trained methods per seed; `ovib` brings the frozen localizer.
        plan: frames and rungs.
        code: the coded views of frames by index; called once with the frames of all seeds.

    Returns:
        The frontier, on the seeds of `outcomes`.
    """
    native_features, at_m = feature_set.features, feature_set.positions_m
    chosen = {seed: choose_frames(len(native_features), seed, plan) for seed in outcomes}
    frames = np.unique(np.concatenate([part for c in chosen.values() for part in (c.val, c.test)]))
    coded = code(frames)
    of_ovib = int(np.flatnonzero(prefixes_of("ovib") == RIVAL_K)[0])
    sizes, errors, plain, native, ovib = [], [], [], [], []
    for seed, mine in chosen.items():
        both = np.concatenate([mine.val, mine.test])
        at = np.searchsorted(frames, both)
        views = CodedViews(coded.plain[at], coded.coded[at], coded.payload_bytes[at])
        judge = _judge_with(prepared[seed], outcomes[seed]["ovib"], at_m[mine.val], at_m[mine.test])
        errors.append(np.stack([judge(views.coded[:, r]) for r in range(len(plan.rungs))]))
        plain.append(judge(views.plain).mean())
        native.append(judge(native_features[both]).mean())
        sizes.append(views.payload_bytes[len(mine.val) :].mean(axis=0))
        ovib.append(outcomes[seed]["ovib"].judged["ovib"].test_error_m[of_ovib][mine.test_rows].mean())
    means = (np.array(values, np.float64) for values in (plain, native, ovib))
    return Frontier(plan.rungs, tuple(outcomes), np.stack(sizes), np.stack(errors), *means)


def _judge_with(
    prepared: tuple[MemberData, ViewBasis], ovib: Outcome, val_m: NDArray[np.float32], test_m: NDArray[np.float32]
) -> Callable[[NDArray[np.float32]], NDArray[np.float32]]:
    """A function from features [V + T, M, d] of validation and test frames to errors [T] of the test frames."""
    data, basis = prepared
    arch = architecture_of(data)
    mask = mode_mask(full_mode(arch.n_views), arch.n_views)

    def judge(features: NDArray[np.float32]) -> NDArray[np.float32]:
        val_x, test_x = (jnp.asarray(x) for x in np.split(project(basis, features), [len(val_m)]))
        seen = data._replace(val_x=val_x, test_x=test_x, val_m=jnp.asarray(val_m), test_m=jnp.asarray(test_m))
        return np.asarray(judge_raw_jit(Trained(seen, ovib.params), arch, mask).test_error_m)

    return judge

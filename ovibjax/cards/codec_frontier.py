"""Image codecs under the frozen localizer: the error at each quality, and the bytes a codec needs for O-VIB's error.

Frames that a codec has passed through meet the localizer like uncompressed ones: the database holds uncompressed
reference descriptors, and the mixing weight is chosen on validation frames per quality. A random part of each seed's
validation and test frames is coded; O-VIB is compared on the same test frames.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ovibjax.cards.compression_methods import LATENT, Outcome, judge_raw_jit, prefixes_of
from ovibjax.encoder.data_split import MemberData
from ovibjax.encoder.model import Architecture
from ovibjax.features.basis import ViewBasis, project
from ovibjax.features.frames import FeatureSet, split_indices
from ovibjax.views import full_mode, mode_mask
from ovibjax.world.town.coded import CodedViews, Rung

RIVAL_K = 32
"""Prefix of O-VIB that the codecs are compared with."""

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


@dataclass(frozen=True)
class Frontier:
    """Errors and payloads of R rungs on S seeds.

    Attributes:
        rungs: codecs and qualities.
        seeds: the seeds.
        payload_bytes: [S, R] mean over test frames.
        error_m: [S, R, T] error per test frame.
        plain_m: [S] mean error of the images before coding.
        native_m: [S] mean error of the features that the database and the training were made from.
        ovib_m: [S] mean error of O-VIB at k = `RIVAL_K`.
    """

    rungs: tuple[Rung, ...]
    seeds: tuple[int, ...]
    payload_bytes: NDArray[np.float64]
    error_m: NDArray[np.float32]
    plain_m: NDArray[np.float64]
    native_m: NDArray[np.float64]
    ovib_m: NDArray[np.float64]

    @property
    def codecs(self) -> tuple[str, ...]:
        """Codecs in the order of the rungs."""
        return tuple(dict.fromkeys(codec for codec, _ in self.rungs))

    def of(self, codec: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Payloads [S, r] in bytes and mean errors [S, r] in metres of one codec's rungs."""
        mine = [i for i, (name, _) in enumerate(self.rungs) if name == codec]
        return self.payload_bytes[:, mine], self.error_m.mean(axis=2, dtype=np.float64)[:, mine]

    def equal_error_bytes(self, codec: str) -> NDArray[np.float64]:
        """[S] fewest bytes at which the codec reaches O-VIB's error; infinite where no quality does."""
        return np.array(
            [fewest_bytes(*rows, self.ovib_m[i]) for i, rows in enumerate(zip(*self.of(codec), strict=True))]
        )

    def coarsest_suffices(self, codec: str) -> bool:
        """Whether the codec's coarsest quality reaches O-VIB's error on every seed: a coarser one might, too."""
        return bool((self.of(codec)[1][:, 0] <= self.ovib_m).all())

    def table_rows(self) -> list[dict[str, Any]]:
        """One tidy row per codec, quality and seed."""
        rows = []
        for r, (codec, quality) in enumerate(self.rungs):
            for s, seed in enumerate(self.seeds):
                error = self.error_m[s, r]
                row = {"codec": codec, "quality": quality, "seed": seed}
                row |= {"payload_bytes": f"{self.payload_bytes[s, r]:.1f}", "mean_m": f"{error.mean():.4f}"}
                rows.append(row | {"p90_m": f"{np.percentile(error, 90):.4f}"})
        return rows


def fewest_bytes(payload_bytes: NDArray[np.float64], error_m: NDArray[np.float64], target_m: float) -> float:
    """Payload at which a rising ladder first reaches an error: between two rungs, linear in the logarithm of bytes.

    Args:
        payload_bytes: [r] increasing.
        error_m: [r] mean errors.
        target_m: the error to reach.

    Returns:
        Bytes; the lowest rung's if that already reaches it, infinite if none does.
    """
    reached = np.flatnonzero(error_m <= target_m)
    if not reached.size:
        return float("inf")
    i = int(reached[0])
    if i == 0:
        return float(payload_bytes[0])
    share = (error_m[i - 1] - target_m) / (error_m[i - 1] - error_m[i])
    low, high = np.log(payload_bytes[i - 1 : i + 1])
    return float(np.exp(low + share * (high - low)))


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
    member, basis = prepared
    views, dim = member.train.x.shape[1:]
    arch = Architecture(n_views=views, view_dim=dim, latent=LATENT)
    mask = mode_mask(full_mode(views), views)

    def judge(features: NDArray[np.float32]) -> NDArray[np.float32]:
        val_x, test_x = (jnp.asarray(x) for x in np.split(project(basis, features), [len(val_m)]))
        seen = member._replace(val_x=val_x, test_x=test_x, val_m=jnp.asarray(val_m), test_m=jnp.asarray(test_m))
        return np.asarray(judge_raw_jit(ovib.params, seen, arch, mask).test_error_m)

    return judge

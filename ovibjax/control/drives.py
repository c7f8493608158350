"""Drives, sequences of frames through a scene: the embedded town's or one's own; which frames the edge keeps.

The embedded scene is a town of 200 m, as small as the paper's Town02, with six drives of 593 half-second slots: the
first three are training routes, the others are held out. Its seed and its blocks were chosen by the mix of contexts
along the drives alone, near 0.63 / 0.20 / 0.17 (see `protocols.PAPER_CONTEXT_MIX`); the routes have 0.61 / 0.23 / 0.16.
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import numpy as np

from ovibjax.control.calibration import LEVELS
from ovibjax.control.environment import PAPER_SLOTS
from ovibjax.encoder.checkpoint import TRAIN_FRAMES
from ovibjax.errors import InputError
from ovibjax.features.frames import CONTEXTS, FeatureSet
from ovibjax.features.places import from_origin, origin_of
from ovibjax.world.town.feature_set import town_features
from ovibjax.world.town.layout import TownConfig

TOWN = TownConfig(seed=6, size_m=200.0, block_m=100.0)

DRIVES = 6
"""Half of them are held out; the paper has one held-out route, and does not say how many training routes."""

SURVEY_M, SURVEY_DEG = 9.0, 15.0
"""The edge keeps a frame this far from the last one, or turned by so much. Leaving out only the frame itself would
leave its neighbours, 1.6 m away, and every residual would be their distance. A survey every 9 m leaves the 2 to 4 m
that the paper reports after a request, and larger front-only residuals, as the paper has them (Section "View-Rate
Selection"); every 4 m they are not larger. In turns a survey by distance alone would leave headings never seen."""

ELSEWHERE_M = 2.0 * SURVEY_M
"""A reference this far from another is in another place: neighbours of a survey every 9 m show the same one."""


@dataclass(frozen=True)
class JoinedDrives:
    """The frames of all drives of a scene, one after another; the first drives are training routes.

    Attributes:
        features: [N, M, d] unit-norm view features.
        positions_m: [N, 3] float32, where they were taken, from the origin of all drives (`features.places`).
        yaw_rad: [N] headings.
        context: [N] route context, index into `contexts`.
        contexts: names of the contexts; `unknown` is among them where some frame's is.
        drive: [N] number of the drive.
        training: how many drives are training routes.
    """

    features: np.ndarray
    positions_m: np.ndarray
    yaw_rad: np.ndarray
    context: np.ndarray
    contexts: tuple[str, ...]
    drive: np.ndarray
    training: int

    @property
    def known(self) -> np.ndarray:
        """[N] bool, frames of training routes."""
        return self.drive < self.training

    @property
    def first_frames(self) -> np.ndarray:
        """[L, M, d] what the checkpoint is trained on: the first frames of the first drive."""
        return self.features[: min(TRAIN_FRAMES, np.sum(self.drive == 0))]

    @property
    def references(self) -> np.ndarray:
        """[R] ascending rows that the edge keeps."""
        return survey(self.positions_m, self.yaw_rad, self.drive, SURVEY_M, SURVEY_DEG)

    @property
    def context_share(self) -> np.ndarray:
        """[C] share of the training frames in each context."""
        return np.bincount(self.context[self.known], minlength=len(self.contexts)) / self.known.sum()


def join_drives(sets: list[FeatureSet], training: int) -> JoinedDrives:
    """All drives of a scene as one sequence of frames.

    Args:
        sets: one feature set per drive, frames in order.
        training: how many of them, from the first, are training routes.

    Returns:
        The frames.

    Raises:
        InputError: fewer training frames than the calibration tells levels apart.
    """
    seen = sum(len(s.features) for s in sets[:training])
    if seen < LEVELS:
        raise InputError(f"{seen} frames on training routes; request control needs at least {LEVELS}")
    places = [s.positions_m for s in sets]
    context, contexts = np.concatenate([s.context for s in sets]), CONTEXTS
    if (context < 0).any():
        context, contexts = np.where(context < 0, len(CONTEXTS), context), (*CONTEXTS, "unknown")
    return JoinedDrives(
        features=np.concatenate([s.features for s in sets]),
        positions_m=from_origin(np.concatenate(places), origin_of(*places)),
        yaw_rad=np.concatenate([s.yaw_rad for s in sets]),
        context=context,
        contexts=contexts,
        drive=np.repeat(np.arange(len(sets)), [len(s.features) for s in sets]),
        training=training,
    )


def embedded_drives(
    slots: int = PAPER_SLOTS, drives: int = DRIVES, on_frames: Callable[[int, int], None] | None = None
) -> list[FeatureSet]:
    """Frames of drives through the embedded town.

    Args:
        slots: slots per drive.
        drives: number of drives; the first half are training routes.
        on_frames: called with (done, total) as frames are rendered; not for those that the cache has.

    Returns:
        One feature set per drive.
    """

    def report(drive: int) -> Callable[[int, int], None] | None:
        if on_frames is None:
            return None
        return lambda done, _: on_frames(drive * slots + done, drives * slots)

    return [town_features(TOWN, slots, drive, on_frames=report(drive)) for drive in range(drives)]


def halves(features: FeatureSet) -> list[FeatureSet]:
    """One sequence of frames, half a second apart, as a training route (its first 60 %) and a held-out one."""
    cut = round(0.6 * len(features.features))
    return [jax.tree.map(lambda field, rows=rows: field[rows], features) for rows in (slice(cut), slice(cut, None))]


def survey(
    positions_m: np.ndarray, yaw_rad: np.ndarray, drive: np.ndarray, spacing_m: float, turn_deg: float
) -> np.ndarray:
    """Frames that a survey of the scene keeps as references: one every so many metres, or degrees, of each drive.

    Args:
        positions_m: [N, 3] positions along the drives.
        yaw_rad: [N] headings.
        drive: [N] which drive a frame belongs to.
        spacing_m: distance between kept frames; 0 keeps all.
        turn_deg: rotation after which a frame is kept before that.

    Returns:
        Ascending rows.
    """
    step_m = np.linalg.norm(np.diff(positions_m, axis=0, prepend=positions_m[:1]), axis=1)
    turn_rad = np.abs(np.angle(np.exp(1j * np.diff(yaw_rad, prepend=yaw_rad[:1]))))
    kept = []
    since_m, since_rad = np.inf, 0.0
    for row in range(len(positions_m)):
        new_drive = row > 0 and drive[row] != drive[row - 1]
        since_m, since_rad = (np.inf, 0.0) if new_drive else (since_m + step_m[row], since_rad + turn_rad[row])
        if since_m >= spacing_m or since_rad >= np.deg2rad(turn_deg):
            kept.append(row)
            since_m = since_rad = 0.0
    return np.array(kept)

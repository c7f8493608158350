"""Routes to replay: drives through a small embedded town, or somebody's own sequence of frames.

The embedded scene is a town of 180 m, as small as the paper's Town02, with six drives of 593 half-second slots: the
first three are training routes, the others are held out. Town and drives were chosen by their mix of contexts alone.
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import numpy as np

from ovibjax.control.actions import ACTIONS, ActionSet
from ovibjax.control.environment import PAPER_SLOTS, Route
from ovibjax.control.residuals import (
    TRAIN_FRAMES,
    CheckpointConfig,
    actions_for,
    fit_predictor,
    residuals_m,
    survey,
    train_checkpoint,
)
from ovibjax.features.frames import CONTEXTS, FeatureSet
from ovibjax.world.town.feature_set import town_features
from ovibjax.world.town.layout import TownConfig

TOWN = TownConfig(seed=2, size_m=180.0)
DRIVES = 6
SURVEY_M = 9.0
"""Spacing of the edge's references. Leaving out only the frame itself would leave its neighbours, 1.5 m away, and every
residual would be their distance; a survey every 9 m leaves the 2 to 4 m that the paper reports after a request."""


@dataclass(frozen=True)
class Scene:
    """Routes with their residuals, and what was learned from the training routes.

    Attributes:
        training: training routes; prices are tuned on them.
        held_out: routes that neither checkpoint nor predictor has seen.
        predictor_m: [C, A] g_psi.
        context_share: [C] share of slots in each context on the training routes.
        contexts: their names.
        actions: the action set.
    """

    training: list[Route]
    held_out: list[Route]
    predictor_m: np.ndarray
    context_share: np.ndarray
    contexts: tuple[str, ...]
    actions: ActionSet


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


def make_scene(sets: list[FeatureSet], training: int, checkpoint: CheckpointConfig) -> Scene:
    """Train the checkpoint, retrieve, fit the predictor, and cut the routes.

    Args:
        sets: one feature set per drive, frames in order.
        training: how many of them are training routes.
        checkpoint: static choices of the encoder.

    Returns:
        The scene.
    """
    lengths = [len(s.features) for s in sets]
    features = np.concatenate([s.features for s in sets])
    positions_m = np.concatenate([s.positions_m for s in sets])
    context = np.concatenate([s.context for s in sets])
    contexts = CONTEXTS
    if (context < 0).any():
        context, contexts = np.where(context < 0, len(CONTEXTS), context), (*CONTEXTS, "unknown")
    drive = np.repeat(np.arange(len(sets)), lengths)
    actions = actions_for(features.shape[1], ACTIONS)
    trained = train_checkpoint(jax.random.key(0), features[: min(TRAIN_FRAMES, lengths[0])], checkpoint)
    realised = residuals_m(trained, features, positions_m, survey(positions_m, drive, SURVEY_M), actions)
    seen = drive < training
    predictor = fit_predictor(np.linalg.norm(realised[seen], axis=-1), context[seen], len(contexts))
    routes = [
        Route(
            context=context[rows].astype(np.int32),
            yaw_rad=np.concatenate([s.yaw_rad for s in sets])[rows],
            predicted_m=predictor[context[rows]],
            residual_m=realised[rows],
        )
        for rows in (drive == i for i in range(len(sets)))
    ]
    share = np.bincount(context[seen], minlength=len(contexts)) / seen.sum()
    return Scene(routes[:training], routes[training:], predictor, share, contexts, actions)

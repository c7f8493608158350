"""What request control is replayed on: routes with the residuals of every action, and what training routes taught."""

from dataclasses import dataclass

import jax
import numpy as np

from ovibjax.control.actions import ACTIONS, ActionSet, actions_for
from ovibjax.control.drives import join_drives
from ovibjax.control.environment import Route
from ovibjax.control.predictor import fit_predictor
from ovibjax.control.residuals import residuals_m
from ovibjax.encoder.checkpoint import CHECKPOINT, CheckpointConfig, train_checkpoint
from ovibjax.features.frames import FeatureSet


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


def make_scene(sets: list[FeatureSet], training: int, checkpoint: CheckpointConfig = CHECKPOINT) -> Scene:
    """Train the checkpoint, retrieve, fit the predictor, and cut the routes.

    Args:
        sets: one feature set per drive, frames in order.
        training: how many of them are training routes.
        checkpoint: static choices of the encoder.

    Returns:
        The scene.
    """
    frames = join_drives(sets, training)
    actions = actions_for(frames.features.shape[1], ACTIONS)
    trained = train_checkpoint(jax.random.key(0), frames.first_frames, checkpoint)
    realised = residuals_m(trained, frames.features, frames.positions_m, frames.references, actions)
    known, context = frames.known, frames.context
    predictor = fit_predictor(np.linalg.norm(realised[known], axis=-1), context[known], len(frames.contexts))
    routes = [
        Route(
            context=context[rows].astype(np.int32),
            yaw_rad=frames.yaw_rad[rows],
            predicted_m=predictor[context[rows]],
            residual_m=realised[rows],
        )
        for rows in (frames.drive == i for i in range(len(sets)))
    ]
    return Scene(routes[:training], routes[training:], predictor, frames.context_share, frames.contexts, actions)

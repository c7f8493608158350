"""What request control is replayed on: routes with the residuals of every action, and what training routes taught."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.control.actions import ACTIONS, ActionSet, actions_for
from ovibjax.control.calibration import calibrated_risk_m, fit_calibration
from ovibjax.control.drives import JoinedDrives, join_drives
from ovibjax.control.environment import Route
from ovibjax.control.predictor import PRIORS, fit_calibrated_prior, fit_predictor
from ovibjax.control.residuals import answers
from ovibjax.encoder.checkpoint import CHECKPOINT, Checkpoint, CheckpointConfig, train_checkpoint
from ovibjax.features.frames import FeatureSet


@dataclass(frozen=True)
class Scene:
    """Routes with their residuals, and what was learned from the training routes.

    Attributes:
        training: training routes; prices are tuned on them.
        held_out: routes that neither checkpoint nor predictor nor calibration has seen.
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


@dataclass(frozen=True)
class Reading:
    """How the paper is read where it leaves a choice.

    Attributes:
        recode: whether the edge's references have passed through the code of the request, see `residuals`.
        prior: what an action is expected to leave, one of `predictor.PRIORS`.
    """

    recode: bool = False
    prior: str = PRIORS[0]


def make_scene(
    sets: list[FeatureSet],
    training: int,
    checkpoint: CheckpointConfig = CHECKPOINT,
    reading: Reading = Reading(),
) -> Scene:
    """Train the checkpoint, retrieve, fit predictor and calibration on training routes, and cut the routes.

    Args:
        sets: one feature set per drive, frames in order.
        training: how many of them are training routes.
        checkpoint: static choices of the encoder.
        reading: how the paper is read.

    Returns:
        The scene.

    Raises:
        InputError: too few training frames.
    """
    frames = join_drives(sets, training)
    return cut_scene(frames, train_checkpoint(jax.random.key(0), frames.first_frames, checkpoint), reading)


def cut_scene(frames: JoinedDrives, trained: Checkpoint, reading: Reading, sent: np.ndarray | None = None) -> Scene:
    """`make_scene` with a checkpoint that is trained already.

    Args:
        frames: the frames of all drives.
        trained: the checkpoint.
        reading: how the paper is read.
        sent: [N, M, d] features that robots send of these frames, where they are not those that the checkpoint, the
            edge's references and the calibration know.

    Returns:
        The scene.
    """
    actions = actions_for(frames.features.shape[1], ACTIONS)
    found = answers(trained, frames.features, frames.positions_m, frames.references, actions, reading.recode)
    length_m = np.linalg.norm(found.residual_m, axis=-1)
    distinctness = jnp.asarray(found.distinctness)
    calibration = fit_calibration(distinctness, jnp.asarray(length_m**2), jnp.asarray(frames.known))
    risk_m = np.asarray(calibrated_risk_m(calibration, distinctness))
    known, context, contexts = frames.known, frames.context, len(frames.contexts)
    if reading.prior == "calibrated":
        prior = fit_calibrated_prior(risk_m[known], context[known], contexts)
    else:
        prior = fit_predictor(length_m[known], context[known], contexts)
    if sent is not None:
        edge = frames.features, frames.positions_m, frames.references
        found = answers(trained, *edge, actions, reading.recode, sent)
        risk_m = np.asarray(calibrated_risk_m(calibration, jnp.asarray(found.distinctness)))
    routes = [
        Route(
            context=context[rows].astype(np.int32),
            yaw_rad=frames.yaw_rad[rows],
            predicted_m=prior[context[rows]],
            residual_m=found.residual_m[rows],
            risk_m=risk_m[rows],
        )
        for rows in (frames.drive == i for i in range(frames.drive[-1] + 1))
    ]
    cut = frames.training
    return Scene(routes[:cut], routes[cut:], prior, frames.context_share, frames.contexts, actions)

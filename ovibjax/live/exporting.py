"""An edge file from drives through a scene: train the checkpoint, survey the scene, and lay out the robots' routes.

All is as in the study of request control (`control.scene`), but for one thing: a robot never stands on a frame that the
edge keeps, as it would find itself. Replays leave such a frame out of the database; a server that does not know which
frame it is asked about cannot. So the robots' routes are the held-out drives without the references.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.control.actions import ACTIONS, actions_for
from ovibjax.control.adaptation import ADAPT, fit_expected
from ovibjax.control.calibration import calibrated_risk_m, fit_calibration
from ovibjax.control.drives import JoinedDrives, join_drives
from ovibjax.control.predictor import fit_predictor
from ovibjax.control.residuals import answers
from ovibjax.encoder.checkpoint import CHECKPOINT, CheckpointConfig, train_checkpoint
from ovibjax.errors import InputError
from ovibjax.features.basis import project
from ovibjax.features.frames import FeatureSet
from ovibjax.features.places import origin_of
from ovibjax.link.codes.tables import CODES, fit_table
from ovibjax.live.edge_file import EdgeFile
from ovibjax.live.mode_codes import mode_codes


def make_edge(
    sets: list[FeatureSet],
    training: int,
    checkpoint: CheckpointConfig = CHECKPOINT,
    on_stage: Callable[[str], None] = lambda _: None,
) -> EdgeFile:
    """Train the checkpoint on the first drive, and put together what edge and robots need.

    Args:
        sets: one feature set per drive, frames in order and half a second apart.
        training: how many of them, from the first, are training routes.
        checkpoint: static choices of the encoder.
        on_stage: told what is being done.

    Returns:
        The edge file.

    Raises:
        InputError: no drive is held out, or a held-out drive has no frame beside references.
    """
    if not 0 < training < len(sets):
        raise InputError(f"{len(sets)} drives with {training} for training leave none to drive on")
    frames = join_drives(sets, training)
    actions = actions_for(frames.features.shape[1], ACTIONS)
    on_stage("training the encoder")
    trained = train_checkpoint(jax.random.key(0), frames.first_frames, checkpoint)
    on_stage("retrieving residuals")
    kept, known, context = frames.references, frames.known, frames.context
    realised, distinctness = answers(trained, frames.features, frames.positions_m, kept, actions)
    length_m, distinct = np.linalg.norm(realised, axis=-1), jnp.asarray(distinctness)
    calibration = fit_calibration(distinct, jnp.asarray(length_m**2), jnp.asarray(known))
    risk_m = np.asarray(calibrated_risk_m(calibration, distinct))
    taught = length_m[known], risk_m[known], context[known], len(frames.contexts)
    x = project(trained.basis, frames.features)
    rows = _route_rows(frames, kept)
    # Robots send codes of every mode; tables are fitted to them together.
    seen = mode_codes(trained.params, trained.arch, x[known], actions).reshape(-1, trained.arch.latent)
    return EdgeFile(
        arch=trained.arch,
        actions=actions,
        contexts=frames.contexts,
        params=jax.device_get(trained.params),
        reference_x=x[kept],
        reference_m=frames.positions_m[kept],
        origin_m=origin_of(*(s.positions_m for s in sets)),
        edges=np.asarray(calibration.edges),
        risk_m=np.sqrt(np.asarray(calibration.mean_square_m2)),
        predicted_m=fit_predictor(length_m[known], context[known], len(frames.contexts)),
        context_share=frames.context_share.astype(np.float32),
        route_x=x[rows],
        route_m=frames.positions_m[rows],
        route_yaw_rad=frames.yaw_rad[rows].astype(np.float32),
        route_context=context[rows].astype(np.int32),
        route_number=(frames.drive[rows] - training).astype(np.int32),
        route_residual_m=realised[rows],
        route_risk_m=risk_m[rows],
        tables={code: table for code in CODES if (table := fit_table(code, seen)) is not None},
        expected_m={adapt: fit_expected(*taught, adapt) for adapt in ADAPT[1:]},
    )


def _route_rows(frames: JoinedDrives, kept: np.ndarray) -> np.ndarray:
    """Frames of held-out drives that the edge does not keep."""
    free = np.setdiff1d(np.flatnonzero(~frames.known), kept)
    drives = np.arange(frames.training, frames.drive[-1] + 1)
    if not np.isin(drives, frames.drive[free]).all():
        raise InputError("a held-out drive has no frame beside those that the edge keeps; give a longer one")
    return free

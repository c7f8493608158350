"""An edge file from drives through a scene: train the checkpoint, survey the scene, and lay out the robots' routes.

All is as in the study of request control (`control.scene`), but for one thing: a robot never stands on a frame that the
edge keeps, as it would find itself. Replays leave such a frame out of the database; a server that does not know which
frame it is asked about cannot. So the robots' routes are the held-out drives without the references.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.control.actions import ACTIONS, ActionSet, actions_for
from ovibjax.control.drives import JoinedDrives, join_drives
from ovibjax.control.predictor import fit_predictor
from ovibjax.control.residuals import answers, encode_views
from ovibjax.edge.retrieval import normalize
from ovibjax.encoder.checkpoint import CHECKPOINT, Checkpoint, CheckpointConfig, train_checkpoint
from ovibjax.errors import InputError
from ovibjax.features.basis import project
from ovibjax.features.frames import FeatureSet
from ovibjax.features.places import origin_of
from ovibjax.link.codes.tables import CODES, fit_table
from ovibjax.live.edge_file import EdgeFile
from ovibjax.live.edge_model import descriptors, nearest
from ovibjax.views import mode_mask

CLASSES = 8
"""Classes of similarity by which an edge expects a residual."""


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
    kept = frames.references
    # The file holds references as codes, so that they have passed through the code of the request.
    realised = answers(trained, frames.features, frames.positions_m, kept, actions, recode=True).residual_m
    x = project(trained.basis, frames.features)
    codes = codes_of(trained, x, actions)
    known, context = frames.known, frames.context
    expected = _expectation(trained, codes, kept, known, realised, actions)
    rows = _route_rows(frames, kept)
    # Robots send codes of every mode; they are fitted together.
    seen = codes[:, known].reshape(-1, codes.shape[-1])
    return EdgeFile(
        arch=trained.arch,
        actions=actions,
        contexts=frames.contexts,
        params=jax.device_get(trained.params),
        reference_code=codes[:, kept],
        reference_m=frames.positions_m[kept],
        origin_m=origin_of(*(s.positions_m for s in sets)),
        similarity=expected[0],
        residual_m=expected[1],
        predicted_m=fit_predictor(np.linalg.norm(realised[known], axis=-1), context[known], len(frames.contexts)),
        context_share=frames.context_share.astype(np.float32),
        route_x=x[rows],
        route_m=frames.positions_m[rows],
        route_yaw_rad=frames.yaw_rad[rows].astype(np.float32),
        route_context=context[rows].astype(np.int32),
        route_number=(frames.drive[rows] - training).astype(np.int32),
        route_residual_m=realised[rows],
        tables={code: table for code in CODES if (table := fit_table(code, seen)) is not None},
    )


def codes_of(trained: Checkpoint, x: np.ndarray, actions: ActionSet) -> np.ndarray:
    """[modes, N, K] codes of frames x [N, M, r], of the views of each mode."""
    flat = jnp.asarray(x.reshape(len(x), -1))
    encode = jax.jit(encode_views, static_argnames="arch")
    masks = [mode_mask(mode, trained.arch.n_views) for mode in actions.modes]
    return np.stack([np.asarray(encode(trained.params, flat, mask, trained.arch)) for mask in masks])


def _route_rows(frames: JoinedDrives, kept: np.ndarray) -> np.ndarray:
    """Frames of held-out drives that the edge does not keep."""
    free = np.setdiff1d(np.flatnonzero(~frames.known), kept)
    drives = np.arange(frames.training, frames.drive[-1] + 1)
    if not np.isin(drives, frames.drive[free]).all():
        raise InputError("a held-out drive has no frame beside those that the edge keeps; give a longer one")
    return free


def _expectation(
    trained: Checkpoint,
    codes: np.ndarray,
    kept: np.ndarray,
    known: np.ndarray,
    realised: np.ndarray,
    actions: ActionSet,
) -> tuple[np.ndarray, np.ndarray]:
    """Bounds [A, B - 1] between classes of similarity, and the median residual [A, B] of training frames in each."""
    asked = np.setdiff1d(np.flatnonzero(known), kept)
    bounds, medians = [], []
    for a, k in enumerate(actions.prefix):
        of_mode = codes[a // len(actions.prefixes)]
        mask = mode_mask(actions.modes[a // len(actions.prefixes)], trained.arch.n_views)
        database = normalize(descriptors(trained.params, of_mode[kept], k, mask, trained.arch))
        seen = nearest(descriptors(trained.params, of_mode[asked], k, mask, trained.arch), database)
        similarity = np.asarray(seen)[1]
        distance_m = np.linalg.norm(realised[asked, a], axis=-1)
        between = np.quantile(similarity, np.arange(1, CLASSES) / CLASSES).astype(np.float32)
        of_class = np.searchsorted(between, similarity)
        bounds.append(between)
        # Equal similarities may leave a class empty.
        medians.append(
            [np.median(distance_m[of_class == c] if (of_class == c).any() else distance_m) for c in range(CLASSES)]
        )
    return np.stack(bounds), np.array(medians, np.float32)

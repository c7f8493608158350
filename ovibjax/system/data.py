"""Frames of drives to the arrays that the whole system runs on."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.control.actions import ActionSet
from ovibjax.control.controller import make_controller
from ovibjax.control.environment import make_environment
from ovibjax.control.residuals import TRAIN_FRAMES, survey
from ovibjax.control.scene import SURVEY_M
from ovibjax.encoder.model import Architecture
from ovibjax.encoder.train import TrainConfig
from ovibjax.errors import InputError
from ovibjax.features.basis import fit_basis, project
from ovibjax.features.frames import CONTEXTS, FeatureSet
from ovibjax.scheduling.clients import default_trace_params
from ovibjax.scheduling.congestion import LEVELS, PHASE_SPREAD_S
from ovibjax.scheduling.rules import default_params
from ovibjax.system.chain import SystemConfig, SystemData
from ovibjax.views import modes_for

PREFIXES = (8, 16, 32, 64, 128)
"""Prefix lengths that the encoder is trained at."""


@dataclass(frozen=True)
class SystemSize:
    """How much is trained and replayed.

    Attributes:
        steps: training steps.
        mixed: training examples made by mixing frames.
        rank: principal coordinates kept per view.
        clients: clients replayed, on the held-out routes in turn.
        fleet: clients N on each edge server.
        kb_per_s: link profile, KB/s of 1,024 bytes.
        batch: examples per training step.
    """

    steps: int = 600
    mixed: int = 8192
    rank: int = 32
    clients: int = 6
    fleet: int = LEVELS["high"][0]
    kb_per_s: float = LEVELS["high"][1]
    batch: int = 128


def make_system(sets: list[FeatureSet], training: int, size: SystemSize) -> tuple[SystemData, SystemConfig]:
    """Arrays and static choices of the whole system.

    Every client that is replayed leads a fleet that repeats its requests on a server of its own, phases, urgencies,
    deadlines and service times drawn per client, as in the paper's multi-client replay.

    Args:
        sets: one feature set per drive, frames in order and half a second apart.
        training: how many of them, from the first, are training routes.
        size: how much is trained and replayed.

    Returns:
        Data and static choices.

    Raises:
        InputError: no drive is held out.
    """
    if not 0 < training < len(sets):
        raise InputError(f"{len(sets)} drives with {training} for training leave none to be judged on")
    lengths = [len(s.features) for s in sets]
    starts = np.concatenate([[0], np.cumsum(lengths)])
    features = np.concatenate([s.features for s in sets])
    positions_m = np.concatenate([s.positions_m for s in sets])
    context = np.concatenate([s.context for s in sets])
    n_contexts = len(CONTEXTS)
    if (context < 0).any():
        context, n_contexts = np.where(context < 0, n_contexts, context), n_contexts + 1
    drive = np.repeat(np.arange(len(sets)), lengths)
    known = drive < training
    seen = features[: min(TRAIN_FRAMES, lengths[0])]
    basis = fit_basis(seen, size.rank)
    references = survey(positions_m, drive, SURVEY_M)
    own = np.full(len(features), -1, np.int32)
    own[references] = np.arange(len(references))
    slots = min(lengths[training:])
    held_out = np.stack([np.arange(start, start + slots) for start in starts[training:-1]])
    x = project(basis, features)
    modes = modes_for(x.shape[1])
    share = np.bincount(context[known], minlength=n_contexts) / known.sum()
    data = SystemData(
        seen_x=project(basis, seen),
        x=x,
        positions_m=positions_m[:, :2],
        yaw_rad=np.concatenate([s.yaw_rad for s in sets]),
        context=context.astype(np.int32),
        known=known,
        references=references.astype(np.int32),
        own=own,
        routes=held_out[np.arange(size.clients) % len(held_out)].astype(np.int32),
        fleet=np.repeat(np.arange(size.clients, dtype=np.int32)[:, None], size.fleet, axis=1),
        env=make_environment(share, size.kb_per_s),
        control=make_controller(ActionSet(tuple(modes), (0,))),
        trace=default_trace_params()._replace(phase_spread_s=jnp.float32(PHASE_SPREAD_S)),
        scheduler=default_params(),
    )
    arch = Architecture(n_views=x.shape[1], view_dim=x.shape[2], latent=max(PREFIXES), hidden=256, last_hidden=128)
    config = TrainConfig(arch=arch, prefixes=PREFIXES, steps=size.steps, batch=size.batch)
    return jax.tree.map(jnp.asarray, data), SystemConfig(config, tuple(modes), mixed=size.mixed)

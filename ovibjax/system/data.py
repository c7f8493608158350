"""What the whole system runs on: static choices, arrays, and how drives become both."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.control.actions import ActionSet
from ovibjax.control.controller import Controller, make_controller
from ovibjax.control.drives import JoinedDrives, join_drives
from ovibjax.control.environment import Environment, make_environment
from ovibjax.control.residuals import Survey, make_survey
from ovibjax.encoder.checkpoint import CHECKPOINT_RANK
from ovibjax.encoder.model import Architecture
from ovibjax.encoder.train import TrainConfig
from ovibjax.errors import InputError
from ovibjax.features.basis import fit_basis, project
from ovibjax.features.frames import FeatureSet
from ovibjax.scheduling.clients import TraceParams, default_trace_params
from ovibjax.scheduling.congestion import LEVELS
from ovibjax.scheduling.rules import POLICIES, SchedulerParams, default_params
from ovibjax.views import modes_for

PREFIXES = (8, 16, 32, 64, 128)
"""Prefix lengths that the encoder is trained at."""


FLOATS = ("float32",)
"""Prefixes as the paper sends them."""


@dataclass(frozen=True)
class SystemConfig:
    """Static choices; hashable.

    Attributes:
        train: architecture, trained prefixes, steps.
        modes: view modes a client may choose among.
        policy: request policy, a key of `control.policies.POLICIES`.
        schedulers: scheduling rules at the edge.
        mixed: training examples made by mixing frames, see `encoder.checkpoint.mix_frames`.
        requests: most requests of one client; more would not be served, which `unserved` tells.
        codes: how prefixes are written, some of `link.codes.CODES`; but for floats alone a dimension of the metrics.
        compact: whether those that are not floats travel under a compact header.
    """

    train: TrainConfig
    modes: tuple[str, ...]
    policy: str = "voi"
    schedulers: tuple[str, ...] = POLICIES
    mixed: int = 8192
    requests: int = 40
    codes: tuple[str, ...] = FLOATS
    compact: bool = False


class SystemData(NamedTuple):
    """One scene, its clients and its servers; arrays.

    Attributes:
        seen_x: [L, M, r] features of the frames that are trained on, without positions.
        x: [F, M, r] features of every frame.
        positions_m: [F, 2] where they were taken, from the origin of all drives.
        yaw_rad: [F] headings.
        context: [F] int32 contexts.
        known: [F] bool, frames of training routes, on which g_psi is fitted.
        survey: the edge's database.
        routes: [C, T] int32 frames along the route of each client that is replayed.
        fleet: [S, N] int32 which of these clients each client of each edge server is; the first leads.
        env: drift, link, service.
        control: prices, budget, rules.
        trace: phases, urgencies, deadlines.
        scheduler: V and weights; V is replaced where it is swept.
    """

    seen_x: Any
    x: Any
    positions_m: Any
    yaw_rad: Any
    context: Any
    known: Any
    survey: Survey
    routes: Any
    fleet: Any
    env: Environment
    control: Controller
    trace: TraceParams
    scheduler: SchedulerParams


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
        requests: most requests of one client that the edge's queue has room for.
    """

    steps: int = 600
    mixed: int = 8192
    rank: int = CHECKPOINT_RANK
    clients: int = 6
    fleet: int = LEVELS["high"][0]
    kb_per_s: float = LEVELS["high"][1]
    batch: int = 128
    requests: int = 40


def make_system(sets: list[FeatureSet], training: int, size: SystemSize) -> tuple[SystemData, SystemConfig]:
    """Arrays and static choices of the whole system.

    Every client that is replayed leads a fleet on a server of its own: its clients ask when the leader does, with
    requests of the replayed clients in turn, and with phases, urgencies, deadlines and service times of their own, as
    in the paper's multi-client replay. Clients fuse corrections by their calibrated risk, as those of the scheduling
    figures do, so that an answer which is not found brings no burst of requests.

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
    frames = join_drives(sets, training)
    basis = fit_basis(frames.first_frames, size.rank)
    x = project(basis, frames.features)
    modes = modes_for(x.shape[1])
    held_out = held_out_rows(frames)
    data = SystemData(
        seen_x=project(basis, frames.first_frames),
        x=x,
        positions_m=frames.positions_m[:, :2],
        yaw_rad=frames.yaw_rad,
        context=frames.context.astype(np.int32),
        known=frames.known,
        survey=make_survey(frames.positions_m, frames.references),
        routes=held_out[np.arange(size.clients) % len(held_out)].astype(np.int32),
        fleet=((np.arange(size.clients)[:, None] + np.arange(size.fleet)) % size.clients).astype(np.int32),
        env=make_environment(frames.context_share, size.kb_per_s),
        control=make_controller(ActionSet(tuple(modes), (0,)), correction="kalman"),
        trace=default_trace_params(),
        scheduler=default_params(),
    )
    arch = Architecture(n_views=x.shape[1], view_dim=x.shape[2], latent=max(PREFIXES), hidden=256, last_hidden=128)
    config = TrainConfig(arch=arch, prefixes=PREFIXES, steps=size.steps, batch=size.batch)
    return jax.tree.map(jnp.asarray, data), SystemConfig(config, tuple(modes), mixed=size.mixed, requests=size.requests)


def held_out_rows(frames: JoinedDrives) -> np.ndarray:
    """[R, T] rows of each held-out drive, all as long as the shortest."""
    rows = [np.flatnonzero(frames.drive == drive) for drive in range(frames.training, frames.drive[-1] + 1)]
    slots = min(map(len, rows))
    return np.stack([of_drive[:slots] for of_drive in rows])

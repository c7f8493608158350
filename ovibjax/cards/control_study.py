"""The request-control study that the paper's figures share: sizes by preset, computed once per process."""

import math
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.control.belief import CORRECTIONS
from ovibjax.control.controller import GATE_SIGMA, PAPER_BUDGET_KB, Controller
from ovibjax.control.drift import DRIFT_MODELS
from ovibjax.control.drives import DRIVES, embedded_drives, halves, join_drives
from ovibjax.control.environment import PAPER_SLOTS, Environment, Route, make_environment
from ovibjax.control.policy_study import Outcome, Setting, StudySize
from ovibjax.control.predictor import PRIORS
from ovibjax.control.protocols import paper_route, place_of, run_study
from ovibjax.control.route_replay import RouteResult
from ovibjax.control.scene import Reading, Scene, cut_scene
from ovibjax.encoder.checkpoint import CheckpointConfig, train_checkpoint
from ovibjax.features.frames import FeatureSet, content_hash

PAPER_PROFILE_KB_PER_S = 8.0
"""Link profile of request control, the middle of the paper's 4 to 12 KB/s (paper, Section "Experimental Setup")."""

FACTORS = (0.5, 1.0, 2.0)
"""Factors on the drift rates, and on the budget, of the sensitivity study."""


class Point(NamedTuple):
    """One setting of the study.

    Attributes:
        model: a key of `drift.DRIFT_MODELS`.
        drift_scale: factor on every drift rate.
        budget_kb: payload per route, KB.
        protocol: one of `protocols.PROTOCOLS`.
        correction: one of `belief.CORRECTIONS`.
        gate_sigma: innovation above which a correction is discarded.
        recode: whether references have passed through the code of the request.
        prior: what an action is expected to leave, one of `predictor.PRIORS`.
    """

    model: str = "rate"
    drift_scale: float = 1.0
    budget_kb: float = PAPER_BUDGET_KB
    protocol: str = "paper"
    correction: str = "replace"
    gate_sigma: float = math.inf
    recode: bool = False
    prior: str = PRIORS[0]

    @property
    def reading(self) -> Reading:
        """How the scene is read."""
        return Reading(self.recode, self.prior)


PAPER, GATED = Point(), Point(gate_sigma=GATE_SIGMA)
"""The paper's setting; the same, but corrections that look impossible to the client are discarded."""

TAKEN, FUSED = Point(correction="always"), Point(correction="kalman")
"""Corrections that are taken even where they raise the risk, and such that are fused with the estimate."""

CODED = tuple(point._replace(recode=True) for point in (PAPER, TAKEN, FUSED, GATED))
"""The same four with references that have passed through the code of the request."""

EXPECTED = tuple(point._replace(prior=PRIORS[1]) for point in (PAPER, FUSED))
"""Two of them with the mean calibrated risk as what an action is expected to leave."""

TRANSFER = tuple(point._replace(protocol="transfer") for point in (PAPER, FUSED, GATED))
"""Routes that prices were not tuned on."""

ALWAYS = (PAPER, GATED, TAKEN, FUSED, *TRANSFER, *CODED, *EXPECTED)
"""What is replayed at every preset: what a client may do with a correction, and how the paper may be read."""

SENSITIVITY = tuple(
    dict.fromkeys(
        point
        for model in DRIFT_MODELS
        for factor in FACTORS
        for correction in (PAPER.correction, FUSED.correction)
        for point in (
            Point(model, factor, correction=correction),
            Point(model, budget_kb=factor * PAPER_BUDGET_KB, correction=correction),
        )
    )
)
"""Every drift model with its rates or the budget scaled; corrections that replace the estimate, and fused ones."""


@dataclass(frozen=True)
class ControlPreset:
    """Size of the study.

    Attributes:
        slots: slots per drive.
        drives: drives through the embedded town, half of them held out.
        size: candidates and seeds.
        sensitivity: whether drift and budget are varied.
        checkpoint: static choices of the encoder.
    """

    slots: int
    drives: int
    size: StudySize
    sensitivity: bool
    checkpoint: CheckpointConfig


PRESETS = {
    "smoke": ControlPreset(60, 2, StudySize(8, 2, 4), False, CheckpointConfig(steps=20, mixed=256)),
    "quick": ControlPreset(PAPER_SLOTS, DRIVES, StudySize(256, 8, 30), True, CheckpointConfig()),
    "full": ControlPreset(PAPER_SLOTS, DRIVES, StudySize(512, 8, 120), True, CheckpointConfig()),
}


@dataclass(frozen=True)
class ControlStudy:
    """Everything the figures of request control show; arrays on the host.

    Attributes:
        scene: routes, residuals and predictor.
        points: settings; the first are `ALWAYS`.
        outcome: search and held-out summaries, leading axis [settings].
        env: the environment of the first setting.
        control: the chosen configuration at the first setting.
        route: [T, ...] the held-out route of the first setting.
        runs: histories [seeds, T] of the policies in `policy_study.SHOWN` at the first setting.
        seeds: held-out seeds.
    """

    scene: Scene
    points: tuple[Point, ...]
    outcome: Outcome
    env: Environment
    control: Controller
    route: Route
    runs: dict[str, RouteResult]
    seeds: list[int]

    def free_kb(self, point: Point = PAPER) -> np.ndarray:
        """[seeds] what VOI-Control would send if the cap on the payload were not there, KB."""
        return np.asarray(self.outcome.free_kb)[self.points.index(point)].astype(np.float64)

    def histories(self, policy: str, point: Point) -> RouteResult:
        """Replays [seeds, T] of a policy in `policy_study.SHOWN` at a setting."""
        return jax.tree.map(lambda leaf: leaf[self.points.index(point)], self.outcome.histories[policy])

    def by_route(self, policy: str, metric: str, point: Point) -> np.ndarray:
        """[routes] mean of a held-out metric over the seeds of each held-out route, where `point` is of `TRANSFER`."""
        routes = len(self.scene.held_out)
        return np.array([self.of(policy, metric, point)[route::routes].mean() for route in range(routes)])

    def of(self, policy: str, metric: str, point: Point = PAPER) -> np.ndarray:
        """[seeds] a held-out metric of a policy."""
        values = np.asarray(getattr(self.outcome.held_out[policy], metric))
        return values[self.points.index(point)].astype(np.float64)


def drives_of(
    preset: str, data: FeatureSet | None, on_frames: Callable[[int, int], None] | None = None
) -> tuple[list[FeatureSet], int]:
    """The drives a study is about.

    Args:
        preset: a key of `PRESETS`.
        data: frames of somebody's own route; the embedded scene if None.
        on_frames: called with (done, total) as frames are rendered.

    Returns:
        A feature set per drive, and how many of them, from the first, are training routes.
    """
    if data is not None:
        return halves(data), 1
    size = PRESETS[preset]
    return embedded_drives(size.slots, size.drives, on_frames), size.drives // 2


_made: dict[Any, ControlStudy] = {}


def control_study(
    preset: str,
    first_seed: int,
    drives: list[FeatureSet],
    training: int,
    stage: Callable[[str], AbstractContextManager[None]],
) -> ControlStudy:
    """The study of a preset; figures that follow one another in a process share it.

    Args:
        preset: a key of `PRESETS`.
        first_seed: first held-out seed.
        drives: see `drives_of`.
        training: number of training routes among them.
        stage: counts time to a stage, as `Job.stage`.

    Returns:
        The study.
    """
    key = (preset, first_seed, training, *map(content_hash, drives))
    if key not in _made:
        _made.clear()
        with stage("train"):
            frames = join_drives(drives, training)
            trained = train_checkpoint(jax.random.key(0), frames.first_frames, PRESETS[preset].checkpoint)
        with stage("replay"):
            points = points_of(PRESETS[preset])
            readings = list(dict.fromkeys(point.reading for point in points))
            scenes = {reading: cut_scene(frames, trained, reading) for reading in readings}
            _made[key] = _make(PRESETS[preset], first_seed, points, scenes)
    return _made[key]


def points_of(preset: ControlPreset) -> tuple[Point, ...]:
    """Settings that a preset replays, the paper's first."""
    return tuple(dict.fromkeys((*ALWAYS, *(SENSITIVITY if preset.sensitivity else ()))))


def in_turn_of_search(points: tuple[Point, ...]) -> list[Point]:
    """The same settings, those next to one another that differ in their budget alone; see `policy_study.study`."""
    groups: dict[Point, list[Point]] = {}
    for point in points:
        groups.setdefault(point._replace(budget_kb=math.inf), []).append(point)
    return [point for group in groups.values() for point in group]


def _make(
    preset: ControlPreset, first_seed: int, points: tuple[Point, ...], scenes: Mapping[Reading, Scene]
) -> ControlStudy:
    scene, readings = scenes[PAPER.reading], list(scenes)
    turns = in_turn_of_search(points)
    envs = [make_environment(scene.context_share, PAPER_PROFILE_KB_PER_S, p.drift_scale, p.model) for p in turns]
    settings = Setting(
        drift=jax.tree.map(lambda *leaves: jnp.stack(leaves), *(env.drift for env in envs)),
        budget_kb=jnp.array([p.budget_kb for p in turns], jnp.float32),
        mean_kb_per_s=jnp.stack([env.mean_kb_per_s for env in envs]),
        place=jnp.array([place_of(readings.index(p.reading), p.protocol) for p in turns], jnp.int32),
        correction=jnp.array([CORRECTIONS.index(p.correction) for p in turns], jnp.int32),
        gate_sigma=jnp.array([p.gate_sigma for p in turns], jnp.float32),
    )
    outcome = jax.device_get(run_study(list(scenes.values()), settings, preset.size, first_seed))
    outcome = jax.tree.map(lambda leaf: leaf[[turns.index(point) for point in points]], outcome)
    seeds = [first_seed + i for i in range(preset.size.held_out_seeds)]
    control = jax.tree.map(lambda leaf: jnp.asarray(leaf[0]), outcome.control)
    runs = jax.tree.map(lambda leaf: leaf[0], outcome.histories)
    route = scene.held_out[paper_route(scene)]
    return ControlStudy(scene, points, outcome, envs[0], control, route, runs, seeds)

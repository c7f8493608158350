"""Robots in a world that changes: with the prior of training, with one that adapts, and with one that knows."""

from collections.abc import Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.cards.adaptation_arms import ARMS, Arms, compare, search_prices
from ovibjax.cards.control_study import PAPER_PROFILE_KB_PER_S, drives_of
from ovibjax.cards.control_study import PRESETS as SCENES
from ovibjax.cards.job import Job
from ovibjax.control.adaptation import PROBE_EVERY, Adaptation, fit_expected, make_adaptation
from ovibjax.control.changed_worlds import (
    NOISE,
    from_slot,
    front_as_good_as_all,
    no_longer_repetitive,
    noisy,
    one_after_another,
    true_prior_m,
)
from ovibjax.control.client_state import ControlParams
from ovibjax.control.controller import PAPER_BUDGET_KB, make_controller
from ovibjax.control.drives import JoinedDrives, join_drives
from ovibjax.control.environment import PAPER_SLOTS, Route, make_environment
from ovibjax.control.predictor import PRIORS, fit_calibrated_prior, fit_predictor
from ovibjax.control.protocols import seeds_to_keys
from ovibjax.control.scene import Reading, Scene, cut_scene
from ovibjax.encoder.checkpoint import train_checkpoint
from ovibjax.runtime.progress import console, progress_bar

WORLDS = ("front", "repetitive", "degraded", "failing", "unchanged")
"""What changes: the front view is as good as all; repetitive blocks are not any more; the backbone; nothing."""

ROUNDS = 2
"""The robots drive so many times along all held-out routes; the world changes after the first route."""


@dataclass(frozen=True)
class AdaptationPreset:
    """Size of the study.

    Attributes:
        seeds: held-out seeds.
        candidates: prices that are tried.
        tuning_seeds: seeds that they are tried on.
    """

    seeds: int
    candidates: int
    tuning_seeds: int


# Twenty seeds leave intervals of a seventh of the error, as a few answers in another place cost most of it.
PRESETS = {
    "smoke": AdaptationPreset(2, 16, 2),
    "quick": AdaptationPreset(3, 512, 24),
    "full": AdaptationPreset(100, 512, 24),
}


@dataclass(frozen=True)
class AdaptationStudy:
    """Everything the figure shows; arrays on the host.

    Attributes:
        scene: routes and what training taught.
        context: [T] contexts of the drive.
        slot: first slot that is changed.
        budget_kb: payload allowed on the drive.
        prices: (lambda_b, lambda_d) by prior.
        prior_m: [C, A] by prior.
        truth_m: [worlds, T, A] what the oracle expects, by prior.
        arms: results by prior.
        seeds: held-out seeds.
    """

    scene: Scene
    context: np.ndarray
    slot: int
    budget_kb: float
    prices: Mapping[str, tuple[float, float]]
    prior_m: Mapping[str, np.ndarray]
    truth_m: Mapping[str, np.ndarray]
    arms: Mapping[str, Arms]
    seeds: list[int]

    def of(self, arm: str, world: str, metric: str = "mean_m", prior: str = PRIORS[1]) -> np.ndarray:
        """[seeds] `mean_m`, `after_m` (mean error from the change on), `kb` or `requests`."""
        found, place = self.arms[prior], (ARMS.index(arm), WORLDS.index(world))
        if metric in ("kb", "requests"):
            return np.asarray(getattr(found, metric)[place], np.float64)
        first = self.slot if metric == "after_m" else 0
        return np.asarray(found.error_m[place][:, first:].mean(axis=-1), np.float64)


def adaptation_study(job: Job) -> AdaptationStudy:
    """The study of a job's preset, data and seeds.

    Args:
        job: what the card was given.

    Returns:
        The study.
    """
    preset = PRESETS[job.preset]
    with job.stage("render"), progress_bar("rendering the routes", 1) as update:
        drives, training = drives_of(job.preset, job.own_drive, update)
    with console.status("training the encoder"), job.stage("train"):
        frames = join_drives(drives, training)
        trained = train_checkpoint(jax.random.key(0), frames.first_frames, SCENES[job.preset].checkpoint)
        reading = Reading(prior=PRIORS[1])
        scene = cut_scene(frames, trained, reading)
        bad = {name: cut_scene(frames, trained, reading, noisy(frames.features, n)) for name, n in NOISE.items()}
    with console.status("searching prices, replaying changed worlds"), job.stage("replay"):
        return replay_worlds(scene, worlds_of(scene, bad), frames, preset, job.seed)


def worlds_of(scene: Scene, bad: Mapping[str, Scene]) -> tuple[list[Route], int]:
    """The drive in each of `WORLDS`, and the slot of the change."""
    drive, slot = one_after_another(scene.held_out, ROUNDS), len(scene.held_out[0].context)
    changed = {
        "front": front_as_good_as_all(drive, scene.actions),
        "repetitive": no_longer_repetitive(drive, scene.contexts),
        "unchanged": drive,
    } | {name: one_after_another(one.held_out, ROUNDS) for name, one in bad.items()}
    return [from_slot(drive, changed[name], slot) for name in WORLDS], slot


def replay_worlds(
    scene: Scene, worlds: tuple[list[Route], int], frames: JoinedDrives, preset: AdaptationPreset, first_seed: int
) -> AdaptationStudy:
    """Search prices on training routes and tuning seeds, and replay every world with every arm.

    Args:
        scene: routes and what training taught.
        worlds: see `worlds_of`.
        frames: the frames that the priors are fitted on.
        preset: size.
        first_seed: first held-out seed.

    Returns:
        The study.
    """
    routes, slot = worlds
    env = make_environment(scene.context_share, PAPER_PROFILE_KB_PER_S)
    seeds = [first_seed + i for i in range(preset.seeds)]
    budget_kb = PAPER_BUDGET_KB * len(routes[0].context) / PAPER_SLOTS
    training = one_after_another(scene.training)
    numbers = [adaptation_of(training, frames, adapt, every) for adapt, every in _ADAPTED]
    prices, priors, truths, arms = {}, {}, {}, {}
    for name in PRIORS:
        prior_m = fitted(training, frames, name)
        chosen = search_prices(expecting(training, prior_m), env, preset.candidates, preset.tuning_seeds, scene.actions)
        prices[name] = (float(chosen.prices.bandwidth_m_per_s), float(chosen.prices.delay_m_per_s))
        priors[name] = prior_m
        truths[name] = np.stack([_truth_m(routes[-1], route, frames, name, slot) for route in routes])
        params = ControlParams(env, make_controller(scene.actions, *prices[name], budget_kb=budget_kb))
        drives = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(expecting(route, prior_m) for route in routes))
        found = compare(seeds_to_keys(seeds), drives, jnp.asarray(truths[name]), params, numbers, scene.actions)
        arms[name] = jax.device_get(found)
    return AdaptationStudy(scene, np.asarray(routes[0].context), slot, budget_kb, prices, priors, truths, arms, seeds)


_ADAPTED = (("reported", PROBE_EVERY), ("innovation", PROBE_EVERY), ("reported", 0))


def expecting(route: Route, prior_m: np.ndarray) -> Route:
    """A route whose robots expect a prior [C, A]."""
    return route._replace(predicted_m=prior_m[route.context].astype(np.float32))


def fitted(route: Route, frames: JoinedDrives, prior: str, slots: slice = slice(None)) -> np.ndarray:
    """[C, A] one of `PRIORS` as fitted on slots of a route."""
    context, count = np.asarray(route.context)[slots], len(frames.contexts)
    if prior == "median":
        return fit_predictor(np.linalg.norm(route.residual_m, axis=-1)[slots], context, count)
    return fit_calibrated_prior(np.asarray(route.risk_m)[slots], context, count)


def adaptation_of(training: Route, frames: JoinedDrives, adapt: str, every: int) -> Adaptation:
    """The numbers of an adapting robot that knows the training routes."""
    length_m = np.linalg.norm(training.residual_m, axis=-1)
    expected = fit_expected(length_m, np.asarray(training.risk_m), training.context, len(frames.contexts), adapt)
    return make_adaptation(adapt, expected, every)


def _truth_m(before: Route, route: Route, frames: JoinedDrives, prior: str, slot: int) -> np.ndarray:
    both = np.stack([fitted(before, frames, prior), fitted(route, frames, prior, slice(slot, None))])
    return true_prior_m(both, route.context, slot).astype(np.float32)

"""g_psi corrected while driving, from what a robot can see; ours, the paper's predictor is fitted once.

Each answer is compared with what training routes led to expect of its context and action: the risk that the edge
reports with it, or the innovation, how far the position lies from the estimate. Both are known without ground truth.
The ratio to the expectation is 1 on routes like those of training, whatever statistic g_psi is, and g_psi is multiplied
by its discounted mean

    (w lambda^n + sum_i lambda^(n - i) ratio_i) / (w lambda^n + sum_i lambda^(n - i)),

n answers of that context and action so far, w the weight of the prior in answers. Its age counts in answers, so that
what is rarely tried is not forgotten sooner.

A robot would never learn of an action that it never takes. So one request in so many goes out with the cheaper action
that its context has tried least recently. While its answers are on average as good as what the usual action promises,
the context keeps that action: on trial, until the corrected g_psi speaks for it, or until they are not. On routes like
those of training this costs the probes, one request in so many, and nothing where they succeed.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.control.actions import ActionSet
from ovibjax.control.client_state import ControlParams
from ovibjax.control.policies import Decision, Observation, chosen, worthwhile_m
from ovibjax.control.predictor import fit_calibrated_prior
from ovibjax.errors import InputError

ADAPT = ("none", "innovation", "reported")
"""What g_psi is corrected from: nothing as in the paper, innovations, or the risks that the edge reports."""

ADAPTS = ("voi", "voi_gap")
"""Policies that look at g_psi."""

WEIGHTS = {"innovation": (10.0, 0.9), "reported": (3.0, 0.8)}
"""Weight of the prior, in answers, and what is kept of it and of every answer with the next one."""

PROBE_EVERY = 12
"""One request in so many is a probe. These five numbers were chosen on tuning seeds: twice around the training routes
and around the held-out ones, seeds 0 to 99, in the worlds of `changed_worlds`; see `../sweeps/adaptation.py`."""

_LEAST = 0.05  # of the prior, where innovations are smaller than the local risk explains
_NEVER = -1


class Adaptation(NamedTuple):
    """Numbers of the adaptation; leaves.

    Attributes:
        expected_m: [C, A] what training routes led to expect of what is observed, see `fit_expected`, m.
        prior_weight: answers that the prior counts as.
        keep: factor on the weight of earlier answers, and of the prior, with every answer.
        probe_every: int32, one request in so many is a probe; 0 for none.
    """

    expected_m: Any
    prior_weight: Any
    keep: Any
    probe_every: Any


def make_adaptation(adapt: str, expected_m: Any, probe_every: int = PROBE_EVERY) -> Adaptation:
    """The adaptation with the numbers chosen for it.

    Args:
        adapt: one of `ADAPT`, not "none".
        expected_m: [C, A] see `fit_expected`.
        probe_every: one request in so many is a probe; 0 for none.

    Returns:
        Leaves.

    Raises:
        InputError: an unknown way to adapt.
    """
    if adapt not in WEIGHTS:
        raise InputError(f"adapt {adapt!r} is unknown; it must be one of {', '.join(ADAPT)}")
    weight, keep = WEIGHTS[adapt]
    return Adaptation(
        jnp.asarray(expected_m, jnp.float32), jnp.float32(weight), jnp.float32(keep), jnp.int32(probe_every)
    )


def fit_expected(
    residual_m: np.ndarray, risk_m: np.ndarray, context: np.ndarray, n_contexts: int, adapt: str
) -> np.ndarray:
    """What a robot will observe where routes are like those of training.

    Args:
        residual_m: [N, A] realised residuals of training frames, m.
        risk_m: [N, A] calibrated risks of them, m.
        context: [N] context of each.
        n_contexts: number of contexts.
        adapt: "reported": their mean reported risk; "innovation": the root of their mean squared residual, which is
            what an innovation's square exceeds the squared local risk by.

    Returns:
        [n_contexts, A] metres.
    """
    if adapt == "reported":
        return fit_calibrated_prior(risk_m, context, n_contexts)
    return np.sqrt(fit_calibrated_prior(residual_m**2, context, n_contexts))


class Learned(NamedTuple):
    """What a robot has learned of g_psi; by context and action.

    Attributes:
        total: [C, A] discounted sum of ratios, the prior's 1 among them.
        weight: [C, A] sum of their weights.
        last: [C, A] int32 slot of the last request, -1 before the first.
        trial: [C] int32 action that a probe found good, -1 for none.
        trial_m: [C] sum of the risks of its answers.
        trial_count: [C] int32 how many they are.
        asked: int32 requests so far.
    """

    total: jax.Array
    weight: jax.Array
    last: jax.Array
    trial: jax.Array
    trial_m: jax.Array
    trial_count: jax.Array
    asked: jax.Array


class Asked(NamedTuple):
    """What a robot must remember of a request until its answer comes.

    Attributes:
        context: int32 where it was sent.
        action: int32 with what.
        risk_m: local risk then.
        goal_m: mean reported risk up to which answers are as good as what the usual action promises.
        probe: bool, whether it was a probe or with an action on trial.
    """

    context: jax.Array
    action: jax.Array
    risk_m: jax.Array
    goal_m: jax.Array
    probe: jax.Array


class Heard(NamedTuple):
    """What a robot sees of an answer.

    Attributes:
        risk_m: the risk that the edge reports.
        innovation_m2: squared distance between its position and the estimate that the robot asked with, m^2.
    """

    risk_m: jax.Array
    innovation_m2: jax.Array


def nothing_learned(adaptation: Adaptation) -> Learned:
    """What a robot knows before its first answer: the prior."""
    shape = jnp.shape(adaptation.expected_m)
    prior = jnp.broadcast_to(jnp.asarray(adaptation.prior_weight, jnp.float32), shape)
    never = jnp.full(shape, _NEVER, jnp.int32)
    none = jnp.zeros(shape[0], jnp.int32)
    return Learned(prior, prior, never, none + _NEVER, none.astype(jnp.float32), none, jnp.int32(0))


def nothing_asked() -> tuple[Asked, Heard]:
    """What is remembered before the first request."""
    none, zero = jnp.int32(0), jnp.float32(0.0)
    return Asked(none, none, zero, zero, jnp.bool_(False)), Heard(zero, zero)


def factors(learned: Learned, adapt: str) -> jax.Array:
    """[C, A] what g_psi is multiplied by; `adapt` is static."""
    ratio = learned.total / learned.weight
    return jnp.sqrt(jnp.maximum(ratio, _LEAST**2)) if adapt == "innovation" else ratio


def choose(
    learned: Learned,
    place: tuple[jax.Array, jax.Array],
    seen: Observation,
    decision: Decision,
    params: ControlParams,
    actions: ActionSet,
) -> tuple[Decision, Asked, Learned]:
    """Send a probe, or the action on trial, in place of what the policy decided on.

    Args:
        learned: what the robot knows.
        place: context, and number of the slot.
        seen: what it sees, `predicted_m` as adapted.
        decision: what the policy decided on; whether it asks at all stays as it is.
        params: environment, controller, adaptation.
        actions: the action set (static).

    Returns:
        What the robot does, what it must remember of it, and what it knows then.
    """
    (context, number), (send, usual) = place, decision
    sizes = [jnp.float32(b) for b in actions.payload_bytes]
    usual_bytes = chosen(sizes, usual)
    cheaper = [fits & (size < usual_bytes) for fits, size in zip(seen.allowed, sizes, strict=True)]
    last, trial = learned.last[context], learned.trial[context]
    candidate, oldest = jnp.int32(_NEVER), number
    prefixes = len(actions.prefixes)
    for a in sorted(range(len(actions)), key=lambda a: (a % prefixes, a)):  # small requests first
        better = cheaper[a] & (last[a] < oldest)
        candidate, oldest = jnp.where(better, jnp.int32(a), candidate), jnp.where(better, last[a], oldest)
    every = params.adaptation.probe_every
    due = (every > 0) & ((learned.asked + 1) % jnp.maximum(every, 1) == 0)
    on_trial = (every > 0) & (trial >= 0) & chosen(cheaper, jnp.maximum(trial, 0))
    other = jnp.where(on_trial, trial, jnp.where(due, candidate, _NEVER))
    action = jnp.where(other >= 0, other, usual)
    worth = worthwhile_m(seen, seen.predicted_m, params.control, actions)
    cost_m = chosen(worth, action) - chosen(seen.predicted_m, action)
    asked = Asked(context, action, seen.risk_m, chosen(worth, usual) - cost_m, other >= 0)
    here = _at(learned, context, action) & send
    last = jnp.where(here, number, learned.last)
    return Decision(send, action), asked, learned._replace(last=last, asked=learned.asked + send.astype(jnp.int32))


def learn(
    learned: Learned, asked: Asked, heard: Heard, arrived: jax.Array, adaptation: Adaptation, adapt: str
) -> Learned:
    """Learn from an answer, if it has arrived.

    Args:
        learned: what the robot knew.
        asked: the request.
        heard: its answer.
        arrived: bool.
        adaptation: numbers.
        adapt: one of `ADAPT`, not "none" (static).

    Returns:
        What it knows then.
    """
    expected_m = adaptation.expected_m[asked.context, asked.action]
    if adapt == "innovation":  # E |innovation|^2 = L^2 + g^2; not clipped here, which would bias the mean
        ratio = (heard.innovation_m2 - asked.risk_m**2) / jnp.maximum(expected_m, 1e-3) ** 2
    else:
        ratio = heard.risk_m / jnp.maximum(expected_m, 1e-3)
    here = _at(learned, asked.context, asked.action) & arrived
    tried = (jnp.arange(learned.trial.shape[0]) == asked.context) & asked.probe & arrived
    goes_on = learned.trial == asked.action
    trial_m = jnp.where(goes_on, learned.trial_m, 0.0) + heard.risk_m
    trial_count = jnp.where(goes_on, learned.trial_count, 0) + 1
    stays = trial_m <= asked.goal_m * trial_count.astype(jnp.float32)
    return learned._replace(
        total=jnp.where(here, adaptation.keep * learned.total + ratio, learned.total),
        weight=jnp.where(here, adaptation.keep * learned.weight + 1.0, learned.weight),
        trial=jnp.where(tried, jnp.where(stays, asked.action, _NEVER), learned.trial),
        trial_m=jnp.where(tried, trial_m, learned.trial_m),
        trial_count=jnp.where(tried, trial_count, learned.trial_count),
    )


def _at(learned: Learned, context: jax.Array, action: jax.Array) -> jax.Array:
    """[C, A] whether it is this context and action."""
    contexts, actions = learned.last.shape
    return (jnp.arange(contexts)[:, None] == context) & (jnp.arange(actions)[None] == action)

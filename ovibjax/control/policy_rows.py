"""Several request policies in one compiled replay: which of them a row follows is a number, not a program.

A program per policy compiles for a second or two each, whatever it replays. Side by side they share everything but the
decision; each row computes every policy's and keeps its own, which costs little where replays are few.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.control.actions import ActionSet
from ovibjax.control.client_state import ControlParams
from ovibjax.control.controller import Controller
from ovibjax.control.environment import Draws, Environment, Route
from ovibjax.control.planning import plan
from ovibjax.control.policies import POLICIES, Decision, Observation, Policy, as_written, chosen
from ovibjax.control.route_replay import RouteResult, replay_schedule

APART = ("voi_gap", "random", "fixed_front", "uncertainty", "oracle_action")
"""Policies that decide differently; the others are these with other numbers or other slots planned ahead."""

FIRST, SECOND = (
    ("voi", "voi_gap", "voi_uncapped", "uncertainty", "tuned_uncertainty"),
    ("periodic", "budgeted_periodic", "random", "fixed_front", "oracle_action"),
)
"""Rows that are replayed first, and those that may follow VOI-Control's requests."""


class Rules(NamedTuple):
    """Numbers that the policies of a comparison go by.

    Attributes:
        control: VOI-Control's configuration and the paper's rules.
        gap: configuration of its variant with a threshold and a gap.
        tuned: the configuration with searched numbers of the uncertainty rule.
    """

    control: Controller
    gap: Controller
    tuned: Controller


def number_of(policy: str) -> int:
    """Which of `APART` decides for a policy."""
    if policy in ("periodic", "budgeted_periodic"):
        return APART.index("random")
    return APART.index("voi_gap" if policy.startswith("voi") else policy.removeprefix("tuned_"))


def policy_of(number: jax.Array) -> Policy:
    """The policy of a row.

    Args:
        number: int32 index into `APART`; may be mapped. Under the oracle action the payload budget must be infinite, as
            it does not bind there.

    Returns:
        A policy; what VOI-Control does is `voi_gap` with the numbers of `policies.as_written`.
    """

    def decide(seen: Observation, control: Controller, actions: ActionSet) -> Decision:
        made = [POLICIES[name](seen, control, actions) for name in APART]
        sends, named = ([getattr(one, field) for one in made] for field in Decision._fields)
        return Decision(chosen(sends, number), chosen(named, number))

    return decide


def replay_rows(
    draws: Draws, route: Route, env: Environment, rules: Rules, actions: ActionSet
) -> dict[str, RouteResult]:
    """Replay every policy on one realization, in one scan that runs twice.

    Args:
        draws: the realization.
        route: the route.
        env: the environment.
        rules: numbers of the policies.
        actions: the action set (static).

    Returns:
        Histories [T] by policy, of `tuned_uncertainty`, and of `voi_uncapped`, which has no payload budget.
    """
    numbers = jnp.array([[number_of(name) for name in names] for names in (FIRST, SECOND)], jnp.int32)
    controls = [[_control_of(name, rules) for name in names] for names in (FIRST, SECOND)]
    rows = [jax.tree.map(lambda *leaves: jnp.stack(leaves), *row) for row in controls]
    both = jax.tree.map(lambda *leaves: jnp.stack(leaves), *rows)

    def turn(voi_sent: jax.Array, row: tuple[jax.Array, Controller]) -> tuple[jax.Array, RouteResult]:
        planned = jnp.stack([plan(draws, name, ControlParams(env, rules.control), voi_sent) for name in SECOND])

        def one(number: jax.Array, control: Controller, planned: jax.Array) -> RouteResult:
            return replay_schedule(draws, route, policy_of(number), planned, ControlParams(env, control), actions)

        histories = jax.vmap(one)(*row, planned)
        return histories.sent[FIRST.index("voi")], histories

    histories = jax.lax.scan(turn, jnp.zeros(draws.rate_bps.shape, bool), (numbers, both))[1]
    places = {name: (i, j) for i, names in enumerate((FIRST, SECOND)) for j, name in enumerate(names)}
    return {name: jax.tree.map(lambda leaf, at=at: leaf[at], histories) for name, at in places.items()}


def _control_of(policy: str, rules: Rules) -> Controller:
    """The numbers that a policy of `FIRST` or `SECOND` goes by."""
    without_cap = rules.control._replace(budget_bytes=jnp.full_like(rules.control.budget_bytes, jnp.inf))
    own = {
        "voi": as_written(rules.control),
        "voi_gap": rules.gap,
        "voi_uncapped": as_written(without_cap),
        "tuned_uncertainty": rules.tuned,
        "oracle_action": without_cap,
    }
    return own.get(policy, rules.control)

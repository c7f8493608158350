"""Route replay of a robot that corrects g_psi while it drives: `client_step`, with `adaptation` between its parts."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.control.actions import ActionSet
from ovibjax.control.adaptation import (
    ADAPTS,
    WEIGHTS,
    Asked,
    Heard,
    Learned,
    choose,
    factors,
    learn,
    nothing_asked,
    nothing_learned,
)
from ovibjax.control.client_state import ControlParams, Slot, SlotInfo, State, by_action, start
from ovibjax.control.client_step import decide, observe, respond
from ovibjax.control.environment import Draws
from ovibjax.control.policies import Policy, chosen
from ovibjax.errors import InputError


class Adaptive(NamedTuple):
    """One adapting client between slots.

    Attributes:
        state: the client.
        learned: what it has learned of g_psi.
        asked: its last request.
        heard: the answer to that.
        coming: bool, whether that answer is still under way and will arrive.
    """

    state: State
    learned: Learned
    asked: Asked
    heard: Heard
    coming: jax.Array


def scan_adapted(
    draws: Draws,
    slots: Slot,
    context: jax.Array,
    policy: str | Policy,
    params: ControlParams,
    actions: ActionSet,
    adapt: str,
) -> tuple[SlotInfo, jax.Array]:
    """Replay a policy that looks at g_psi, and corrects it.

    Args:
        draws: the realization of the world.
        slots: [T] slots, with the prior as `predicted_m`.
        context: [T] route contexts.
        policy: one of `adaptation.ADAPTS` (static).
        params: environment, controller, adaptation.
        actions: the action set (static).
        adapt: one of `adaptation.ADAPT`, not "none" (static).

    Returns:
        [T] of everything that happened, and [T, C, A] what the prior was multiplied by in each slot.

    Raises:
        InputError: a policy that does not look at g_psi, an unknown way to adapt, or no numbers for it.
    """
    if policy not in ADAPTS:
        raise InputError(f"policy {policy!r} does not look at what adapts; {' and '.join(ADAPTS)} do")
    if adapt not in WEIGHTS or params.adaptation is None:
        raise InputError(f"adapt {adapt!r} is unknown, or ControlParams has no adaptation; see make_adaptation")
    params = by_action(params)

    def one(client: Adaptive, inputs: tuple[Slot, jax.Array]) -> tuple[Adaptive, tuple[SlotInfo, jax.Array]]:
        return step(client, *inputs, policy, params, actions, adapt)

    begin = Adaptive(start(draws), nothing_learned(params.adaptation), *nothing_asked(), jnp.bool_(False))
    return jax.lax.scan(one, begin, (slots, jnp.asarray(context)))[1]


def step(
    client: Adaptive,
    slot: Slot,
    context: jax.Array,
    policy: str | Policy,
    params: ControlParams,
    actions: ActionSet,
    adapt: str,
) -> tuple[Adaptive, tuple[SlotInfo, jax.Array]]:
    """One slot of one adapting client; `policy`, `actions` and `adapt` are static."""
    state, learned, asked, heard, coming = client
    lands = coming & (state.flight == 1)
    learned = learn(learned, asked, heard, lands, params.adaptation, adapt)
    factor = factors(learned, adapt)
    slot = slot._replace(predicted_m=slot.predicted_m * factor[context])
    state, seen = observe(state, slot, params, actions, budgeted=True)
    decision = decide(seen, slot, policy, params, actions)
    decision, fresh, learned = choose(learned, (context, slot.number), seen, decision, params, actions)
    after, info = respond(state, slot, seen, decision, params, actions)
    answer = _heard(state, slot, decision.action)
    arrives = decision.send & (info.latency_s <= params.env.timeout_s)
    now = arrives & (after.flight == 0)
    learned = learn(learned, fresh, answer, now, params.adaptation, adapt)
    asked, heard = jax.tree.map(lambda a, b: jnp.where(decision.send, a, b), (fresh, answer), (asked, heard))
    coming = jnp.where(decision.send, arrives & ~now, coming & ~lands)
    return Adaptive(after, learned, asked, heard, coming), (info, factor)


def _heard(state: State, slot: Slot, action: jax.Array) -> Heard:
    """What the answer to a request will tell; the truth drops out of the innovation."""
    x_m, y_m = (chosen(slot.residual_m[:, axis], action) for axis in (0, 1))
    innovation_m2 = (x_m - state.belief.error_x_m) ** 2 + (y_m - state.belief.error_y_m) ** 2
    return Heard(chosen(slot.risk_m, action), innovation_m2)

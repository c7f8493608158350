"""What a client carries from slot to slot, what a slot brings it, and what is recorded of it.

A correction under way is a second belief, `pending`, that drifts with the first: the estimate as it will be.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.control.belief import Belief
from ovibjax.control.controller import Controller
from ovibjax.control.drift import Odometry
from ovibjax.control.environment import Draws, Environment


class ControlParams(NamedTuple):
    """Everything a replay depends on beside route and key; leaves.

    Attributes:
        env: drift, link, queue.
        control: prices, budget, rules.
        adaptation: an `adaptation.Adaptation`, where g_psi is corrected while driving.
    """

    env: Environment
    control: Controller
    adaptation: Any = None


class State(NamedTuple):
    """One client between slots.

    Attributes:
        belief: what it navigates with.
        pending: the belief as a correction under way will make it.
        flight: int32 slots until that correction arrives; 0 for none.
        since: int32 slots since the last request.
        sent_bytes: payload sent so far.
        used_j: energy used so far.
    """

    belief: Belief
    pending: Belief
    flight: jax.Array
    since: jax.Array
    sent_bytes: jax.Array
    used_j: jax.Array


class Slot(NamedTuple):
    """What the world brings in one slot; `number` counts from zero, the other fields are as in `Route` and `Draws`."""

    number: jax.Array
    predicted_m: jax.Array
    residual_m: jax.Array
    risk_m: jax.Array
    odometry: Odometry
    rate_bps: jax.Array
    delay_s: jax.Array
    latency_s: jax.Array
    scheduled: jax.Array


class SlotInfo(NamedTuple):
    """What happened in one slot, or [T] of them: the result of a replay.

    Attributes:
        error_m: distance between estimate and truth, after a correction that came in time.
        risk_before_m: local risk when the client decided.
        risk_m: local risk after it.
        sent: whether a request was sent.
        action: int32, with which action; meaningful where sent.
        payload_bytes: its size; 0 where none was sent.
        voi_m: predicted net VOI of the action; meaningful where sent.
        delay_s: its predicted queueing, service and return delay.
        latency_s: time from decision to correction.
        residual_m: realised residual of the action.
        rate_bps: uplink rate.
    """

    error_m: jax.Array
    risk_before_m: jax.Array
    risk_m: jax.Array
    sent: jax.Array
    action: jax.Array
    payload_bytes: jax.Array
    voi_m: jax.Array
    delay_s: jax.Array
    latency_s: jax.Array
    residual_m: jax.Array
    rate_bps: jax.Array


def by_action(params: ControlParams) -> ControlParams:
    """The same numbers with one array per action: sliced before the loop, mapped candidates stay contiguous in it."""
    control = params.control
    return params._replace(control=control._replace(energy_j=(*control.energy_j,), available=(*control.available,)))


def start(draws: Draws) -> State:
    """A client before the first slot."""
    zero = jnp.zeros_like(draws.rate_bps[0])
    never = jnp.int32(1 << 20)
    return State(draws.start, draws.start, jnp.int32(0), never, zero, zero)

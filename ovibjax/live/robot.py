"""One robot between sockets and belief: the pure step functions of the replay, and an answer that comes when it comes.

A slot brings drift and a decision, as in `control.client_step`. What differs from a replay is the answer: it arrives at
a time that nobody knows before, is a position instead of a residual, and may never come. It corrects the belief as it
was when the robot asked, and what odometry has brought since then is added again.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from ovibjax.control import belief
from ovibjax.control.actions import ActionSet
from ovibjax.control.adaptation import (
    Asked,
    Heard,
    Learned,
    choose,
    factors,
    learn,
    nothing_asked,
    nothing_learned,
)
from ovibjax.control.belief import Belief, Fix
from ovibjax.control.client_state import ControlParams, Slot, State, by_action, start
from ovibjax.control.client_step import decide, observe, request_with
from ovibjax.control.drift import Odometry
from ovibjax.control.environment import Route, draw
from ovibjax.control.planning import FOLLOW_VOI, plan
from ovibjax.control.policies import POLICIES, Decision
from ovibjax.control.residuals import encode_views
from ovibjax.control.route_replay import slots_of
from ovibjax.encoder.model import Architecture, Params
from ovibjax.live.edge_file import EdgeFile
from ovibjax.views import mode_mask

LIVE_POLICIES = tuple(name for name in POLICIES if name not in FOLLOW_VOI)
"""Request policies that a robot can follow; the others must know beforehand what VOI-Control does."""

_UNDER_WAY = 1 << 20  # slots until an answer whose time nobody knows
_CATCH_UP = 8  # slots of odometry added in one go


class Decided(NamedTuple):
    """What a robot does in a slot; numbers of the host.

    Attributes:
        send: whether it asks.
        action: with which action.
        voi_m: predicted net VOI of it.
        risk_m: local risk when it decided.
        delay_s: predicted delay.
        predicted_m: predicted residual.
        error_m: distance of estimate and truth at the end of the slot before.
    """

    send: bool
    action: int
    voi_m: float
    risk_m: float
    delay_s: float
    predicted_m: float
    error_m: float


class Memory(NamedTuple):
    """What a robot that adapts carries beside its state.

    Attributes:
        learned: what it has learned of g_psi.
        asked: its last request.
    """

    learned: Learned
    asked: Asked


@dataclass(frozen=True)
class World:
    """What the robots of a process share; the arrays are on the device.

    Attributes:
        file: the edge file.
        params: environment and controller.
        policy: one of `LIVE_POLICIES`.
        slots: slots that each robot drives.
        adapt: what corrects g_psi while they drive, one of `control.adaptation.ADAPT`.
    """

    file: EdgeFile
    params: ControlParams
    policy: str
    slots: int
    adapt: str = "none"


class Robot:
    """One robot: its route, its draws of the world, its belief.

    Attributes:
        number: its number, which its draws and its route depend on.
        file: the edge file.
        rows: [T] frame of the edge file in each slot.
        route: [T, ...] its route.
        draws: its realization of the world; `rate_bps` may be replaced before the first slot.
    """

    def __init__(self, world: World, number: int, key: jax.Array) -> None:
        self.number, self.file, self._world = number, world.file, world
        mine, first_key = jax.random.split(jax.random.fold_in(key, number))
        file = world.file
        routes = int(file.route_number[-1]) + 1
        frames = np.flatnonzero(file.route_number == number % routes)
        first = int(jax.random.randint(first_key, (), 0, len(frames)))
        self.rows = frames[(first + np.arange(world.slots)) % len(frames)]
        context = file.route_context[self.rows]
        self.route = Route(
            jnp.asarray(context),
            jnp.asarray(file.route_yaw_rad[self.rows]),
            jnp.asarray(file.predicted_m[context]),
            jnp.asarray(file.route_residual_m[self.rows]),
            jnp.asarray(file.route_risk_m[self.rows]),
        )
        self.draws = _draw(mine, self.route, world.params, file.actions)
        self._params = by_action(world.params)
        self._network = jax.tree.map(jnp.asarray, file.params)
        self._x = jnp.asarray(file.route_x[self.rows].reshape(world.slots, 1, -1))
        self._masks = [mode_mask(mode, file.arch.n_views) for mode in file.actions.modes for _ in file.actions.prefixes]
        self._state: State = start(self.draws)
        self._slots: Slot | None = None
        self._asked: tuple[int, Belief] | None = None
        adapts = world.adapt != "none"
        self._memory = Memory(nothing_learned(self._params.adaptation), nothing_asked()[0]) if adapts else None
        self._context = jnp.asarray(context) if adapts else None

    @property
    def drift_m_per_s(self) -> npt.NDArray[np.float32]:
        """[T] fitted drift rate in each slot."""
        return np.asarray(self._world.params.env.drift.rate_m_per_s)[self.file.route_context[self.rows]]

    @property
    def return_s(self) -> float:
        """Time that an answer takes to come back, as the robot predicts it."""
        return float(self._world.params.env.return_ms) / 1000.0

    @property
    def waiting(self) -> bool:
        """Whether an answer is under way."""
        return self._asked is not None

    def tick(self, slot: int, connected: bool, delay_s: npt.NDArray[np.float32]) -> Decided:
        """One slot: drift, and a decision; if it is to ask, an answer is under way from now on.

        Args:
            slot: its number, each once and in order.
            connected: whether the robot can ask.
            delay_s: [A] queueing, service and return that it predicts.

        Returns:
            What it does.
        """
        if self._slots is None:
            never = jnp.zeros(self._world.slots, bool)
            self._slots = slots_of(self.route, self.draws, plan(self.draws, self._world.policy, self._params, never))
        now = np.int32(slot), np.bool_(connected), delay_s
        drive, chosen = (self._slots, self._context), (self._world.policy, self._world.file.actions, self._world.adapt)
        self._state, self._memory, told = _tick((self._state, self._memory), drive, *now, self._params, *chosen)
        send, action, *numbers = np.asarray(told).tolist()
        decided = Decided(bool(send), int(action), *numbers)
        if decided.send:
            self._asked = slot, self._state.belief
        return decided

    def warm_up(self) -> None:
        """Compile everything, on a robot that is not driven afterwards."""
        self.tick(0, True, np.zeros(len(self.file.actions), np.float32))
        for action in range(len(self.file.actions)):
            self.encoded(0, action)
        self._asked = 0, self._state.belief
        self.corrected(0, (0.0, 0.0), 1.0, 1)

    def encoded(self, slot: int, action: int) -> np.ndarray:
        """[k] what is sent of the code of this slot's frame."""
        file = self._world.file
        code = _encode(self._network, self._x, np.int32(slot), self._masks[action], file.arch)
        return np.asarray(code)[0, : int(file.actions.prefix[action])]

    def residual_m(self, slot: int, position_m: tuple[float, float, float]) -> tuple[float, float]:
        """How far off a position is from where the robot was in a slot, x and y; only its world knows."""
        truth = self._world.file.origin_m + self._world.file.route_m[self.rows[slot]]
        return float(position_m[0] - truth[0]), float(position_m[1] - truth[1])

    def corrected(self, slot: int, residual_m: tuple[float, float], risk_m: float, now: int) -> None:
        """Use an answer, unless the robot has asked again or given up since.

        Args:
            slot: the slot it was asked in.
            residual_m: how far off it is.
            risk_m: how far off it claims to be.
            now: the current slot.
        """
        if self._slots is None or self._asked is None or self._asked[0] != slot:
            return
        fix = np.float32(residual_m[0]), np.float32(residual_m[1]), np.float32(risk_m)
        found = _correct(self._asked[1], self._slots, np.int32(slot), *fix, self._params)
        if self._memory is not None:
            self._memory = _learn(self._memory, self._asked[1], *fix, self._params, self._world.adapt)
        for first in range(slot + 1, now + 1, _CATCH_UP):
            found = _again(found, self._slots, np.int32(first), np.int32(now), self._params)
        self._state = self._state._replace(belief=found)
        self.given_up(slot)

    def given_up(self, slot: int) -> None:
        """No answer will come to what was asked in a slot, unless the robot has asked again since."""
        if self._asked is not None and self._asked[0] == slot:
            self._asked = None
            self._state = self._state._replace(flight=jnp.int32(0))

    def error_m(self) -> float:
        """Distance of estimate and truth."""
        return float(belief.error_m(self._state.belief))


_draw = jax.jit(lambda key, route, params, actions: draw(key, route, params.env, actions), static_argnums=3)


# What a slot brings comes as separate arguments: putting it together on the host would cost as much as the step.
@partial(jax.jit, static_argnames=("policy", "actions", "adapt"))
def _tick(
    robot: tuple[State, Memory | None],
    drive: tuple[Slot, jax.Array | None],
    number: jax.Array,
    connected: jax.Array,
    delay_s: jax.Array,
    params: ControlParams,
    policy: str,
    actions: ActionSet,
    adapt: str,
) -> tuple[State, Memory | None, jax.Array]:
    """One slot of one robot, and the fields of `Decided` as one array; `drive` are slots, and contexts if it adapts."""
    (state, memory), (slots, contexts) = robot, drive
    error_m = belief.error_m(state.belief)
    slot = _slot(slots, number)
    slot = slot._replace(delay_s=delay_s, rate_bps=jnp.where(connected, slot.rate_bps, 0.0))
    if memory is not None and contexts is not None:
        context = contexts[number]
        slot = slot._replace(predicted_m=slot.predicted_m * factors(memory.learned, adapt)[context])
    state, seen = observe(state, slot, params, actions, budgeted=True)
    decision = decide(seen, slot, policy, params, actions)
    send = decision.send & connected
    if memory is not None and contexts is not None:
        wanted = Decision(send, decision.action)
        decision, asked, learned = choose(memory.learned, (context, slot.number), seen, wanted, params, actions)
        memory = Memory(learned, jax.tree.map(lambda new, old: jnp.where(send, new, old), asked, memory.asked))
    request = request_with(decision.action, seen.risk_m, slot, seen, params, actions)
    after = state._replace(
        pending=state.belief,
        flight=jnp.where(send, _UNDER_WAY, state.flight),
        since=jnp.where(send, 0, state.since),
        sent_bytes=state.sent_bytes + jnp.where(send, request.payload_bytes, 0.0),
        used_j=state.used_j + jnp.where(send, request.energy_j, 0.0),
    )
    numbers = (
        send,
        decision.action,
        request.voi_m,
        seen.risk_m,
        request.delay_s,
        slot.predicted_m[decision.action],
        error_m,
    )
    return after, memory, jnp.stack([jnp.asarray(number).astype(jnp.float32) for number in numbers])


def _slot(slots: Slot, number: jax.Array) -> Slot:
    slot: Slot = jax.tree.map(lambda leaf: leaf[number], slots)
    return slot


@jax.jit
def _correct(
    before: Belief,
    slots: Slot,
    number: jax.Array,
    x_m: jax.Array,
    y_m: jax.Array,
    risk_m: jax.Array,
    params: ControlParams,
) -> Belief:
    """The belief of the slot that the robot asked in, with the answer."""
    slot = _slot(slots, number)
    fix = Fix(x_m, y_m, risk_m, slot.odometry.toward_x, slot.odometry.toward_y)
    return belief.correct(before, fix, params.control.correction, params.control.gate_sigma)


@partial(jax.jit, static_argnames="adapt")
def _learn(
    memory: Memory,
    before: Belief,
    x_m: jax.Array,
    y_m: jax.Array,
    risk_m: jax.Array,
    params: ControlParams,
    adapt: str,
) -> Memory:
    """What a robot knows when an answer has come to what it asked with a belief."""
    heard = Heard(risk_m, (x_m - before.error_x_m) ** 2 + (y_m - before.error_y_m) ** 2)
    learned = learn(memory.learned, memory.asked, heard, jnp.bool_(True), params.adaptation, adapt)
    return memory._replace(learned=learned)


@jax.jit
def _again(before: Belief, slots: Slot, first: jax.Array, last: jax.Array, params: ControlParams) -> Belief:
    """A belief after the odometry of some slots, `first` ... `last`, but no more than a few."""

    def step(found: Belief, offset: jax.Array) -> tuple[Belief, None]:
        number = first + offset
        odometry: Odometry = jax.tree.map(lambda leaf: leaf[jnp.minimum(number, last)], slots.odometry)
        after = belief.propagate(found, odometry, params.env.drift)
        return belief.select(number <= last, after, found), None

    return jax.lax.scan(step, before, jnp.arange(_CATCH_UP, dtype=jnp.int32))[0]


@partial(jax.jit, static_argnames="arch")
def _encode(params: Params, x: jax.Array, slot: jax.Array, view_mask: jax.Array, arch: Architecture) -> Any:
    return encode_views(params, x[slot], view_mask, arch)

"""The world around a client in one replay: its route, and one seed's drift, channel and queue along it.

A seed fixes one realization of channel, drift, request timing and queue state (paper, "Experimental Setup"); it does
not depend on what the controller does, so policies that share a seed are paired.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.control import belief
from ovibjax.control.actions import ActionSet
from ovibjax.control.belief import Belief
from ovibjax.control.drift import Drift, Odometry, draw_odometry, make_drift
from ovibjax.edge.service import EDGE, ServiceProfile, draw_ms, estimate_ms
from ovibjax.link.channel import fading_power
from ovibjax.link.latency import JETSON, compute_ms_at
from ovibjax.link.profiles import profile_rate_bps

SLOT_S = 0.5
"""Length of a slot of request replay (paper, Section "Experimental Setup")."""


class Route(NamedTuple):
    """One route, slot by slot.

    Attributes:
        context: [T] int32, index into `features.frames.CONTEXTS`.
        yaw_rad: [T] heading.
        predicted_m: [T, A] predicted residual g_psi of each action, m.
        residual_m: [T, A, 2] realised error of the edge's position, x and y, m.
        risk_m: [T, A] calibrated risk that comes with that position, see `calibration`, m.
    """

    context: Any
    yaw_rad: Any
    predicted_m: Any
    residual_m: Any
    risk_m: Any


class Environment(NamedTuple):
    """Numbers of the world around the controller; leaves.

    Attributes:
        slot_s: length of a slot.
        drift: how the odometry drifts.
        initial_risk_m: local risk at the start.
        mean_kb_per_s: mean uplink throughput, KB/s of 1,024 bytes.
        snr: mean signal-to-noise ratio that sets how much fading moves the rate.
        rician_k_factor: line-of-sight share of the fading; 0 is Rayleigh.
        fading_depth: 1 for full fading, 0 for a constant rate.
        queue_median_ms: median wait at the shared edge.
        queue_sigma: standard deviation of the wait's logarithm.
        queue_correlation: its correlation from slot to slot.
        service: service time at the edge.
        return_ms: downlink.
        timeout_s: a correction that takes longer is lost.
    """

    slot_s: Any
    drift: Drift
    initial_risk_m: Any
    mean_kb_per_s: Any
    snr: Any
    rician_k_factor: Any
    fading_depth: Any
    queue_median_ms: Any
    queue_sigma: Any
    queue_correlation: Any
    service: ServiceProfile
    return_ms: Any
    timeout_s: Any


PAPER_SLOTS = 593
"""Slots of the held-out route (paper, Table "setup")."""

PAPER_REQUESTS = 22
"""Requests of VOI-Control on it (paper, Section "Request-Control Dynamics")."""

PRE_RISK_M, POST_RISK_M = 6.0, 3.0
"""Local risk before and after a request: "roughly 6 to 9 m down to 2 to 4 m" (paper, Section "View-Rate Selection")."""

DRIFT_SCALE_M = math.sqrt(PRE_RISK_M**2 - POST_RISK_M**2)
"""What drift adds between two requests, from a risk of 3 m to one of 6 m: sqrt(6^2 - 3^2) m."""

PAPER_UPLOAD_SHARE = (0.005, 0.057, 0.140)
"""Share of slots with an upload: corridor, intersection, repetitive (paper, Section "View-Rate Selection")."""


EMBEDDED_SHARE = (0.613, 0.226, 0.161)
"""Share of slots in each context on the training routes of the embedded town, see `drives`."""


def rates_from_paper(context_share: np.ndarray) -> np.ndarray:
    """Drift rates by context that spend the paper's budget: 22 requests a route, each from 6 m to 3 m of risk.

    The paper states no rate. It states that requests bring the local risk from 6 to 9 m down to 2 to 4 m, that 22 of
    them fill the budget of 593 slots, that its uncertainty rule fires at 6 m within that budget, and the share of
    slots with an upload by context. Between two requests drift adds sqrt(6^2 - 3^2) m, 22 times over the route; rates
    are proportional to the upload shares.

    Args:
        context_share: [C] share of slots in each context, on training routes: the paper's three, and any further one
            (frames whose context is unknown), which drifts at the mean rate.

    Returns:
        [C] float32 rates, m/s.
    """
    upload = np.asarray(PAPER_UPLOAD_SHARE)
    known, further = np.split(np.asarray(context_share, np.float64), [len(upload)])
    mean_rate = PAPER_REQUESTS * DRIFT_SCALE_M / (PAPER_SLOTS * SLOT_S)
    # Where no context is known, the three are taken as equally frequent.
    mix = known / known.sum() if known.sum() > 0 else np.full(len(upload), 1.0 / len(upload))
    return np.concatenate([mean_rate * upload / (upload @ mix), np.full(len(further), mean_rate)]).astype(np.float32)


def make_environment(
    context_share: Any = EMBEDDED_SHARE,
    mean_kb_per_s: float = 8.0,
    drift_scale: float = 1.0,
    drift_model: str = "rate",
) -> Environment:
    """The default environment.

    Of its numbers the paper gives the slot and the range of link profiles; a client starts with the risk that a request
    leaves. Fading, the wait at the edge, downlink and time-out are assumptions.

    Args:
        context_share: [C] share of slots in each context; sets the drift, see `rates_from_paper`.
        mean_kb_per_s: link profile.
        drift_scale: factor on every drift rate.
        drift_model: a key of `drift.DRIFT_MODELS`.

    Returns:
        Float32 leaves.

    Raises:
        InputError: an unknown drift model.
    """
    numbers = {
        "slot_s": SLOT_S,
        "initial_risk_m": POST_RISK_M,
        "mean_kb_per_s": mean_kb_per_s,
        "snr": 10.0,
        "rician_k_factor": 6.0,
        "fading_depth": 1.0,
        "queue_median_ms": 20.0,
        "queue_sigma": 0.8,
        "queue_correlation": 0.9,
        "return_ms": 5.0,
        "timeout_s": 5.0,
    }
    leaves = {name: jnp.float32(value) for name, value in numbers.items()}
    rates = drift_scale * rates_from_paper(np.asarray(context_share))
    drift = make_drift(rates, DRIFT_SCALE_M, drift_model)
    return Environment(drift=drift, service=jax.tree.map(jnp.asarray, EDGE), **leaves)


class Draws(NamedTuple):
    """One realization of the world along a route, the same for every controller.

    Attributes:
        start: belief before the first slot.
        odometry: [T] what drift brings in each slot.
        rate_bps: [T] uplink rate.
        delay_s: [T, A] predicted queueing, service and return delay.
        latency_s: [T, A] what really passes between the end of transmission and the correction, encoding included.
        rank: [T] int32, a random permutation of the slots.
        phase_s: offset of the periodic rule.
    """

    start: Belief
    odometry: Odometry
    rate_bps: jax.Array
    delay_s: jax.Array
    latency_s: jax.Array
    rank: jax.Array
    phase_s: jax.Array


def draw(key: jax.Array, route: Route, env: Environment, actions: ActionSet) -> Draws:
    """Draw channel, drift, queue and request timing of one seed.

    Args:
        key: the seed's key.
        route: the route.
        env: the environment.
        actions: the action set (static).

    Returns:
        The realization.
    """
    keys = dict(
        zip(("start", "drift", "fading", "queue", "service", "rank", "phase"), jax.random.split(key, 7), strict=True)
    )
    slots = route.context.shape[0]
    odometry, toward = draw_odometry(keys["drift"], route.context, route.yaw_rad, env.slot_s, env.drift)
    fading = fading_power(keys["fading"], (slots,), env.rician_k_factor)
    queue_s = _queue_s(keys["queue"], slots, env)
    # The client knows the wait that the edge reported one slot ago.
    reported_s = jnp.concatenate([env.queue_median_ms[None] / 1000.0, queue_s[:-1]])
    mode = jnp.asarray(actions.mode)
    return_s = env.return_ms / 1000.0
    service_s = draw_ms(keys["service"], env.service, jnp.broadcast_to(mode, (slots, len(actions)))) / 1000.0
    encode_s = compute_ms_at(JETSON, jnp.asarray(actions.prefix)) / 1000.0
    return Draws(
        start=belief.initial(env.initial_risk_m, jax.random.normal(keys["start"], (2,)), toward),
        odometry=odometry,
        rate_bps=profile_rate_bps(fading, env.mean_kb_per_s, env.snr, env.rician_k_factor, env.fading_depth),
        delay_s=reported_s[:, None] + (estimate_ms(env.service, mode) / 1000.0 + return_s)[None],
        latency_s=queue_s[:, None] + service_s + (encode_s + return_s)[None],
        rank=jnp.argsort(jax.random.uniform(keys["rank"], (slots,))).astype(jnp.int32),
        phase_s=jax.random.uniform(keys["phase"]),
    )


def _queue_s(key: jax.Array, slots: int, env: Environment) -> jax.Array:
    """[T] waits at the shared edge: lognormal, a first-order autoregression in the logarithm."""
    normal = jax.random.normal(key, (slots,))
    keep = env.queue_correlation
    scale = jnp.sqrt(1.0 - keep**2)

    def step(level: jax.Array, fresh: jax.Array) -> tuple[jax.Array, jax.Array]:
        level = keep * level + scale * fresh
        return level, level

    _, levels = jax.lax.scan(step, normal[0], normal[1:])
    logarithm = env.queue_sigma * jnp.concatenate([normal[:1], levels])
    return env.queue_median_ms / 1000.0 * jnp.exp(logarithm)

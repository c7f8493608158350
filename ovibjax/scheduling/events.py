"""When one client asks the edge along its route, and what each request is worth: recorded or made up.

Recorded events come from a replay of request control; synthetic ones have the proportions that the paper reports.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.control.actions import ActionSet
from ovibjax.control.environment import PAPER_SLOTS, PAPER_UPLOAD_SHARE, SLOT_S, Environment
from ovibjax.control.route_replay import RouteResult
from ovibjax.errors import InputError
from ovibjax.link.latency import JETSON, compute_ms_at, transmit_s
from ovibjax.link.payload import request_bytes
from ovibjax.views import MODES

_CONTEXTS = 3  # corridor, intersection, repetitive
_CONTEXT_SHARE = (0.6, 0.25, 0.15)
_STRETCH_SLOTS = 20
_PREFIX = 16


class Events(NamedTuple):
    """Requests of one client on one route.

    Attributes:
        time_s: [E] time of observation since the start of the route.
        mode: [E] int32 index of the view mode in `views.MODES`.
        prefix: [E] int32 latent prefix length k, which sets the encoding time.
        payload_bytes: [E] int32 size of the request.
        voi_m: [E] predicted net VOI.
        risk_m: [E] local risk.
        drift_m_per_s: [E] fitted drift rate.
        delay_est_ms: [E] predicted latency.
        valid: [E] bool, false for padding.
    """

    time_s: jax.Array
    mode: jax.Array
    prefix: jax.Array
    payload_bytes: jax.Array
    voi_m: jax.Array
    risk_m: jax.Array
    drift_m_per_s: jax.Array
    delay_est_ms: jax.Array
    valid: jax.Array


def recorded_runs(
    runs: RouteResult, context: np.ndarray, rate_m_per_s: np.ndarray, actions: ActionSet, first: int = 0
) -> Events:
    """`recorded_events` of several replays, padded to the most requests of any.

    Args:
        runs: the replays, fields [S, T], on the host; those without a request are left out.
        context: [T] context of the one route of all replays, or [S, T] of the route of each.
        rate_m_per_s: [C] fitted drift rate by context.
        actions: what action numbers mean.
        first: the replay that comes first, which gives a multi-client trace its times.

    Returns:
        Leaves [S, E].

    Raises:
        InputError: no replay, or not the first, holds a request.
    """
    sent = np.asarray(runs.sent).any(axis=1)
    contexts = np.broadcast_to(context, np.shape(runs.sent))
    others = [s for s in np.flatnonzero(sent).tolist() if s != first]
    each = [
        recorded_events(jax.tree.map(lambda leaf, s=s: leaf[s], runs), contexts[s], rate_m_per_s, actions)
        for s in (first, *others)
    ]
    most = max(len(events.time_s) for events in each)

    def padded(leaf: jax.Array) -> jax.Array:
        return jnp.pad(leaf, (0, most - len(leaf)))

    return jax.tree.map(lambda *leaves: jnp.stack([padded(leaf) for leaf in leaves]), *each)


def recorded_events(run: RouteResult, context: np.ndarray, rate_m_per_s: np.ndarray, actions: ActionSet) -> Events:
    """Requests of one recorded control replay.

    Args:
        run: the replay, fields [T], on the host.
        context: [T] route context.
        rate_m_per_s: [C] fitted drift rate by context.
        actions: what action numbers mean.

    Returns:
        Events in the order of time.

    Raises:
        InputError: the replay holds no request.
    """
    slots = np.flatnonzero(run.sent)
    if not len(slots):
        raise InputError("VOI-Control sent no request on the held-out route, so there is nothing to schedule")
    action = np.asarray(run.action)[slots]
    risk_m = np.asarray(run.risk_before_m)[slots]
    return Events(
        time_s=jnp.asarray(SLOT_S * slots, jnp.float32),
        mode=jnp.asarray(actions.mode[action]),
        prefix=jnp.asarray(actions.prefix[action], jnp.int32),
        payload_bytes=jnp.asarray(actions.payload_bytes[action], jnp.int32),
        voi_m=jnp.asarray(np.asarray(run.voi_m)[slots]),
        risk_m=jnp.asarray(risk_m),
        drift_m_per_s=jnp.asarray(np.asarray(rate_m_per_s)[context[slots]], jnp.float32),
        delay_est_ms=jnp.asarray(1000.0 * np.asarray(run.delay_s)[slots]),
        valid=jnp.ones(len(slots), bool),
    )


def first_events(
    run: RouteResult, context: jax.Array, env: Environment, actions: ActionSet, most: int
) -> tuple[Events, jax.Array]:
    """`recorded_events` inside a compiled program: the first requests of a replay, padded to a fixed number.

    Args:
        run: the replay, fields [T].
        context: [T] route context.
        env: length of a slot, drift rates by context.
        actions: what action numbers mean.
        most: number of events E (static); later requests are left out.

    Returns:
        Events in the order of time, and [E] milliseconds of encoding and transmission.
    """
    (slots,) = jnp.nonzero(run.sent, size=most, fill_value=0)
    action, risk_m = run.action[slots], run.risk_before_m[slots]
    events = Events(
        time_s=env.slot_s * slots.astype(jnp.float32),
        mode=jnp.asarray(actions.mode)[action],
        prefix=jnp.asarray(actions.prefix)[action],
        payload_bytes=actions.payload_bytes.astype(jnp.int32)[action],
        voi_m=run.voi_m[slots],
        risk_m=risk_m,
        drift_m_per_s=env.drift.rate_m_per_s[context[slots]],
        delay_est_ms=1000.0 * run.delay_s[slots],
        valid=jnp.arange(most) < jnp.sum(run.sent.astype(jnp.int32)),
    )
    return events, encode_and_send_ms(events, run.rate_bps[slots])


def encode_and_send_ms(events: Events, rate_bps: jax.Array) -> jax.Array:
    """Time from observation to arrival at the edge: encoding and transmission.

    Encoding times are those of the Jetson profile at the prefix of the request. At k = 32 that is 32.3 ms, from the
    paper's overhead table (50.4 ms less 148 bytes at 8 KB/s); its multi-client table would give 30.2 ms (end-to-end
    less edge p95, less 25.4 ms of transmission).

    Args:
        events: leaves [E].
        rate_bps: [E] or scalar, uplink rate.

    Returns:
        [E] float32 milliseconds.
    """
    return compute_ms_at(JETSON, events.prefix) + 1000.0 * transmit_s(events.payload_bytes, rate_bps)


def synthetic_events(key: jax.Array, n: int = 22, runs: int = 30) -> Events:
    """Plausible events of several routes of 296.5 s, for want of recorded ones.

    The route is cut into stretches of 10 s that are corridors, intersections or repetitive blocks; slots request in the
    proportions that the paper reports for them. Harder contexts drift faster and gain more.

    Args:
        key: random key.
        n: events of a route, at most `PAPER_SLOTS`.
        runs: routes S.

    Returns:
        Leaves [S, n], in the order of time, at most one per slot, all valid.
    """
    return jax.vmap(lambda run: _synthetic(jax.random.fold_in(key, run), n))(jnp.arange(runs))


def _synthetic(key: jax.Array, n: int) -> Events:
    """`synthetic_events` of one route."""
    context_key, slot_key, mode_key, voi_key, risk_key, drift_key, delay_key = jax.random.split(key, 7)
    shares = jnp.log(jnp.array(_CONTEXT_SHARE, jnp.float32))
    stretches = jax.random.categorical(context_key, shares, shape=(-(-PAPER_SLOTS // _STRETCH_SLOTS),))
    context = jnp.repeat(stretches, _STRETCH_SLOTS)[:PAPER_SLOTS].astype(jnp.int32)
    # The largest of weights plus Gumbel noise: slots drawn without replacement.
    weights = jnp.log(jnp.array(PAPER_UPLOAD_SHARE, jnp.float32))[context]
    slots = jnp.sort(jax.lax.top_k(weights + jax.random.gumbel(slot_key, (PAPER_SLOTS,)), n)[1])
    hard = context[slots].astype(jnp.float32) / (_CONTEXTS - 1)

    def between(key: jax.Array, low: float, high: float, pull: float) -> jax.Array:
        """Uniform draws, pulled towards the upper end where the context is hard."""
        uniform = jax.random.uniform(key, (n,))
        return low + (high - low) * ((1.0 - pull) * uniform + pull * hard * uniform)

    views = jnp.array([len(views) for views in MODES.values()], jnp.int32)
    names = list(MODES)
    rich = jax.random.bernoulli(mode_key, 0.25 + 0.5 * hard)
    mode = jnp.where(rich, names.index("A5"), names.index("FS")).astype(jnp.int32)
    prefix = jnp.full_like(mode, _PREFIX)
    return Events(
        time_s=SLOT_S * slots.astype(jnp.float32),
        mode=mode,
        prefix=prefix,
        payload_bytes=request_bytes(prefix, views[mode]),
        voi_m=between(voi_key, 0.5, 6.0, 0.6),
        risk_m=between(risk_key, 5.0, 9.0, 0.3),
        drift_m_per_s=between(drift_key, 0.3, 7.6, 0.8),
        delay_est_ms=between(delay_key, 20.0, 80.0, 0.0),
        valid=jnp.ones(n, bool),
    )

"""Request traces of many clients and what is measured on their replay (paper, Section "Multi-Client Scheduling").

Every client replays the request events of one route, recorded or synthetic, at a phase of its own; mission urgency,
deadlines and service-time jitter are drawn per client or request. The paper names these perturbations and not their
sizes: the defaults of `default_trace_params` are assumptions, chosen so that FIFO at 30 clients and 4 KB/s comes near
the paper's edge latency.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.control.environment import PAPER_SLOTS, PAPER_UPLOAD_SHARE, SLOT_S
from ovibjax.edge.service import EDGE, ServiceProfile, draw_ms, estimate_ms
from ovibjax.link.channel import fading_power
from ovibjax.link.latency import transmit_s
from ovibjax.link.payload import request_bytes
from ovibjax.link.profiles import profile_rate_bps
from ovibjax.scheduling.requests import RequestTrace
from ovibjax.scheduling.rules import SchedulerParams, scheduling_value
from ovibjax.views import MODES

_CONTEXTS = 3  # corridor, intersection, repetitive
_CONTEXT_SHARE = (0.6, 0.25, 0.15)
_STRETCH_SLOTS = 20
_PREFIX = 16
_TOP_SHARE, _TAIL = 0.1, 0.05


class Events(NamedTuple):
    """Requests of one client on one route.

    Attributes:
        time_s: [E] time of observation since the start of the route.
        mode: [E] int32 index of the view mode in `views.MODES`.
        payload_bytes: [E] int32 size of the request.
        voi_m: [E] predicted net VOI.
        risk_m: [E] local risk.
        drift_m_per_s: [E] fitted drift rate.
        delay_est_ms: [E] predicted latency.
        valid: [E] bool, false for padding.
    """

    time_s: jax.Array
    mode: jax.Array
    payload_bytes: jax.Array
    voi_m: jax.Array
    risk_m: jax.Array
    drift_m_per_s: jax.Array
    delay_est_ms: jax.Array
    valid: jax.Array


class TraceParams(NamedTuple):
    """Numbers of the replay; all are leaves that can be swept.

    Attributes:
        phase_spread_s: each client's route begins uniformly within this time.
        urgency_low: least mission urgency; uniform per client.
        urgency_high: largest mission urgency.
        deadline_low_ms: shortest relative deadline; uniform per request.
        deadline_high_ms: longest relative deadline.
        encode_ms: encoding time of the Jetson at k = 32, as the paper's table implies it.
        fading_depth: 0 for a constant rate to 1 for Rayleigh block fading around it.
        service: service times at the edge.
    """

    phase_spread_s: jax.Array
    urgency_low: jax.Array
    urgency_high: jax.Array
    deadline_low_ms: jax.Array
    deadline_high_ms: jax.Array
    encode_ms: jax.Array
    fading_depth: jax.Array
    service: ServiceProfile


class Workload(NamedTuple):
    """A multi-client trace.

    Attributes:
        requests: leaves [J], client after client.
        uplink_ms: [J] encoding plus transmission, from observation to `ready_ms`.
    """

    requests: RequestTrace
    uplink_ms: jax.Array


class GroupMetrics(NamedTuple):
    """Scheduling metrics of a group of requests; NaN for an empty one.

    Attributes:
        edge_p95_ms: 95th percentile of waiting plus service.
        e2e_p95_ms: 95th percentile of encoding, transmission, waiting and service.
        stale_m: mean stale-feedback penalty, drift rate times end-to-end latency.
        cost: mean weighted cost, scheduling value times edge latency over relative deadline.
    """

    edge_p95_ms: jax.Array
    e2e_p95_ms: jax.Array
    stale_m: jax.Array
    cost: jax.Array


class ReplayMetrics(NamedTuple):
    """Metrics of the tenth of the requests with the largest scheduling value, and of all."""

    top: GroupMetrics
    every: GroupMetrics


def default_trace_params() -> TraceParams:
    """Defaults: phases over 0.7 s, urgency 0.5 to 1.5, deadlines 100 to 400 ms, 30.3 ms encoding, no fading."""
    return TraceParams(
        phase_spread_s=jnp.float32(0.7),
        urgency_low=jnp.float32(0.5),
        urgency_high=jnp.float32(1.5),
        deadline_low_ms=jnp.float32(100.0),
        deadline_high_ms=jnp.float32(400.0),
        encode_ms=jnp.float32(30.3),
        fading_depth=jnp.float32(0.0),
        service=jax.tree.map(jnp.asarray, EDGE),
    )


def synthetic_events(key: jax.Array, n: int = 22) -> Events:
    """Plausible events of a route of 296.5 s, for want of recorded ones.

    The route is cut into stretches of 10 s that are corridors, intersections or repetitive blocks; slots request in the
    proportions that the paper reports for them. Harder contexts drift faster and gain more.

    Args:
        key: random key.
        n: events, at most `PAPER_SLOTS`.

    Returns:
        Events in the order of time, at most one per slot, all valid.
    """
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
    return Events(
        time_s=SLOT_S * slots.astype(jnp.float32),
        mode=mode,
        payload_bytes=request_bytes(jnp.full_like(mode, _PREFIX), views[mode]),
        voi_m=between(voi_key, 0.5, 6.0, 0.6),
        risk_m=between(risk_key, 5.0, 9.0, 0.3),
        drift_m_per_s=between(drift_key, 0.3, 7.6, 0.8),
        delay_est_ms=between(delay_key, 20.0, 80.0, 0.0),
        valid=jnp.ones(n, bool),
    )


def make_trace(
    key: jax.Array, events: Events, n_clients: int, rate_kb_per_s: jax.Array, params: TraceParams
) -> Workload:
    """Replay one route's events with many clients.

    Draws of a client depend on the key and its number alone, so more clients leave the others as they are.

    Args:
        key: random key.
        events: leaves [E].
        n_clients: number N of clients.
        rate_kb_per_s: mean uplink rate, KB/s of 1,024 bytes.
        params: scalars.

    Returns:
        The N E requests.
    """
    rate = jnp.asarray(rate_kb_per_s, jnp.float32)

    def client(number: jax.Array) -> Workload:
        keys = jax.random.split(jax.random.fold_in(key, number), 5)
        fading = fading_power(keys[4], events.time_s.shape, 0.0)
        rate_bps = profile_rate_bps(fading, rate, depth=params.fading_depth)
        uplink_ms = params.encode_ms + 1000.0 * transmit_s(events.payload_bytes, rate_bps)
        return client_requests(keys[:4], number, events, uplink_ms, params)

    return flatten(jax.vmap(client)(jnp.arange(n_clients, dtype=jnp.int32)))


def client_requests(
    keys: jax.Array, number: jax.Array, events: Events, uplink_ms: jax.Array, params: TraceParams
) -> Workload:
    """Requests of one client: its events, with phase, urgency, deadlines and service times drawn.

    Args:
        keys: [4] keys of the client.
        number: its number.
        events: leaves [E].
        uplink_ms: [E] encoding and transmission.
        params: scalars; of them phases, urgencies, deadlines and service are used.

    Returns:
        Leaves [E].
    """
    phase_key, urgency_key, deadline_key, service_key = keys
    shape = events.time_s.shape
    phase_s = params.phase_spread_s * jax.random.uniform(phase_key)
    urgency = params.urgency_low + (params.urgency_high - params.urgency_low) * jax.random.uniform(urgency_key)
    span_ms = params.deadline_high_ms - params.deadline_low_ms
    requests = RequestTrace(
        client=jnp.broadcast_to(number, shape),
        ready_ms=1000.0 * (events.time_s + phase_s) + uplink_ms,
        service_ms=draw_ms(service_key, params.service, events.mode),
        service_est_ms=estimate_ms(params.service, events.mode),
        deadline_ms=params.deadline_low_ms + span_ms * jax.random.uniform(deadline_key, shape),
        voi_m=events.voi_m,
        drift_m_per_s=events.drift_m_per_s,
        risk_m=events.risk_m,
        delay_est_ms=events.delay_est_ms,
        urgency=jnp.broadcast_to(urgency, shape),
        valid=events.valid,
    )
    return Workload(requests, uplink_ms)


def flatten(clients: Workload) -> Workload:
    """Leaves [N, E] to [N E], client after client."""
    flat: Workload = jax.tree.map(lambda leaf: leaf.reshape(-1), clients)
    return flat


def metrics(workload: Workload, wait_ms: jax.Array, params: SchedulerParams) -> ReplayMetrics:
    """Latencies, stale-feedback penalty and weighted cost of one replay.

    The response latency D_j of the cost counts from the request's arrival at the edge, as its deadline does; the
    observation-to-correction delay of the penalty is the end-to-end latency.

    Args:
        workload: leaves [J].
        wait_ms: [J] waits of its replay, as `replay.waits` gives them.
        params: scalars; only the coefficients of the scheduling value are used.

    Returns:
        Scalars.
    """
    r = workload.requests
    valid = jnp.asarray(r.valid, bool)
    voi, drift, risk, delay, urgency, deadline_ms, service_ms = (
        jnp.asarray(leaf, jnp.float32)
        for leaf in (
            *(r.voi_m, r.drift_m_per_s, r.risk_m, r.delay_est_ms),
            *(r.urgency, r.deadline_ms, r.service_ms),
        )
    )
    value = scheduling_value(voi, drift, risk, delay, urgency, params.value)
    edge_ms = wait_ms + service_ms
    e2e_ms = workload.uplink_ms + edge_ms
    stale_m = drift * e2e_ms / 1000.0
    cost = value * edge_ms / deadline_ms

    def group(members: jax.Array) -> GroupMetrics:
        count = jnp.sum(members.astype(jnp.float32))
        means = (jnp.sum(jnp.where(members, each, 0.0)) / count for each in (stale_m, cost))
        return GroupMetrics(_upper_percentile(edge_ms, members), _upper_percentile(e2e_ms, members), *means)

    return ReplayMetrics(group(_top(value, valid)), group(valid))


def _top(value: jax.Array, valid: jax.Array) -> jax.Array:
    """The tenth of the valid requests, rounded up, with the largest values; equals of the last are included."""
    most = -(-value.size // round(1 / _TOP_SHARE))
    largest = jax.lax.top_k(jnp.where(valid, value, -jnp.inf), most)[0]
    count = jnp.ceil(_TOP_SHARE * jnp.sum(valid.astype(jnp.float32)) - 1e-4).astype(jnp.int32)
    return valid & (value >= largest[jnp.maximum(count - 1, 0)])


def _upper_percentile(values: jax.Array, members: jax.Array) -> jax.Array:
    """95th percentile of the members by linear interpolation, from the largest values only: no sort of them all."""
    kept = min(values.size, int(_TAIL * values.size) + 2)
    largest = jax.lax.top_k(jnp.where(members, values, -jnp.inf), kept)[0]
    count = jnp.sum(members.astype(jnp.float32))
    from_top = jnp.maximum(_TAIL * (count - 1.0), 0.0)
    upper = jnp.floor(from_top)
    at = upper.astype(jnp.int32)
    above, below = largest[at], largest[jnp.minimum(at + 1, kept - 1)]
    fraction = from_top - upper
    between = jnp.where(fraction > 0, above + fraction * (below - above), above)
    return jnp.where(count > 0, between, jnp.nan)

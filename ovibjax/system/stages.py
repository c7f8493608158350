"""The stages of the whole system, in the order in which data flows: train, localize, replay, arrive, serve.

Each is a pure function that can be compiled on its own; `chain` puts them together.
"""

import jax
import jax.numpy as jnp

from ovibjax.control.actions import SweptActions
from ovibjax.control.calibration import calibrated_risk_m, fit_calibration
from ovibjax.control.client_state import ControlParams
from ovibjax.control.environment import Route, draw
from ovibjax.control.predictor import predictor_of_known
from ovibjax.control.replay_sums import sums_by_steps
from ovibjax.control.residuals import retrieve
from ovibjax.control.route_replay import RouteResult, simulate
from ovibjax.edge.retrieval import Match
from ovibjax.encoder.checkpoint import mix_frames
from ovibjax.encoder.loss import make_hypers
from ovibjax.encoder.model import Params
from ovibjax.encoder.train import TrainData, fit
from ovibjax.scheduling.clients import Workload, client_requests, flatten, on_timeline
from ovibjax.scheduling.events import Events, first_events
from ovibjax.scheduling.replay_grid import run_rules
from ovibjax.scheduling.replay_metrics import metrics
from ovibjax.scheduling.rules import SchedulerParams
from ovibjax.system.data import SystemConfig, SystemData

HYPERS = ("beta", "gamma", "lr", "weight_decay", "nesting")
"""Fields of a point that training depends on."""


def train(key: jax.Array, point: dict[str, jax.Array], data: SystemData, static: SystemConfig) -> Params:
    """Train the encoder by masked reconstruction; depends on beta, gamma and seed.

    Args:
        key: random key.
        point: any of `HYPERS`.
        data: `seen_x` is used.
        static: static choices.

    Returns:
        Network parameters.
    """
    key_mix, key_fit = jax.random.split(key)
    x = mix_frames(key_mix, data.seen_x, static.mixed)
    given = {name: point[name] for name in HYPERS if name in point}
    hypers = make_hypers(alpha=0.0)._replace(**given)
    return fit(key_fit, hypers, TrainData(x, jnp.zeros((x.shape[0], 3), jnp.float32)), static.train)[0]


def localize(
    params: Params, codes: jax.Array, masks: jax.Array, k: jax.Array, data: SystemData, static: SystemConfig
) -> tuple[Route, jax.Array]:
    """Answers for every frame and mode at a prefix, g_psi and calibrated risks from them, and the clients' routes.

    Args:
        params: network parameters.
        codes: [A, F, K] latent means by mode.
        masks: [A, M] views of the modes.
        k: prefix length.
        data: scene and clients.
        static: static choices.

    Returns:
        [C, T, ...] routes, and the mean residual of the last mode on them.
    """
    flat = data.x.reshape(data.x.shape[0], -1)

    def one(mode: tuple[jax.Array, jax.Array]) -> Match:
        mu, mask = mode
        return retrieve(params, flat, mu, (mask, k), data.survey, static.train.arch)

    found = jax.lax.map(one, (codes, masks))  # leaves [A, F]
    residual_m = jnp.moveaxis(data.survey.places_m[found.row], 0, 1) - data.positions_m[:, None]
    distance_m, distinctness = jnp.linalg.norm(residual_m, axis=-1), found.distinctness.T
    contexts = data.env.drift.rate_m_per_s.shape[0]
    predicted_m = predictor_of_known(distance_m, data.context, data.known, contexts)
    risk_m = calibrated_risk_m(fit_calibration(distinctness, distance_m**2, data.known), distinctness)
    rows = data.routes
    routes = Route(
        context=data.context[rows],
        yaw_rad=data.yaw_rad[rows],
        predicted_m=predicted_m[data.context[rows]],
        residual_m=residual_m[rows],
        risk_m=risk_m[rows],
    )
    return routes, jnp.mean(distance_m[rows, -1])


def replay_clients(
    key: jax.Array, routes: Route, actions: SweptActions, data: SystemData, static: SystemConfig
) -> tuple[RouteResult, jax.Array]:
    """Replay request control of every client, each with its own draws of drift, channel and queue.

    Args:
        key: random key; a client's draws depend on it and the client's number alone.
        routes: [C, T, ...] routes.
        actions: the action set.
        data: environment and controller.
        static: the policy.

    Returns:
        [C, T] histories, and [C] KB that VOI-Control would send if no cap held it back.
    """
    free = data.control._replace(budget_bytes=jnp.full_like(data.control.budget_bytes, jnp.inf))

    def one(number: jax.Array, route: Route) -> tuple[RouteResult, jax.Array]:
        draws = draw(jax.random.fold_in(key, number), route, data.env, actions)
        none = jnp.zeros(draws.rate_bps.shape, bool)
        # A few replays: the program that histories need anyway, rather than the one for thousands.
        uncapped = sums_by_steps(draws, route, "voi", none, ControlParams(data.env, free), actions)
        history = simulate(draws, route, static.policy, ControlParams(data.env, data.control), actions)
        return history, uncapped.sent_bytes / 1024.0

    return jax.vmap(one)(jnp.arange(routes.context.shape[0], dtype=jnp.int32), routes)


def arrivals(
    key: jax.Array,
    history: RouteResult,
    routes: Route,
    actions: SweptActions,
    data: SystemData,
    static: SystemConfig,
) -> Workload:
    """What the clients sent, as it reaches each edge server after encoding and transmission.

    Args:
        key: random key; a client's draws depend on it, its server and its number.
        history: [C, T] histories.
        routes: [C, T, ...] their routes.
        actions: the action set.
        data: fleet, environment, numbers of the trace.
        static: most requests per client.

    Returns:
        Leaves [S, N E].
    """

    def record(run: RouteResult, context: jax.Array) -> tuple[Events, jax.Array]:
        return first_events(run, context, data.env, actions, static.requests)

    events, uplink_ms = jax.vmap(record)(history, routes.context)

    def server(number: jax.Array, members: jax.Array) -> Workload:
        leader: Events = jax.tree.map(lambda leaf: leaf[members[0]], events)

        def client(n: jax.Array, which: jax.Array) -> Workload:
            *keys, first_key = jax.random.split(jax.random.fold_in(jax.random.fold_in(key, number), n), 5)
            own: Events = jax.tree.map(lambda leaf: leaf[which], events)
            mine, taken = on_timeline(first_key, own, leader, data.trace.own_times)
            trace = data.trace._replace(service=data.env.service)
            return client_requests(jnp.stack(keys), n, mine, uplink_ms[which][taken], trace)

        return flatten(jax.vmap(client)(jnp.arange(members.shape[0], dtype=jnp.int32), members))

    return jax.vmap(server)(jnp.arange(data.fleet.shape[0], dtype=jnp.int32), data.fleet)


def serve(
    workload: Workload, history: RouteResult, Vs: jax.Array, data: SystemData, static: SystemConfig
) -> dict[str, jax.Array]:
    """Replay every server's queue under every rule and V, and judge it.

    Args:
        workload: leaves [S, J].
        history: [C, T] what the clients sent.
        Vs: [P] values of V; rules that do not use it are replayed once.
        data: fleet, V and weights.
        static: the rules.

    Returns:
        [P, rules] means over the servers.
    """
    counts = jnp.sum(history.sent.astype(jnp.int32), axis=-1)[data.fleet]
    # Members ask at the times of the first, if they ask at all, unless they have times of their own.
    shared = jnp.sum(counts[:, 0] * jnp.sum((counts > 0).astype(jnp.int32), axis=1))
    sent = jnp.where(data.trace.own_times, jnp.sum(counts), shared)
    params = data.scheduler._replace(V=Vs)
    found = run_rules(workload.requests, static.schedulers, params, _judge, workload)

    def of(scheduler: str) -> dict[str, jax.Array]:
        judged = dict(found[scheduler])
        served = jnp.sum(judged.pop("served"), axis=0)
        return jax.tree.map(lambda leaf: jnp.mean(leaf, axis=0), judged) | {"unserved": sent - served}

    rules = [of(scheduler) for scheduler in static.schedulers]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves, axis=-1), *rules)


def _judge(workload: Workload, waits_ms: jax.Array, params: SchedulerParams) -> dict[str, jax.Array]:
    """One replay of one server's queue."""
    found = metrics(workload, waits_ms, params)
    named = {f"top_{name}": value for name, value in found.top._asdict().items()}
    named |= {f"all_{name}": value for name, value in found.every._asdict().items()}
    return named | {"served": jnp.sum(jnp.isfinite(waits_ms).astype(jnp.int32))}

"""The whole chain as one function of one grid point (paper, Section "System Architecture").

Train an O-VIB encoder at (beta, gamma, seed); retrieve every frame at prefix k; fit g_psi; replay request control;
hand its requests to an edge server shared by N clients; judge route and edge. Nothing leaves the program in between.

Maps are nested in the order of what depends on what, so that a stage is computed once along every axis it does not
depend on: a member trains and encodes once, a prefix retrieves and replays routes once, V replays the queue only.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.control.actions import SweptActions
from ovibjax.control.client_state import ControlParams
from ovibjax.control.controller import Controller
from ovibjax.control.environment import Environment, Route, draw
from ovibjax.control.residuals import encode_views, mix_frames, retrieve
from ovibjax.control.route_replay import RouteResult, simulate
from ovibjax.control.route_summary import summarize
from ovibjax.encoder.loss import make_hypers
from ovibjax.encoder.model import Params
from ovibjax.encoder.train import TrainConfig, TrainData, fit
from ovibjax.link.latency import JETSON, compute_ms_at, transmit_s
from ovibjax.scheduling.clients import Events, TraceParams, Workload, client_requests, flatten, metrics
from ovibjax.scheduling.lanes import run_grid
from ovibjax.scheduling.rules import POLICIES, SchedulerParams
from ovibjax.views import mode_mask

USES_V = ("base_dpp",)
"""Rules whose order depends on V; the shaped rule has weights instead."""

HYPERS = ("beta", "gamma", "lr", "weight_decay", "nesting")
"""Fields of a point that training depends on."""

DIMS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("mean_route_m", "p95_route_m", "kb", "requests", "risk_m", "residual_m"), ("k",)),
    **dict.fromkeys(
        (
            *(
                f"{group}_{name}"
                for group in ("top", "all")
                for name in ("edge_p95_ms", "e2e_p95_ms", "stale_m", "cost")
            ),
            "unserved",
        ),
        ("k", "V", "scheduler"),
    ),
}
"""Trailing dimensions of the metrics of `along`."""

UNITS = {
    **{name: "m" for name in DIMS if name.endswith("_m")},
    **{name: "ms" for name in DIMS if name.endswith("_ms")},
    "kb": "KB",
}
"""Units of the metrics."""


@dataclass(frozen=True)
class SystemConfig:
    """Static choices; hashable.

    Attributes:
        train: architecture, trained prefixes, steps.
        modes: view modes a client may choose among.
        policy: request policy, a key of `control.policies.POLICIES`.
        schedulers: scheduling rules at the edge.
        mixed: training examples made by mixing frames, see `residuals.mix_frames`.
        requests: most requests of one client; more would not be served, which `unserved` tells.
    """

    train: TrainConfig
    modes: tuple[str, ...]
    policy: str = "voi"
    schedulers: tuple[str, ...] = POLICIES
    mixed: int = 8192
    requests: int = 40


class SystemData(NamedTuple):
    """One scene, its clients and its servers; arrays.

    Attributes:
        seen_x: [L, M, r] features of the frames that are trained on, without positions.
        x: [F, M, r] features of every frame.
        positions_m: [F, 2] where they were taken.
        yaw_rad: [F] headings.
        context: [F] int32 contexts.
        known: [F] bool, frames of training routes, on which g_psi is fitted.
        references: [R] int32 frames in the edge's database.
        own: [F] int32 a frame's position in the database, or -1.
        routes: [C, T] int32 frames along the route of each client that is replayed.
        fleet: [S, N] int32 which of these clients each client of each edge server is.
        env: drift, link, service.
        control: prices, budget, rules.
        trace: phases, urgencies, deadlines.
        scheduler: V and weights; V is replaced where it is swept.
    """

    seen_x: Any
    x: Any
    positions_m: Any
    yaw_rad: Any
    context: Any
    known: Any
    references: Any
    own: Any
    routes: Any
    fleet: Any
    env: Environment
    control: Controller
    trace: TraceParams
    scheduler: SchedulerParams


def run(key: jax.Array, point: dict[str, jax.Array], data: SystemData, static: SystemConfig) -> dict[str, jax.Array]:
    """The system at one point.

    Args:
        key: the seed's key; points that share it are paired.
        point: scalars `k` and `V`, and any of `HYPERS`.
        data: scene, clients, servers.
        static: static choices.

    Returns:
        Metrics as in `DIMS`, without the dimensions `k` and `V`.
    """
    found = along(key, point, jnp.reshape(point["k"], (1,)), jnp.reshape(point["V"], (1,)), data, static)
    return {name: value[0] if DIMS[name] == ("k",) else value[0, 0] for name, value in found.items()}


def along(
    key: jax.Array,
    point: dict[str, jax.Array],
    prefixes: jax.Array,
    Vs: jax.Array,
    data: SystemData,
    static: SystemConfig,
) -> dict[str, jax.Array]:
    """The system at one (beta, gamma, seed), along prefixes and values of V.

    Args:
        key: the seed's key.
        point: any of `HYPERS`.
        prefixes: [K] int32 prefix lengths.
        Vs: [P] values of V.
        data: scene, clients, servers.
        static: static choices.

    Returns:
        Metrics by name, trailing dimensions as in `DIMS`.
    """
    train_key, route_key, queue_key = jax.random.split(key, 3)
    params = train(train_key, point, data, static)
    masks = jnp.stack([mode_mask(mode, static.train.arch.n_views) for mode in static.modes])
    flat = data.x.reshape(data.x.shape[0], -1)
    codes = jax.lax.map(lambda mask: encode_views(params, flat, mask, static.train.arch), masks)

    def at_prefix(k: jax.Array) -> dict[str, jax.Array]:
        actions = SweptActions(modes=static.modes, k=k)
        routes, residual_m = localize(params, codes, masks, k, data, static)
        history = replay_clients(route_key, routes, actions, data, static)
        workload = arrivals(queue_key, history, routes, actions, data, static)
        summary = jax.tree.map(lambda leaf: jnp.mean(leaf.astype(jnp.float32)), summarize(history))
        return {
            "mean_route_m": summary.mean_m,
            "p95_route_m": summary.p95_m,
            "kb": summary.kb,
            "requests": summary.requests,
            "risk_m": summary.risk_m,
            "residual_m": residual_m,
            **serve(workload, history, Vs, data, static),
        }

    return jax.lax.map(at_prefix, prefixes)


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
    """Residuals of every frame and mode at a prefix, g_psi from them, and the clients' routes with both.

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

    def one(mode: tuple[jax.Array, jax.Array]) -> jax.Array:
        mu, mask = mode
        return retrieve(params, mu, mask, k, data.references, data.own, static.train.arch)

    found = jax.lax.map(one, (codes, masks))  # [A, F]
    places_m = data.positions_m[data.references]
    residual_m = jnp.moveaxis(places_m[found], 0, 1) - data.positions_m[:, None]
    distance_m = jnp.linalg.norm(residual_m, axis=-1)
    predicted_m = predictor(distance_m, data.context, data.known, data.env.drift_m2_per_s.shape[0])
    rows = data.routes
    routes = Route(
        context=data.context[rows],
        yaw_rad=data.yaw_rad[rows],
        predicted_m=predicted_m[data.context[rows]],
        residual_m=residual_m[rows],
    )
    return routes, jnp.mean(distance_m[rows, -1])


def predictor(residual_m: jax.Array, context: jax.Array, known: jax.Array, n_contexts: int) -> jax.Array:
    """g_psi: median residual on training routes by context and action (paper, eq. "edge_risk").

    Args:
        residual_m: [F, A] residuals.
        context: [F] contexts.
        known: [F] frames of training routes.
        n_contexts: number of contexts (static).

    Returns:
        [n_contexts, A] metres; a context that training never met has the median over all.
    """

    def one(c: jax.Array) -> jax.Array:
        mine = known & (context == c)
        mine = jnp.where(jnp.any(mine), mine, known)
        ascending = jnp.sort(jnp.where(mine[:, None], residual_m, jnp.inf), axis=0)
        count = jnp.sum(mine.astype(jnp.int32))
        return 0.5 * (ascending[(count - 1) // 2] + ascending[count // 2])

    return jax.vmap(one)(jnp.arange(n_contexts))


def replay_clients(
    key: jax.Array, routes: Route, actions: SweptActions, data: SystemData, static: SystemConfig
) -> RouteResult:
    """Replay request control of every client, each with its own draws of drift, channel and queue.

    Args:
        key: random key; a client's draws depend on it and the client's number alone.
        routes: [C, T, ...] routes.
        actions: the action set.
        data: environment and controller.
        static: the policy.

    Returns:
        [C, T] histories.
    """

    def one(number: jax.Array, route: Route) -> RouteResult:
        draws = draw(jax.random.fold_in(key, number), route, data.env, actions)
        return simulate(draws, route, static.policy, ControlParams(data.env, data.control), actions)

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
        (slots,) = jnp.nonzero(run.sent, size=static.requests, fill_value=0)
        action, risk_m = run.action[slots], run.risk_before_m[slots]
        encode_ms = compute_ms_at(JETSON, actions.prefix)[action]
        events = Events(
            time_s=data.env.slot_s * slots.astype(jnp.float32),
            mode=jnp.asarray(actions.mode)[action],
            payload_bytes=actions.payload_bytes.astype(jnp.int32)[action],
            voi_m=run.voi_m[slots],
            risk_m=risk_m,
            drift_m_per_s=data.env.drift_m2_per_s[context[slots]] / (2.0 * jnp.maximum(risk_m, 1e-6)),
            delay_est_ms=1000.0 * run.delay_s[slots],
            valid=jnp.arange(static.requests) < jnp.sum(run.sent.astype(jnp.int32)),
        )
        return events, encode_ms + 1000.0 * transmit_s(events.payload_bytes, run.rate_bps[slots])

    events, uplink_ms = jax.vmap(record)(history, routes.context)

    def server(number: jax.Array, members: jax.Array) -> Workload:
        def client(n: jax.Array, which: jax.Array) -> Workload:
            keys = jax.random.split(jax.random.fold_in(jax.random.fold_in(key, number), n), 4)
            mine: Events = jax.tree.map(lambda leaf: leaf[which], events)
            return client_requests(keys, n, mine, uplink_ms[which], data.trace._replace(service=data.env.service))

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
    sent = jnp.sum(jnp.sum(history.sent.astype(jnp.int32), axis=-1)[data.fleet])

    def of(scheduler: str) -> dict[str, jax.Array]:
        swept = scheduler in USES_V
        params = data.scheduler._replace(V=Vs) if swept else data.scheduler
        found = run_grid(workload.requests, scheduler, params, _judge, workload)
        judged = jax.tree.map(lambda leaf: jnp.broadcast_to(jnp.mean(leaf, axis=0), Vs.shape), found)
        served = jnp.broadcast_to(jnp.sum(found["served"], axis=0), Vs.shape)
        del judged["served"]
        return judged | {"unserved": sent - served}

    rules = [of(scheduler) for scheduler in static.schedulers]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves, axis=-1), *rules)


def _judge(workload: Workload, waits_ms: jax.Array, params: SchedulerParams) -> dict[str, jax.Array]:
    """One replay of one server's queue."""
    found = metrics(workload, waits_ms, params)
    named = {f"top_{name}": value for name, value in found.top._asdict().items()}
    named |= {f"all_{name}": value for name, value in found.every._asdict().items()}
    return named | {"served": jnp.sum(jnp.isfinite(waits_ms).astype(jnp.int32))}


@dataclass(frozen=True)
class System:
    """A member function for `sweep.run` over beta, gamma and seed; prefixes and V are dimensions of its outputs.

    Attributes:
        static: static choices.
    """

    static: SystemConfig

    def __call__(self, key: jax.Array, point: dict[str, jax.Array], shared: Any) -> dict[str, jax.Array]:
        """`along` on shared data.

        Args:
            key: the seed's key.
            point: any of `HYPERS`; other axes are ignored.
            shared: prefixes, values of V, and `SystemData`.

        Returns:
            Metrics as in `DIMS`.
        """
        prefixes, Vs, data = shared
        return along(key, point, prefixes, Vs, data, self.static)

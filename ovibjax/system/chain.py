"""The whole system as one function of one grid point (paper, Section "System Overview").

Train an O-VIB encoder at (beta, gamma, seed); retrieve every frame at prefix k; fit g_psi; replay request control;
hand its requests to an edge server shared by N clients; judge route and edge. Nothing leaves the program in between.

Maps are nested in the order of what depends on what, so that a stage is computed once along every axis it does not
depend on: a member trains and encodes once, a prefix retrieves and replays routes once, V replays the queue only.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from ovibjax.control.actions import SweptActions
from ovibjax.control.residuals import encode_views
from ovibjax.control.route_summary import summarize
from ovibjax.control.voi import Prices
from ovibjax.encoder.model import Params
from ovibjax.system.coding import overhead_bytes, received
from ovibjax.system.data import FLOATS, SystemConfig, SystemData
from ovibjax.system.stages import arrivals, localize, replay_clients, serve, train
from ovibjax.views import mode_mask

DIMS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("mean_route_m", "p95_route_m", "kb", "free_kb", "requests", "risk_m", "residual_m"), ("k",)),
    **dict.fromkeys(
        (
            *(
                f"{group}_{name}"
                for group in ("top", "all")
                for name in ("edge_p95_ms", "e2e_p95_ms", "stale_m", "cost", "edge_cost")
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
    "free_kb": "KB",
}
"""Units of the metrics."""


def dims_of(codes: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Trailing dimensions of the metrics of `along`: `DIMS`, and `code` before them unless all is sent as floats."""
    return DIMS if codes == FLOATS else {name: ("code", *dims) for name, dims in DIMS.items()}


def run(key: jax.Array, point: dict[str, jax.Array], data: SystemData, static: SystemConfig) -> dict[str, jax.Array]:
    """The system at one point.

    Args:
        key: the seed's key; points that share it are paired.
        point: scalars `k` and `V`, and any of `HYPERS`.
        data: scene, clients, servers.
        static: static choices.

    Returns:
        Metrics as in `DIMS`, without the dimensions `k` and `V`; by the first of the codes.
    """
    found = along(key, point, jnp.reshape(point["k"], (1,)), jnp.reshape(point["V"], (1,)), data, static)
    if static.codes != FLOATS:
        found = jax.tree.map(lambda value: value[0], found)
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
        data: scene, clients, servers; prices of its controller may be [codes, K] where there are codes to choose among.
        static: static choices.

    Returns:
        Metrics by name, trailing dimensions as `dims_of` says.
    """
    _, route_key, queue_key = jax.random.split(key, 3)
    params, masks, codes = encoded(key, point, data, static)

    def at_prefix(
        k: jax.Array, codes: jax.Array, sizes_bytes: jax.Array | None, data: SystemData
    ) -> dict[str, jax.Array]:
        of_k = None if sizes_bytes is None else sizes_bytes[:, k - 1]
        actions = SweptActions(modes=static.modes, k=k, sizes_bytes=of_k)
        routes, residual_m = localize(params, codes, masks, k, data, static)
        history, free_kb = replay_clients(route_key, routes, actions, data, static)
        workload = arrivals(queue_key, history, routes, actions, data, static)
        summary = jax.tree.map(lambda leaf: jnp.mean(leaf.astype(jnp.float32)), summarize(history))
        return {
            "mean_route_m": summary.mean_m,
            "p95_route_m": summary.p95_m,
            "kb": summary.kb,
            "free_kb": jnp.max(free_kb),
            "requests": summary.requests,
            "risk_m": summary.risk_m,
            "residual_m": residual_m,
            **serve(workload, history, Vs, data, static),
        }

    if static.codes == FLOATS:
        return jax.lax.map(lambda k: at_prefix(k, codes, None, data), prefixes)
    shape = (len(static.codes), prefixes.shape[0])
    prices = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, shape), data.control.prices)

    def of_code(one: tuple[jax.Array, jax.Array, Prices]) -> dict[str, jax.Array]:
        coded, sizes_bytes, of_prefix = one

        def at(given: tuple[jax.Array, Prices]) -> dict[str, jax.Array]:
            priced = data._replace(control=data.control._replace(prices=given[1]))
            return at_prefix(given[0], coded, sizes_bytes, priced)

        return jax.lax.map(at, (prefixes, of_prefix))

    return jax.lax.map(of_code, (*every_code(codes, data, static), prices))


def encoded(
    key: jax.Array, point: dict[str, jax.Array], data: SystemData, static: SystemConfig
) -> tuple[Params, jax.Array, jax.Array]:
    """A trained encoder and what it makes of every frame.

    Args:
        key: the seed's key, as `along` is given it.
        point: any of `HYPERS`.
        data: scene.
        static: static choices.

    Returns:
        Parameters, [A, M] views of the modes, [A, F, K] latent means by mode.
    """
    params = train(jax.random.split(key, 3)[0], point, data, static)
    masks = jnp.stack([mode_mask(mode, static.train.arch.n_views) for mode in static.modes])
    flat = data.x.reshape(data.x.shape[0], -1)
    return params, masks, jax.lax.map(lambda mask: encode_views(params, flat, mask, static.train.arch), masks)


def every_code(codes: jax.Array, data: SystemData, static: SystemConfig) -> tuple[jax.Array, jax.Array]:
    """What the edge receives by each code, and the sizes of requests.

    Args:
        codes: [A, F, K] latent means by mode.
        data: which frames are known.
        static: codes and header.

    Returns:
        [codes, A, F, K] received codes, and [codes, A, K] whole bytes of requests with prefixes of 1 to K.
    """
    each = [received(codes, data.known, code) for code in static.codes]
    beside = [overhead_bytes(static.modes, code, static.compact) for code in static.codes]
    coded = jnp.stack([sent for sent, _ in each])
    sizes_bytes = jnp.stack([size for _, size in each]) + jnp.array(beside, jnp.float32)[..., None]
    return coded, jnp.ceil(sizes_bytes)


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
            Metrics as `dims_of` says.
        """
        prefixes, Vs, data = shared
        return along(key, point, prefixes, Vs, data, self.static)

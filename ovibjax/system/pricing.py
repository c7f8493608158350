"""What requests should cost, code by code, so that a route keeps its payload budget by its prices.

As the paper selects them for its own packets (Section "View-Rate Selection": "tuning seeds select the lowest-risk
feasible configuration"): feasible is what keeps the budget on every route of every tuning seed without a cap. Smaller
requests leave room for more of them, and so for lower prices.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray

from ovibjax.control.actions import ActionSet, SweptActions
from ovibjax.control.client_state import ControlParams
from ovibjax.control.controller import PAPER_BUDGET_KB
from ovibjax.control.environment import Route, draw
from ovibjax.control.policy_search import candidates
from ovibjax.control.replay_sums import sums_by_steps
from ovibjax.control.voi import Prices
from ovibjax.features.frames import FeatureSet
from ovibjax.sweep.engine import run
from ovibjax.system.chain import encoded, every_code
from ovibjax.system.data import SystemConfig, SystemData, SystemSize, make_system
from ovibjax.system.stages import localize


@dataclass(frozen=True)
class Priced:
    """A member function for `sweep.run` over seeds: candidate prices on every route, without a cap on the payload.

    Attributes:
        static: static choices.
    """

    static: SystemConfig

    def __call__(self, key: jax.Array, point: dict[str, jax.Array], shared: Any) -> dict[str, jax.Array]:
        """Train, code, and replay every candidate.

        Args:
            key: the seed's key.
            point: any of `HYPERS`; other axes are ignored.
            shared: prefixes, [candidates] prices, and `SystemData`.

        Returns:
            Mean local risk and the most that any route sent, [codes, K, candidates].
        """
        prefixes, tried, data = shared
        _, route_key, _ = jax.random.split(key, 3)
        params, masks, codes = encoded(key, point, data, self.static)

        def at_prefix(k: jax.Array, coded: jax.Array, sizes_bytes: jax.Array) -> dict[str, jax.Array]:
            actions = SweptActions(modes=self.static.modes, k=k, sizes_bytes=sizes_bytes[:, k - 1])
            routes, _ = localize(params, coded, masks, k, data, self.static)
            return _replayed(route_key, routes, actions, tried, data)

        def of_code(one: tuple[jax.Array, jax.Array]) -> dict[str, jax.Array]:
            return jax.lax.map(lambda k: at_prefix(k, *one), prefixes)

        return jax.lax.map(of_code, every_code(codes, data, self.static))


def _replayed(
    key: jax.Array, routes: Route, actions: SweptActions, tried: Prices, data: SystemData
) -> dict[str, jax.Array]:
    """[candidates] risk and payload of VOI-Control over the routes [C, T, ...], with the draws of `replay_clients`."""
    free = data.control._replace(budget_bytes=jnp.full_like(data.control.budget_bytes, jnp.inf))

    def one(number: jax.Array, route: Route) -> tuple[jax.Array, jax.Array]:
        draws = draw(jax.random.fold_in(key, number), route, data.env, actions)
        none = jnp.zeros(draws.rate_bps.shape, bool)

        def by(prices: Prices) -> tuple[jax.Array, jax.Array]:
            params = ControlParams(data.env, free._replace(prices=prices))
            found = sums_by_steps(draws, route, "voi", none, params, actions)
            return found.risk_m / none.shape[0], found.sent_bytes / 1024.0

        return jax.vmap(by)(tried)

    risk_m, kb = jax.vmap(one)(jnp.arange(routes.context.shape[0], dtype=jnp.int32), routes)
    return {"risk_m": jnp.mean(risk_m, axis=0), "most_kb": jnp.max(kb, axis=0)}


def random_prices(count: int) -> Prices:
    """So many prices of transmission and delay, as `policy_search.candidates` draws them; none on energy."""
    drawn = candidates(jax.random.key(0), count, ActionSet(prefixes=(0,))).prices
    return drawn._replace(energy_m_per_j=jnp.zeros(count, jnp.float32))


def search_prices(
    scene: tuple[list[FeatureSet], int, SystemSize],
    seeds: Sequence[int],
    prefixes: Sequence[int],
    coding: tuple[Sequence[str], bool],
    tried: Prices,
    **options: Any,
) -> xarray.Dataset:
    """Try prices on tuning seeds.

    Args:
        scene: drives, how many of them are for training, and how much is trained and replayed.
        seeds: tuning seeds.
        prefixes: prefixes k.
        coding: how prefixes are written, and whether those that are not floats travel under a compact header.
        tried: [candidates] prices.
        options: further options of `sweep.run`, such as `store`.

    Returns:
        `risk_m` and `most_kb` [seed, code, k, candidate].
    """
    data, static = make_system(*scene)
    static = replace(static, codes=tuple(coding[0]), compact=coding[1])
    return run(
        Priced(static),
        {"seed": list(seeds)},
        (jnp.asarray(prefixes, jnp.int32), tried, data),
        dims=dict.fromkeys(("risk_m", "most_kb"), ("code", "k", "candidate")),
        coords={"code": list(static.codes), "k": list(prefixes)},
        units={"risk_m": "m", "most_kb": "KB"},
        **options,
    )


def lowest_risk_prices(searched: xarray.Dataset, tried: Prices, budget_kb: float = PAPER_BUDGET_KB) -> Prices:
    """Prices of the lowest mean risk among those that keep the budget on every tuning route.

    Args:
        searched: of `search_prices`.
        tried: its candidates.
        budget_kb: payload per route, KB of 1,024 bytes.

    Returns:
        Prices [codes, K] each; where nothing keeps the budget, those that spend least.
    """
    most_kb = searched.most_kb.max("seed").transpose("code", "k", "candidate").values
    risk_m = searched.risk_m.mean("seed").transpose("code", "k", "candidate").values
    feasible = np.where(most_kb <= budget_kb, risk_m, np.inf)
    best = np.where(np.isfinite(feasible).any(axis=-1), feasible.argmin(axis=-1), most_kb.argmin(axis=-1))
    return Prices(*(np.asarray(leaf, np.float32)[best] for leaf in tried))

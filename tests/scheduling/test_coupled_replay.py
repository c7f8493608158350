"""Clients and queue together: every request is served once, the server is one, and arrivals feel the queue."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.control.actions import ACTIONS
from ovibjax.control.client_state import ControlParams
from ovibjax.control.controller import make_controller
from ovibjax.control.environment import Route, draw, make_environment
from ovibjax.control.route_replay import simulate
from ovibjax.scheduling.coupled_replay import CoupledParams, CoupledResult, CoupledRules, Fleet, replay_coupled
from ovibjax.scheduling.rules import default_params
from ovibjax.scheduling.shared_queue import Mission

SLOTS = 40
MANY = 60  # for every test, as each number of clients is a program of its own


def make_params(**changes: float) -> ControlParams:
    control = make_controller(ACTIONS, 2.0, 2.0, 1.0, 1.0, budget_kb=1e6)
    return ControlParams(make_environment()._replace(**{k: jnp.float32(v) for k, v in changes.items()}), control)


def make_routes(n: int) -> Route:
    rng = np.random.default_rng(5)
    context = np.tile(rng.integers(0, 3, SLOTS).astype(np.int32), (n, 1))
    predicted = np.full((n, SLOTS, len(ACTIONS)), 2.0, np.float32)
    residual = rng.normal(0, 1.4, (n, SLOTS, len(ACTIONS), 2)).astype(np.float32)
    yaw = np.zeros((n, SLOTS), np.float32)
    return Route(*(jnp.asarray(x) for x in (context, yaw, predicted, residual, predicted)))


@partial(jax.jit, static_argnames=("n", "scheduler"))
def replay(n: int, params: ControlParams, routes: Route, scheduler: str) -> CoupledResult:
    keys = jax.vmap(lambda i: jax.random.fold_in(jax.random.key(1), i))(jnp.arange(n))
    draws = jax.vmap(lambda key, route: draw(key, route, params.env, ACTIONS))(keys, routes)
    mission = Mission(jnp.linspace(0.5, 1.5, n), jnp.full(n, 300.0))
    numbers = CoupledParams(params, default_params())
    return replay_coupled(jax.random.key(2), Fleet(draws, routes, mission), numbers, CoupledRules("voi", scheduler))


@pytest.mark.parametrize("scheduler", ["fifo", "voi_lyapunov"])
def test_every_request_is_served_once_by_one_server(scheduler: str) -> None:
    n = MANY
    result = jax.device_get(replay(n, make_params(), make_routes(n), scheduler))
    sent, served = result.info.sent, result.served
    assert sent.sum() > n
    # At most one under way: sent and served alternate, and what is left at the end was sent at the end.
    under_way = np.cumsum(sent, axis=0) - np.cumsum(served, axis=0)
    assert under_way.min() >= 0 and under_way.max() <= 1
    assert under_way[-1].sum() <= n
    # Ends of service, on one clock: a service begins no earlier than the one before it ends.
    edge, response = result.edge_ms[served], result.response_ms[served]
    assert (edge > 12.0).all() and (response > edge).all()
    return_ms = float(make_params().env.return_ms)
    sent_slot = np.where(sent, np.arange(SLOTS)[:, None], -1)
    last_sent = np.maximum.accumulate(sent_slot, axis=0)[served]
    finish = 500.0 * last_sent + response - return_ms
    order = np.argsort(finish)
    assert (np.diff(finish[order]) > 12.0 - 0.1).all()


def test_a_client_alone_corrects_as_in_the_decoupled_replay() -> None:
    params = make_params(queue_median_ms=1e-6, queue_sigma=0.0)
    result = jax.device_get(replay(1, params, make_routes(1), "fifo"))
    route = jax.tree.map(lambda leaf: leaf[0], make_routes(1))
    key = jax.random.fold_in(jax.random.key(1), 0)
    drawn = jax.jit(draw, static_argnames="actions")(key, route, params.env, ACTIONS)
    alone = jax.device_get(jax.jit(simulate, static_argnames="policy")(drawn, route, "voi", params))
    np.testing.assert_array_equal(result.info.sent[:, 0], alone.sent)
    np.testing.assert_array_equal(result.info.action[:, 0][alone.sent], alone.action[alone.sent])
    np.testing.assert_allclose(result.info.error_m[:, 0], alone.error_m, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(result.info.risk_m[:, 0], alone.risk_m, rtol=1e-4, atol=1e-4)


def test_arrivals_feel_the_queue() -> None:
    alone = jax.device_get(replay(1, make_params(), make_routes(1), "fifo"))
    priced = make_params()
    many = jax.device_get(replay(MANY, priced, make_routes(MANY), "fifo"))
    assert many.edge_ms[many.served].mean() > 3 * alone.edge_ms[alone.served].mean()
    assert many.backlog_ms.max() > alone.backlog_ms.max()
    # A price on delay keeps requests away while the edge is busy.
    dear = priced._replace(
        control=priced.control._replace(prices=priced.control.prices._replace(delay_m_per_s=jnp.float32(200.0)))
    )
    fewer = jax.device_get(replay(MANY, dear, make_routes(MANY), "fifo"))
    assert fewer.info.sent.sum() < many.info.sent.sum()

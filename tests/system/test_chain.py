"""The whole chain: stages against their own references, conservation between them, a point alone against the grid."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.control.actions import ActionSet, SweptActions
from ovibjax.control.calibration import calibrated_risk_m, fit_calibration
from ovibjax.control.predictor import fit_predictor
from ovibjax.control.residuals import answers, encode_views
from ovibjax.edge.service import EDGE
from ovibjax.encoder.checkpoint import Checkpoint
from ovibjax.features.basis import ViewBasis
from ovibjax.features.frames import make_feature_set
from ovibjax.link.payload import request_bytes
from ovibjax.scheduling.queue_replay import waits
from ovibjax.system import chain, stages
from ovibjax.system.data import SystemSize, make_system
from ovibjax.system.grids import sweep_system
from ovibjax.views import MODES, mode_mask

SLOTS = 80
KS, VS = (4, 8), (0.0, 8.0, 64.0)
SIZE = SystemSize(steps=6, mixed=64, rank=6, clients=2, fleet=3, kb_per_s=4.0, batch=16)


def drive(seed, n=SLOTS):
    """Frames along a bent line; features are smooth functions of the place."""
    rng = np.random.default_rng(seed)
    t = 3.0 * np.arange(n)
    positions_m = np.stack([t, 20 * np.sin(t / 40 + seed), np.full(n, 20.0)], axis=1).astype(np.float32)
    mix = np.random.default_rng(0).normal(size=(3, 5 * 16)) / 30
    features = np.sin(positions_m @ mix) + 0.02 * rng.normal(size=(n, 80))
    return make_feature_set(
        features.reshape(n, 5, 16),
        positions_m,
        yaw_rad=np.zeros(n),
        context=np.arange(n) // 10 % 3,
    )


@pytest.fixture(scope="module")
def scene():
    return [drive(seed) for seed in range(3)], 1, SIZE


@pytest.fixture(scope="module")
def made(scene):
    data, static = make_system(*scene)
    arch = replace(static.train.arch, latent=16, hidden=24, last_hidden=16)
    static = replace(static, train=replace(static.train, arch=arch, prefixes=(4, 8, 16)), requests=SLOTS)
    # Eager clients, so that there is something to conserve.
    cheap = {"bandwidth_m_per_s": jnp.float32(2.0), "delay_m_per_s": jnp.float32(2.0)}
    control = data.control._replace(prices=data.control.prices._replace(**cheap))
    drift = data.env.drift._replace(rate_m_per_s=6.0 * data.env.drift.rate_m_per_s)
    env = data.env._replace(drift=drift)
    return data._replace(control=control, env=env), static


compiled = jax.jit(chain.along, static_argnames="static")
serve = jax.jit(stages.serve, static_argnames="static")


@partial(jax.jit, static_argnames="static")
def arrivals(key, history, routes, k, data, static):
    return stages.arrivals(key, history, routes, SweptActions(modes=static.modes, k=k), data, static)


@pytest.fixture(scope="module")
def point():
    return {"beta": jnp.float32(1e-3), "gamma": jnp.float32(0.1)}


@pytest.fixture(scope="module")
def found(made, point):
    data, static = made
    out = compiled(jax.random.key(7), point, jnp.array(KS, jnp.int32), jnp.array(VS, jnp.float32), data, static)
    return {name: np.asarray(value) for name, value in out.items()}


@pytest.fixture(scope="module")
def staged(made, point):
    """The same chain at the second prefix, stage by stage."""
    data, static = made

    @jax.jit
    def chain(key, k, data):
        train_key, route_key, queue_key = jax.random.split(key, 3)
        params = stages.train(train_key, point, data, static)
        masks = jnp.stack([mode_mask(mode, 5) for mode in static.modes])
        codes = jax.lax.map(
            lambda mask: encode_views(params, data.x.reshape(len(data.x), -1), mask, static.train.arch), masks
        )
        actions = SweptActions(modes=static.modes, k=k)
        routes, _residual_m = stages.localize(params, codes, masks, k, data, static)
        history, _free_kb = stages.replay_clients(route_key, routes, actions, data, static)
        return params, routes, history, stages.arrivals(queue_key, history, routes, actions, data, static)

    return jax.device_get(chain(jax.random.key(7), jnp.int32(KS[1]), data))


@pytest.mark.long
def test_metrics_have_the_dimensions_they_say(found):
    sizes = {"k": len(KS), "V": len(VS), "scheduler": 5}
    assert set(found) == set(chain.DIMS) and set(chain.UNITS) <= set(found)
    for name, dims in chain.DIMS.items():
        assert found[name].shape == tuple(sizes[dim] for dim in dims), name
        assert np.isfinite(found[name]).all(), name


def test_residuals_and_g_psi_are_those_of_the_control_study(made, staged):
    data, static = made
    params, routes, _, _ = staged
    identity = ViewBasis(np.zeros((5, 6)), np.broadcast_to(np.eye(6), (5, 6, 6)), np.float32(1.0), np.ones(5))
    checkpoint = Checkpoint(params, identity, static.train.arch)
    actions = ActionSet(static.modes, (KS[1],))
    x, positions_m = np.asarray(data.x), np.asarray(data.positions_m)
    found = answers(checkpoint, x, positions_m, np.asarray(data.survey.rows), actions)
    rows, known, context = (np.asarray(part) for part in (data.routes, data.known, data.context))
    np.testing.assert_allclose(routes.residual_m, found.residual_m[rows], atol=1e-4)
    length = np.linalg.norm(found.residual_m, axis=-1)
    np.testing.assert_allclose(
        routes.predicted_m, fit_predictor(length[known], context[known], 3)[context[rows]], atol=1e-4
    )
    risk = calibrated_risk_m(fit_calibration(found.distinctness, length**2, known), found.distinctness)
    np.testing.assert_allclose(routes.risk_m, np.asarray(risk)[rows], rtol=1e-3)


@pytest.mark.long
def test_the_metrics_add_up_to_what_was_sent(made, staged, found):
    history = staged[2]
    sent = history.sent.sum(axis=1)
    np.testing.assert_array_equal(found["unserved"], 0)
    np.testing.assert_allclose(found["requests"][1], sent.mean())
    np.testing.assert_allclose(found["kb"][1], history.payload_bytes.sum(axis=1).mean() / 1024, rtol=1e-6)
    np.testing.assert_allclose(found["mean_route_m"][1], history.error_m.mean(), rtol=1e-5)


def test_every_request_reaches_its_server_once_and_no_byte_is_lost(made, staged):
    data, static = made
    _, _, history, workload = staged
    sent = history.sent.sum(axis=1)
    assert sent.min() > 3
    fleet = np.asarray(data.fleet)
    np.testing.assert_array_equal(workload.requests.valid.sum(axis=1), sent[fleet[:, 0]] * fleet.shape[1])
    views = np.array([len(MODES[mode]) for mode in static.modes])
    expected = request_bytes(KS[1], views[history.action]) * history.sent
    np.testing.assert_array_equal(history.payload_bytes, expected)
    # A client of a fleet has the requests of the one it follows, in their order from one of them on and around.
    for server, members in enumerate(fleet):
        for n, which in enumerate(members):
            rows = slice(n * static.requests, (n + 1) * static.requests)
            valid = workload.requests.valid[server, rows]
            slots = np.flatnonzero(history.sent[which])
            mine, own = workload.requests.voi_m[server, rows][valid], np.asarray(history.voi_m[which])[slots]
            around = [np.resize(np.roll(own, -shift), len(mine)) for shift in range(len(own))]
            assert any(np.array_equal(mine, each) for each in around)
            assert np.ptp(workload.requests.urgency[server, rows]) == 0
    # Too little room for requests is not silent.
    tight = replace(static, requests=2)
    few = arrivals(jax.random.key(0), history, staged[1], jnp.int32(8), data, tight)
    lost = serve(few, history, jnp.ones(1), data, replace(tight, schedulers=("fifo",)))["unserved"]
    assert int(lost[0, 0]) == int((sent[fleet[:, 0]] * fleet.shape[1]).sum()) - 2 * fleet.size


def test_an_idle_server_adds_its_service_time_alone(made, staged):
    data, static = made
    history, routes = staged[2], staged[1]
    # Without phases a client's requests are a slot apart, and a slot is longer than a service.
    trace = data.trace._replace(phase_spread_s=jnp.float32(0.0))
    far = data._replace(fleet=jnp.array([[0]], jnp.int32), trace=trace)
    workload = arrivals(jax.random.key(1), history, routes, jnp.int32(KS[1]), far, static)
    one = jax.tree.map(lambda leaf: leaf[0], workload)
    valid = np.asarray(one.requests.valid)
    np.testing.assert_array_equal(np.asarray(waits(one.requests, "fifo", data.scheduler))[valid], 0.0)
    judged = serve(workload, history, jnp.ones(1), far, replace(static, schedulers=("fifo",)))
    expected = np.percentile(np.asarray(one.requests.service_ms)[valid], 95)
    np.testing.assert_allclose(judged["all_edge_p95_ms"], [[expected]], rtol=1e-5)
    floor_ms = float(EDGE.decode_ms + EDGE.retrieve_ms + EDGE.runtime_ms)
    assert np.asarray(one.requests.service_ms)[valid].min() > floor_ms


@pytest.mark.long
def test_a_point_alone_equals_the_grid(made, point, found):
    data, static = made
    alone = jax.jit(chain.run, static_argnames="static")
    for i, k in enumerate(KS):
        p = 1 + i
        at = point | {"k": jnp.int32(k), "V": jnp.float32(VS[p])}
        out = alone(jax.random.key(7), at, data, static)
        for name, value in out.items():
            expected = found[name][i] if chain.DIMS[name] == ("k",) else found[name][i, p]
            np.testing.assert_allclose(value, expected, rtol=1e-4, err_msg=name)


@pytest.mark.long
def test_a_grid_is_one_program_and_holds_every_point(scene, tmp_path):
    axes = {"beta": [1e-3, 1e-1], "gamma": [0.1], "seed": [100, 101]}
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, seconds, **kwargs: compiled.append(seconds) if "backend_compile" in event else None
    )
    try:
        grid = sweep_system(scene, axes, (KS, VS, ("fifo", "base_dpp")), store=tmp_path / "grid.zarr")
    finally:
        jax.monitoring.clear_event_listeners()
    assert sum(seconds > 2.0 for seconds in compiled) == 1
    assert grid.top_cost.dims == ("beta", "gamma", "seed", "k", "V", "scheduler") and bool(grid.finished.all())
    assert float(np.ptp(grid.mean_route_m.values)) > 0
    alone = sweep_system(scene, {"beta": [1e-1], "gamma": [0.1], "seed": [101]}, ((8,), (8.0,), ("base_dpp",)))
    for name, values in alone.data_vars.items():
        if name in chain.DIMS:
            same = grid[name].sel({dim: alone[dim] for dim in values.dims})
            np.testing.assert_allclose(values, same, rtol=1e-4, err_msg=str(name))

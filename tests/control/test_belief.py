"""The belief: drift and fusion against 2x2 matrices, and a risk that says what the error is."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.control import belief, client_step
from ovibjax.control import route_replay as replay
from ovibjax.control.actions import ACTIONS
from ovibjax.control.belief import Belief, Fix
from ovibjax.control.client_state import ControlParams, start
from ovibjax.control.drift import DRIFT_MODELS
from ovibjax.control.environment import Route, draw, make_environment, rates_from_paper
from tests.control.cases import PREDICTED, controller, environment
from tests.oracles import control as oracle

correct = jax.jit(belief.correct)
number = st.floats(-1.0, 1.0, width=32)


def of(error, cov):
    return Belief(*(jnp.float32(x) for x in (*error, cov[0, 0], cov[0, 1], cov[1, 1], 7.0, 1.0, 0.0)))


def parts(b):
    b = jax.tree.map(lambda x: np.asarray(x, np.float64), b)
    return np.array([b.error_x_m, b.error_y_m]), np.array([[b.cov_xx_m2, b.cov_xy_m2], [b.cov_xy_m2, b.cov_yy_m2]])


@settings(max_examples=200, deadline=None)
@given(
    st.tuples(number, number, number, number),
    st.tuples(st.floats(0.05, 200.0), st.floats(0.05, 200.0), st.floats(0.0, np.pi)),
    st.sampled_from([0.0, 0.3, 2.0, 9.0, 60.0, 5000.0]),
    st.sampled_from([0.5, 3.0, np.inf]),
)
def test_correction_is_the_textbook_update(vectors, shape, risk, gate):
    big, small, angle = shape
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    cov = (turn @ np.diag([big, small]) @ turn.T).astype(np.float32)
    error, residual = 12.0 * np.float32(vectors[:2]), 12.0 * np.float32(vectors[2:])
    want_error, want_cov, accepted = oracle.kalman(
        error.astype(np.float64), cov.astype(np.float64), residual.astype(np.float64), risk, gate
    )
    innovation = (residual - error).astype(np.float64)
    distance = innovation @ np.linalg.solve(cov + oracle.noise_of(risk), innovation)
    if abs(distance - gate**2) < 1e-3 * gate**2:
        return  # on the gate itself rounding decides
    fix = Fix(*map(jnp.float32, (*residual, risk, 0.6, 0.8)))
    better, taken, got = (correct(of(error, cov), fix, jnp.int32(i), jnp.float32(gate)) for i in range(3))
    got_error, got_cov = parts(got)
    fresh = (0.0, np.float32(0.6), np.float32(0.8)) if accepted else (7.0, 1.0, 0.0)
    used = accepted and risk < np.sqrt(np.trace(cov))
    assert jax.tree.map(float, better) == jax.tree.map(float, taken if used else of(error, cov))
    for after in (got, taken):
        assert (after.accumulated_m, after.toward_x, after.toward_y) == fresh
    if accepted:
        np.testing.assert_array_equal(parts(taken)[0], residual.astype(np.float64))
        np.testing.assert_allclose(parts(taken)[1], oracle.noise_of(risk), rtol=1e-6)
    # The determinant of a float32 covariance is known to its condition number times the unit roundoff.
    noise = oracle.noise_of(risk)[0, 0]
    slack_m = 12.0 * 4e-7 * (max(big, small) + noise) / (min(big, small) + noise)
    np.testing.assert_allclose(got_error, want_error, rtol=1e-4, atol=1e-3 + slack_m)
    np.testing.assert_allclose(got_cov, want_cov, rtol=2e-3, atol=1e-5 * big)
    assert accepted or np.array_equal(got_error, error.astype(np.float64))
    if accepted:
        assert np.trace(got_cov) <= np.trace(cov) * (1 + 1e-5) and np.all(np.linalg.eigvalsh(got_cov) > 0)


def test_risk_and_error():
    b = of([3.0, -4.0], np.array([[5.0, 1.0], [1.0, 11.0]]))
    assert float(belief.local_risk_m(b)) == 4.0 and float(belief.error_m(b)) == 5.0
    start = belief.initial(jnp.float32(3.0), jnp.array([1.0, -2.0]), jnp.array([0.0, 1.0]))
    np.testing.assert_allclose(parts(start)[0], 3 / np.sqrt(2) * np.array([1, -2]), rtol=1e-6)
    np.testing.assert_allclose(parts(start)[1], 4.5 * np.eye(2), rtol=1e-6)


@pytest.fixture(scope="module")
def realizations():
    """Errors and beliefs of 6,000 clients whose residuals come from the measurement model, with late corrections."""
    slots, count = 60, 6000
    context = np.repeat([0, 2, 1, 0, 2, 1], 10).astype(np.int32)
    predicted = jnp.asarray(PREDICTED[context], jnp.float32)
    yaw = jnp.full(slots, 0.6)

    def one(key, env, control):
        keys = jax.random.split(jax.random.fold_in(key, 7))
        # Found and not found: what comes with an answer tells which, and its mean square is that risk's square.
        risk = jnp.where(jax.random.bernoulli(keys[0], 0.2, predicted.shape), 14.0, predicted)
        residual = jax.random.normal(keys[1], (*predicted.shape, 2)) * risk[..., None] / jnp.sqrt(2.0)
        route = Route(context, yaw, predicted, residual, risk)
        draws = draw(key, route, env, ACTIONS)
        slots_in = replay.slots_of(route, draws, jnp.zeros(slots, bool))

        def step(state, slot):
            state, info = client_step.step(state, slot, "voi", ControlParams(env, control), ACTIONS)
            return state, (state.belief, info)

        return jax.lax.scan(step, start(draws), slots_in)[1]

    # Here the arrays are large: optimized code saves more than its making costs.
    many = jax.jit(jax.vmap(one, (0, None, None)), compiler_options={"xla_backend_optimization_level": 1})
    return lambda env, control: many(jax.random.split(jax.random.key(11), count), env, control)


@pytest.mark.parametrize("correction", range(len(belief.CORRECTIONS)), ids=belief.CORRECTIONS)
@pytest.mark.parametrize("model", DRIFT_MODELS)
@pytest.mark.parametrize("case", ["no requests", "prompt", "late"])
def test_risk_is_calibrated(realizations, case, model, correction):
    changes = (
        {"mean_kb_per_s": 0.4, "snr": 0.5, "rician_k_factor": 0.0, "queue_median_ms": 400.0} if case == "late" else {}
    )
    env = environment(rate_m_per_s=[0.3, 0.9, 1.8], model=model, **changes)
    control = controller(
        budget_bytes=0.0 if case == "no requests" else 1e9,
        prices=dict.fromkeys(("bandwidth_m_per_s", "delay_m_per_s"), 0.3 if case == "late" else 8.0),
        correction=correction,
    )
    beliefs, info = realizations(env, control)
    beliefs, info = (jax.tree.map(lambda x: np.asarray(x, np.float64), part) for part in (beliefs, info))
    requests = info.sent.sum(axis=1).mean()
    assert requests == 0 if case == "no requests" else requests > 4
    if case == "late":
        assert (info.latency_s[info.sent > 0] > 1.0).mean() > 0.3
    squared, trace = info.error_m**2, info.risk_m**2
    # Thirds of the route apart: calibrated before, between and after requests, within each client's own belief.
    for part in np.array_split(np.arange(squared.shape[1]), 3):
        assert squared[:, part].mean() == pytest.approx(trace[:, part].mean(), rel=0.05)
    high = trace > np.median(trace, axis=0)
    assert squared.mean() == pytest.approx(trace.mean(), rel=0.03)
    if requests:
        assert squared[high].mean() == pytest.approx(trace[high].mean(), rel=0.05)
    # The whole matrix, not the trace alone.
    scale = trace.mean()
    pairs = (
        (beliefs.error_x_m**2, beliefs.cov_xx_m2),
        (beliefs.error_x_m * beliefs.error_y_m, beliefs.cov_xy_m2),
        (beliefs.error_y_m**2, beliefs.cov_yy_m2),
    )
    for product, cov in pairs:
        assert product.mean() == pytest.approx(cov.mean(), abs=0.03 * scale)
    assert model != "random_walk" or requests or beliefs.cov_xy_m2.mean() > 0.1 * scale  # the heading leaves its mark


def test_draws_have_the_stated_distribution():
    slots = 20_000
    context = np.tile([0, 1, 2, 2], slots // 4).astype(np.int32)
    flat = jnp.zeros((slots, 1))
    route = Route(context, jnp.full(slots, 0.3), flat, flat, flat)
    env = environment(rate_m_per_s=[1.0, 4.0, 9.0], queue_sigma=0.5)
    draws = jax.tree.map(np.asarray, jax.jit(draw, static_argnames="actions")(jax.random.key(3), route, env, ACTIONS))
    for c, rate in enumerate((1.0, 4.0, 9.0)):
        np.testing.assert_allclose(draws.odometry.advance_m[context == c], rate * 0.5, rtol=1e-5)
    assert draws.rate_bps.mean() == pytest.approx(8 * 8192, rel=0.02) and draws.rate_bps.std() > 0
    # Client and edge: the report is one slot old; 20 ms median wait, service about 16 ms, 5 ms to return.
    service = np.array([1.2 + 0.4 * views for views in (1, 1, 3, 3, 4, 4, 5, 5)]) + 3.1 + 5.2 + 4.0
    waits = draws.delay_s - (service + 2.2 + 5.0) / 1e3
    np.testing.assert_allclose(waits, np.broadcast_to(waits[:, :1], waits.shape), atol=1e-6)
    assert waits[0, 0] == pytest.approx(0.020, rel=1e-3)
    logs = np.log(waits[1:, 0] / 0.020)
    assert logs.std() == pytest.approx(0.5, rel=0.1) and abs(logs.mean()) < 0.1
    assert np.corrcoef(logs[1:], logs[:-1])[0, 1] == pytest.approx(0.9, abs=0.02)
    encode = np.where(np.arange(8) % 2 == 0, 31.7, 32.3)
    jitter = draws.latency_s[:-1] * 1e3 - waits[1:, :1] * 1e3 - service - encode - 5.0
    np.testing.assert_allclose(np.median(jitter, axis=0), 2.2, rtol=0.05)
    np.testing.assert_allclose(np.log(jitter).std(axis=0), 0.5, rtol=0.05)
    assert np.array_equal(np.sort(draws.rank), np.arange(slots)) and 0 <= draws.phase_s < 1


@settings(max_examples=50)
@given(st.tuples(*[st.floats(0.01, 1.0)] * 3))
def test_drift_spends_the_papers_budget(weights):
    share = np.array(weights) / sum(weights)
    rates = np.asarray(rates_from_paper(share), np.float64)
    # 22 requests, between which sqrt(36 - 9) m are added, over 593 slots of half a second.
    assert rates @ share * 593 * 0.5 == pytest.approx(22 * (36 - 9) ** 0.5, rel=1e-5)
    np.testing.assert_allclose(rates / rates[0], np.array([0.5, 5.7, 14.0]) / 0.5, rtol=1e-5)
    scaled = make_environment(share, drift_scale=2.0).drift.rate_m_per_s
    np.testing.assert_allclose(scaled, 2 * rates, rtol=1e-5)

"""Drift models: equal to the oracle, what they add as stated, and refused by name."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.control import belief
from ovibjax.control.drift import DRIFT_MODELS, added_m2, draw_odometry, make_drift
from ovibjax.errors import InputError
from tests.oracles import control as oracle

RATES, SCALE_M = [0.1, 0.7, 2.0], 5.0


def test_an_unknown_model_is_refused():
    with pytest.raises(InputError, match="'steps' is unknown; it must be one of rate, integrated, random_walk"):
        make_drift(RATES, SCALE_M, "steps")


@pytest.mark.parametrize("model", DRIFT_MODELS)
def test_what_drift_adds(model):
    drift = make_drift(RATES, SCALE_M, model)
    assert float(added_m2(jnp.float32(SCALE_M), drift)) == pytest.approx(SCALE_M**2, rel=1e-6)  # where models agree
    assert float(added_m2(jnp.float32(0.0), drift)) == 0.0
    growth = np.sqrt(float(added_m2(jnp.float32(4 * SCALE_M), drift))) / SCALE_M
    assert growth == pytest.approx({"rate": 4.0, "integrated": 8.0, "random_walk": 2.0}[model], rel=1e-6)
    s_m = np.float32([0.01, 0.7, 3.0, 90.0])
    want = (SCALE_M * (s_m / SCALE_M) ** DRIFT_MODELS[model]) ** 2
    np.testing.assert_allclose(added_m2(jnp.asarray(s_m), drift), want, rtol=1e-5)


@pytest.mark.parametrize("model", DRIFT_MODELS)
def test_odometry_is_the_oracles_and_has_the_covariance_it_states(model):
    slots, count = 12, 4000
    rng = np.random.default_rng(0)
    context, yaw = rng.integers(0, 3, slots).astype(np.int32), jnp.asarray(rng.normal(size=slots), jnp.float32)
    drift = make_drift(RATES, SCALE_M, model)

    def one(key):
        odometry, toward = draw_odometry(key, context, yaw, jnp.float32(0.5), drift)
        begin = belief.initial(jnp.float32(0.0), jnp.zeros(2), toward)

        def step(b, slot):
            b = belief.propagate(b, slot, drift)
            return b, b

        return odometry, begin, jax.lax.scan(step, begin, odometry)[1]

    odometry, begin, beliefs = jax.tree.map(
        np.asarray, jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(0), count))
    )
    advance = np.array(RATES)[context] * 0.5
    np.testing.assert_allclose(odometry.advance_m, np.tile(advance, (count, 1)), rtol=1e-6)
    np.testing.assert_allclose(odometry.toward_x**2 + odometry.toward_y**2, 1.0, rtol=1e-5)
    numbers = {"scale": SCALE_M, "power": DRIFT_MODELS[model], "walks": model == "random_walk"}
    share = 0.8 if model == "random_walk" else 0.5
    covs = np.stack([oracle.walk(share, float(a), np.zeros(2))[1] for a in yaw])
    for n in range(5):
        draws = {"advance": advance, "walk_cov": covs, "walk": np.stack([odometry.walk_x[n], odometry.walk_y[n]], -1)}
        now = np.zeros(2), np.zeros((2, 2)), 0.0, np.array([begin.toward_x[n], begin.toward_y[n]])
        for t in range(slots):
            now = oracle.drifted(now, t, draws, numbers)
            got = jax.tree.map(lambda leaf, n=n, t=t: float(leaf[n, t]), beliefs)
            np.testing.assert_allclose([got.error_x_m, got.error_y_m], now[0], rtol=1e-3, atol=1e-4)
            want = (now[1][0, 0], now[1][0, 1], now[1][1, 1])
            np.testing.assert_allclose([got.cov_xx_m2, got.cov_xy_m2, got.cov_yy_m2], want, rtol=1e-3, atol=1e-4)
    errors = np.stack([beliefs.error_x_m[:, -1], beliefs.error_y_m[:, -1]])
    stated = np.array(
        [
            [x[0, -1] for x in row]
            for row in ((beliefs.cov_xx_m2, beliefs.cov_xy_m2), (beliefs.cov_xy_m2, beliefs.cov_yy_m2))
        ]
    )
    np.testing.assert_allclose(errors @ errors.T / count, stated, atol=0.05 * np.trace(stated))
    # A walk of independent steps in the frame of travel, drawn as the oracle has it.
    assert (odometry.walk_x**2 + odometry.walk_y**2).mean() == pytest.approx(1.0, rel=0.03)

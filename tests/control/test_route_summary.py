"""Sums over a replay against its history."""

import jax
import numpy as np
import pytest

from ovibjax.control.actions import ACTIONS
from ovibjax.control.route_summary import score, summarize
from tests.control.cases import draw_jit, make_route, simulate, world


@pytest.mark.parametrize("policy", ["voi", pytest.param("periodic", marks=pytest.mark.long)])
def test_score_equals_the_summary_of_the_history(policy):
    params, route = world("weak link"), make_route(6)
    keys = jax.random.split(jax.random.key(6), 3)

    def one(key):
        draws = draw_jit(key, route, params.env, ACTIONS)
        return score(draws, route, policy, params)

    scores = jax.jit(jax.vmap(one))(keys)
    for i, key in enumerate(keys):
        history = simulate(draw_jit(key, route, params.env, ACTIONS), route, policy, params)
        summary = summarize(history)
        for name in ("mean_m", "risk_m", "requests", "kb"):
            np.testing.assert_allclose(getattr(scores, name)[i], getattr(summary, name), rtol=1e-4, err_msg=name)
        assert np.isnan(scores.p95_m[i]) and int(summary.requests) > 0
        errors = np.asarray(history.error_m, np.float64)
        np.testing.assert_allclose(summary.mean_m, errors.mean(), rtol=1e-5)
        np.testing.assert_allclose(summary.p95_m, np.percentile(errors, 95), rtol=1e-5)
        assert float(summary.kb) == np.asarray(history.payload_bytes).sum() / 1024

"""Every policy in one replay: the same histories as a program of its own gives each."""

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.control.actions import ACTIONS
from ovibjax.control.client_state import ControlParams
from ovibjax.control.policies import POLICIES
from ovibjax.control.policy_rows import FIRST, SECOND, Rules, replay_rows
from ovibjax.control.route_replay import replay_draws
from tests.control.cases import QUICK_RULES, controller, draw_jit, environment, make_route


def test_rows_are_the_replays_of_their_policies():
    env, route = environment(initial_risk_m=5.0123), make_route(3, 24)
    control = controller(rules=QUICK_RULES, budget_bytes=jnp.float32(800.0))
    gap = control._replace(threshold_m=jnp.float32(0.5), min_gap_s=jnp.float32(1.5))
    tuned = control._replace(rules=control.rules._replace(uncertainty_gap_s=jnp.float32(2.5)))
    draws = draw_jit(jax.random.key(5), route, env, ACTIONS)
    rows = jax.jit(replay_rows, static_argnames="actions")(draws, route, env, Rules(control, gap, tuned), ACTIONS)
    assert set(rows) == {*POLICIES, "tuned_uncertainty", "voi_uncapped"} == {*FIRST, *SECOND}
    uncapped = control._replace(budget_bytes=jnp.float32(jnp.inf))
    own = {"voi_gap": gap, "tuned_uncertainty": tuned, "voi_uncapped": uncapped}
    for name, row in rows.items():
        policy = {"tuned_uncertainty": "uncertainty", "voi_uncapped": "voi"}.get(name, name)
        alone = replay_draws(draws, route, policy, ControlParams(env, own.get(name, control)))
        np.testing.assert_array_equal(row.sent, alone.sent, err_msg=name)
        np.testing.assert_array_equal(row.action[row.sent], alone.action[alone.sent], err_msg=name)
        np.testing.assert_allclose(row.error_m, alone.error_m, rtol=1e-5, err_msg=name)
    assert rows["voi"].sent.sum() < rows["voi_uncapped"].sent.sum()  # the budget has a say
    assert len({np.asarray(row.sent).tobytes() for row in rows.values()}) >= 8

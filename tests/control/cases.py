"""Synthetic drives, routes, worlds and controllers, and their translation for the oracle."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.control import route_replay as replay
from ovibjax.control.actions import ACTIONS
from ovibjax.control.belief import CORRECTIONS
from ovibjax.control.client_state import ControlParams
from ovibjax.control.controller import make_controller
from ovibjax.control.environment import Route, draw, make_environment
from ovibjax.control.planning import FOLLOW_VOI, plan
from ovibjax.control.policies import POLICIES
from ovibjax.encoder.checkpoint import CheckpointConfig
from ovibjax.features.frames import FeatureSet
from tests.oracles import control as oracle

SLOTS = 60
TINY = CheckpointConfig(rank=8, steps=20, batch=32, mixed=64, hidden=32, last_hidden=16)
PREDICTED = np.array(
    [[8, 7, 3, 2.5, 2.8, 2.3, 2.6, 2.2], [12, 11, 5, 4.5, 4, 3.5, 3, 2.5], [9, 8, 2, 1.9, 4, 3.9, 5, 0]]
)


def make_route(seed, slots=SLOTS, actions=8):
    """Contexts that last a few slots, a wandering heading, residuals with look-alikes far away, some of them told."""
    rng = np.random.default_rng(seed)
    context = np.repeat(rng.integers(0, 3, slots), rng.integers(1, 12, slots))[:slots]
    predicted = PREDICTED[context][:, :actions]
    residual = rng.normal(size=(slots, actions, 2)) * (predicted[..., None] / np.sqrt(2) + 0.1)
    residual += 40.0 * (rng.random((slots, actions, 1)) < 0.1) * rng.normal(size=(slots, actions, 2))
    yaw = np.cumsum(rng.normal(scale=0.3, size=slots))
    risk = np.where(rng.random((slots, actions)) < 0.2, 25.0, 1.3 * predicted + 0.07)
    fields = (yaw, predicted, residual, risk)
    return Route(context.astype(np.int32), *(jnp.asarray(x, jnp.float32) for x in fields))


def drive(seed, n=120, views=5, d=24, known=1.0):
    """A drive along a curve; features are smooth functions of the position."""
    rng = np.random.default_rng(seed)
    yaw = np.cumsum(rng.normal(scale=0.05, size=n)).astype(np.float32)
    steps = 1.6 * np.stack([np.cos(yaw), np.sin(yaw), np.zeros(n)], -1)
    place = np.cumsum(steps, axis=0).astype(np.float32)
    waves = np.random.default_rng(0)
    features = np.cos(0.05 * place[:, :2] @ waves.normal(size=(2, views * d)) + waves.uniform(0, 6, views * d))
    features = features.reshape(n, views, d)
    features = (features / np.linalg.norm(features, axis=-1, keepdims=True)).astype(np.float32)
    context = np.where(rng.random(n) < known, rng.integers(0, 3, n), -1).astype(np.int32)
    ids = np.array([f"{i:06d}" for i in range(n)])
    return FeatureSet(features, place, yaw, context, np.zeros(n, np.int32), ids)


def environment(**changes):
    """The default environment with some leaves changed, of `drift` the model and the rates."""
    env = make_environment(drift_model=changes.pop("model", "rate"))
    if "rate_m_per_s" in changes:
        env = env._replace(drift=env.drift._replace(rate_m_per_s=jnp.float32(changes.pop("rate_m_per_s"))))
    return env._replace(**{name: jnp.asarray(value, jnp.float32) for name, value in changes.items()})


def controller(actions=ACTIONS, **changes):
    """A controller with some leaves changed; `rules` and `prices` by their fields."""
    control = make_controller(actions, 2.0, 2.0, threshold_m=3.0, min_gap_s=2.0)
    for part in ("rules", "prices"):
        fields = {name: jnp.float32(v) for name, v in changes.pop(part, {}).items()}
        control = control._replace(**{part: getattr(control, part)._replace(**fields)})
    kinds = {name: {"available": bool, "correction": jnp.int32}.get(name, jnp.float32) for name in changes}
    return control._replace(**{name: jnp.asarray(value, kinds[name]) for name, value in changes.items()})


def for_oracle(draws, route, params, actions=ACTIONS):
    """Arguments of `oracle.replay` after the policy."""
    wide = partial(np.asarray, dtype=np.float64)
    up, control, drift = draws.odometry, params.control, params.env.drift
    start = draws.start

    def matrices(xx, xy, yy):
        return np.stack([wide(x) for x in (xx, xy, xy, yy)], -1).reshape(-1, 2, 2)

    world = {
        "start_error": wide([start.error_x_m, start.error_y_m]),
        "start_cov": matrices(start.cov_xx_m2, start.cov_xy_m2, start.cov_yy_m2)[0],
        "start_toward": wide([start.toward_x, start.toward_y]),
        "advance": wide(up.advance_m),
        "walk": np.stack([wide(up.walk_x), wide(up.walk_y)], -1),
        "walk_cov": matrices(up.cov_xx, up.cov_xy, 1.0 - wide(up.cov_xx)),
        "toward": np.stack([wide(up.toward_x), wide(up.toward_y)], -1),
        "rate": wide(draws.rate_bps),
        "delay": wide(draws.delay_s),
        "latency": wide(draws.latency_s),
        "rank": np.asarray(draws.rank),
        "phase": float(draws.phase_s),
    }
    numbers = {
        "prices": [float(p) for p in control.prices],
        "threshold": float(control.threshold_m),
        "gap": float(control.min_gap_s),
        "budget": float(control.budget_bytes),
        "energy": wide(control.energy_j),
        "energy_budget": float(control.energy_budget_j),
        "available": np.asarray(control.available),
        "correction": CORRECTIONS[int(control.correction)],
        "gate": float(control.gate_sigma),
        "period": float(control.rules.period_s),
        "fixed_front": (float(control.rules.fixed_front_risk_m), float(control.rules.fixed_front_gap_s)),
        "uncertainty": (float(control.rules.uncertainty_risk_m), float(control.rules.uncertainty_gap_s)),
    }
    return (
        world,
        {name: wide(getattr(route, f"{name}_m")) for name in ("predicted", "residual", "risk")}
        | {"context": np.asarray(route.context).tolist()},
        {
            "slot_s": float(params.env.slot_s),
            "timeout_s": float(params.env.timeout_s),
            "drift": {"scale": float(drift.scale_m), "power": float(drift.power), "walks": bool(drift.walks)},
        },
        numbers,
        oracle.action_list(actions.modes, actions.prefixes),
    )


_follow = jax.jit(replay.replay_schedule, static_argnames=("policy", "actions"))
_plan = jax.jit(plan, static_argnames="policy")
draw_jit = jax.jit(draw, static_argnames="actions")


def simulate(draws, route, policy, params, actions=ACTIONS):
    """`replay.simulate` from parts that are compiled once: VOI-Control for all, and one function for equal policies."""
    sent = np.zeros(draws.rate_bps.shape, bool)
    if policy in FOLLOW_VOI:
        sent = _follow(draws, route, "voi", sent, params, actions).sent
    same = next(name for name, function in POLICIES.items() if function is POLICIES[policy])
    return _follow(draws, route, same, _plan(draws, policy, params, sent), params, actions)


def both(policy, key, route, params, actions=ACTIONS):
    """A replay by the library, NumPy leaves, and by the oracle."""
    draws = draw_jit(key, route, params.env, actions)
    found = jax.tree.map(np.asarray, simulate(draws, route, policy, params, actions))
    return found, oracle.replay(policy, *for_oracle(draws, route, params, actions))


def assert_equal(found, expected):
    """Every decision equal, every number to float32's rounding over a route."""
    sent = expected["sent"]
    np.testing.assert_array_equal(found.sent, sent)
    np.testing.assert_array_equal(found.action[sent], expected["action"][sent])
    np.testing.assert_array_equal(found.payload_bytes, expected["payload"])
    for name in ("error_m", "risk_m", "risk_before_m"):
        np.testing.assert_allclose(getattr(found, name), expected[name[:-2]], rtol=2e-4, atol=1e-3, err_msg=name)
    np.testing.assert_allclose(found.latency_s[sent], expected["latency"][sent], rtol=1e-5)
    np.testing.assert_allclose(found.voi_m[sent], expected["voi"][sent], rtol=1e-4, atol=1e-4)


_REPLACE, ALWAYS, KALMAN = range(len(CORRECTIONS))
WEAK = {"mean_kb_per_s": 0.15, "snr": 0.05, "rician_k_factor": 0.0, "queue_median_ms": 300.0, "timeout_s": 2.6}
# No sum of these is a whole square: no risk ties with a rule's threshold.
BUSY = {"rate_m_per_s": [0.4137, 1.2219, 2.4341], "initial_risk_m": 5.0123}
EAGER = {"threshold_m": 0.5, "min_gap_s": 0.0, "prices": {"bandwidth_m_per_s": 0.2, "delay_m_per_s": 0.2}}
QUICK_RULES = {
    "period_s": 1.6,
    "fixed_front_risk_m": 3.0,
    "fixed_front_gap_s": 0.5,
    "uncertainty_risk_m": 4.0,
    "uncertainty_gap_s": 1.5,
}
WORLDS = {
    "paper": ({}, {}),
    "paper rules, much drift": (BUSY, {"threshold_m": 1.0}),
    "weak link": (BUSY | WEAK, EAGER | {"rules": QUICK_RULES, "budget_bytes": 1e6}),
    "random walk": (BUSY | WEAK | {"model": "random_walk"}, EAGER | {"rules": QUICK_RULES, "budget_bytes": 1e6}),
    "integrated": (BUSY | {"model": "integrated"}, EAGER | {"rules": QUICK_RULES, "budget_bytes": 1e6}),
    "kalman, weak link": (
        BUSY | WEAK | {"model": "random_walk"},
        EAGER | {"rules": QUICK_RULES, "budget_bytes": 1e6, "correction": KALMAN},
    ),
    "gate bites": (BUSY, EAGER | {"rules": QUICK_RULES, "budget_bytes": 1e6, "gate_sigma": 1.0, "correction": KALMAN}),
    "always": (BUSY, EAGER | {"rules": QUICK_RULES, "budget_bytes": 1e6, "correction": ALWAYS}),
    "gate of a replacement": (BUSY, EAGER | {"rules": QUICK_RULES, "budget_bytes": 1e6, "gate_sigma": 1.0}),
    "tight budget": (BUSY, EAGER | {"rules": QUICK_RULES, "budget_bytes": 500.0}),
    "budget of one byte less": (BUSY, EAGER | {"rules": QUICK_RULES, "budget_bytes": 4 * 96.0 - 1.0}),
    "energy": (
        BUSY,
        EAGER
        | {"rules": QUICK_RULES, "prices": {"bandwidth_m_per_s": 0.2, "delay_m_per_s": 0.2, "energy_m_per_j": 0.7}}
        | {"energy_j": [0.25, 0.5, 0.75, 1.0, 1.0, 1.25, 2.0, 3.0], "energy_budget_j": 7.25, "budget_bytes": 1e6},
    ),
    "some unavailable": (
        BUSY,
        EAGER | {"rules": QUICK_RULES, "available": [1, 0, 1, 0, 1, 0, 0, 1], "budget_bytes": 1500.0},
    ),
    "long slots": (BUSY | WEAK | {"slot_s": 1.0}, EAGER | {"rules": QUICK_RULES}),
}


def world(name):
    """Parameters of a named world."""
    env, control = WORLDS[name]
    return ControlParams(environment(**env), controller(**control))

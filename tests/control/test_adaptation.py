"""What a robot learns of g_psi: the update against closed forms, a whole replay against the NumPy loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.control.actions import ACTIONS
from ovibjax.control.adaptation import (
    ADAPT,
    Asked,
    Heard,
    factors,
    fit_expected,
    learn,
    make_adaptation,
    nothing_learned,
)
from ovibjax.control.adaptive_replay import scan_adapted
from ovibjax.control.client_state import ControlParams
from ovibjax.control.route_replay import replay_draws, replay_schedule, slots_of
from ovibjax.errors import InputError
from tests.control.cases import PREDICTED, SLOTS, assert_equal, draw_jit, for_oracle, make_route, world
from tests.oracles.adaptation import Adapter
from tests.oracles.control import follow

KINDS = ADAPT[1:]
HARD = ("paper", "weak link", "always", "kalman, weak link", "tight budget", "some unavailable", "energy")


def adaptation_of(kind, every=3, expected_m=PREDICTED + 0.5):
    return make_adaptation(kind, expected_m, every)


def adapter_of(kind, params):
    numbers, (bandwidth, energy, delay) = params.adaptation, (float(p) for p in params.control.prices)
    energy_j = np.asarray(params.control.energy_j, np.float64)
    actions = [(mode, k, float(b)) for (mode, k), b in zip(_named(), ACTIONS.payload_bytes, strict=True)]

    def cost(action, rate, delay_s):
        return bandwidth * 8 * actions[action][2] / rate + energy * energy_j[action] + delay * delay_s

    values = {"weight": float(numbers.prior_weight), "keep": float(numbers.keep), "every": int(numbers.probe_every)}
    return Adapter(kind, values | {"expected": np.asarray(numbers.expected_m, np.float64)}, actions, cost)


def _named():
    return [(mode, k) for mode in ACTIONS.modes for k in ACTIONS.prefixes]


def changed_route(seed):
    """A route whose first view is suddenly right, and whose last actions are suddenly bad."""
    route, half = make_route(seed), SLOTS // 3
    scale = np.ones((SLOTS, 8))
    scale[half:, :2], scale[half:, 5:] = 0.1, 3.0
    changed = route.residual_m * scale[..., None], route.risk_m * scale
    return route._replace(residual_m=jnp.float32(changed[0]), risk_m=jnp.float32(changed[1]))


scan = jax.jit(scan_adapted, static_argnames=("policy", "actions", "adapt"))


def replayed(key, route, policy, params, kind):
    draws = draw_jit(key, route, params.env, ACTIONS)
    slots = slots_of(route, draws, jnp.zeros(SLOTS, bool))
    return draws, scan(draws, slots, route.context, policy, params, ACTIONS, kind)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("policy", ["voi", "voi_gap"])
def test_a_replay_equals_the_oracle_in_every_slot(kind, policy):
    probes = learned = 0
    for name in HARD:
        params = world(name)._replace(adaptation=adaptation_of(kind))
        for seed in range(3):
            route = changed_route(seed)
            draws, (found, factor) = replayed(jax.random.key(seed), route, policy, params, kind)
            adapter = adapter_of(kind, params)
            expected = follow(policy, *for_oracle(draws, route, params), set(), adapter)
            assert_equal(jax.tree.map(np.asarray, found), expected)
            learned += sum(map(len, adapter.ratios.values()))
            probes += len({a for _, a in adapter.last} & {0, 1})
            assert factor.shape == (SLOTS, 3, 8)
            before = [adapter.factor(c, a) for c in range(3) for a in range(8)]
            if not found.sent[-6:].any():  # nothing was learned after the last slot's decision, or was under way
                np.testing.assert_allclose(np.ravel(factor[-1]), before, rtol=1e-4)
    assert learned > 50
    assert probes > 5


def test_vmap_equals_a_loop_over_seeds_and_numbers():
    params, keys = world("weak link"), [jax.random.key(seed) for seed in range(3)]
    numbers = [adaptation_of("reported", every) for every in (0, 2, 5)]
    numbers[1] = numbers[1]._replace(prior_weight=jnp.float32(9.0), keep=jnp.float32(0.5))
    route = changed_route(4)

    def one(key, adaptation):
        draws = draw_jit(key, route, params.env, ACTIONS)
        return replay_draws(draws, route, "voi", params._replace(adaptation=adaptation), ACTIONS, "reported")

    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *numbers)
    mapped = jax.jit(jax.vmap(one))(jnp.stack(keys), stacked)
    for i, (key, adaptation) in enumerate(zip(keys, numbers, strict=True)):
        jax.tree.map(
            lambda many, alone, i=i: np.testing.assert_allclose(many[i], alone, rtol=1e-4, atol=1e-4),
            mapped,
            one(key, adaptation),
        )


def test_without_adaptation_the_replay_is_what_it_was():
    params, route = world("weak link"), make_route(2)
    draws = draw_jit(jax.random.key(2), route, params.env, ACTIONS)
    usual = replay_draws(draws, route, "voi", params, ACTIONS)
    with_numbers = params._replace(adaptation=adaptation_of("reported"))
    jax.tree.map(np.testing.assert_array_equal, replay_draws(draws, route, "voi", with_numbers, ACTIONS, "none"), usual)
    # A prior that nothing can move, and no probes: the adapting robot does the same.
    fixed = with_numbers.adaptation._replace(prior_weight=jnp.float32(1e12), keep=1.0, probe_every=jnp.int32(0))
    found = replay_draws(draws, route, "voi", params._replace(adaptation=fixed), ACTIONS, "reported")
    np.testing.assert_array_equal(found.action, usual.action)
    np.testing.assert_allclose(found.error_m, usual.error_m, rtol=1e-5, atol=1e-5)


def answered(kind, answers, adaptation):
    """What is learned from (risk, squared innovation) pairs in one context with one action, asked at a risk of 4 m."""
    learned = nothing_learned(adaptation)
    asked = Asked(jnp.int32(1), jnp.int32(2), jnp.float32(4.0), jnp.float32(3.0), jnp.bool_(False))
    for risk_m, square_m2 in answers:
        heard = Heard(jnp.float32(risk_m), jnp.float32(square_m2))
        learned = learn(learned, asked, heard, jnp.bool_(True), adaptation, kind)
    return learned


@pytest.mark.parametrize("kind", KINDS)
def test_the_estimate_is_a_discounted_mean_with_a_prior(kind):
    adaptation = adaptation_of(kind)._replace(prior_weight=jnp.float32(3.0), keep=jnp.float32(0.5))
    expected_m = float(adaptation.expected_m[1, 2])
    learned = answered(kind, [(6.0, 40.0), (1.0, 17.0)], adaptation)
    ratios = [6.0, 1.0] if kind == "reported" else [40.0 - 16.0, 17.0 - 16.0]
    scale = expected_m if kind == "reported" else expected_m**2
    mean = (0.75 * 1.0 + 0.5 * ratios[0] / scale + ratios[1] / scale) / (0.75 + 1.5)
    factor = np.array(factors(learned, kind))
    assert factor[1, 2] == pytest.approx(mean if kind == "reported" else np.sqrt(mean), rel=1e-5)
    factor[1, 2] = 1.0
    np.testing.assert_array_equal(factor, 1.0)  # of other contexts and actions nothing is learned


@pytest.mark.parametrize("kind", KINDS)
def test_on_routes_like_those_of_training_the_mean_factor_is_one(kind):
    rng = np.random.default_rng(0)
    residual_m, risk_m = rng.rayleigh(3.0, (4000, 8)), rng.gamma(2.0, 2.0, (4000, 8))
    context, local_m = rng.integers(0, 3, 4000), 5.0
    expected = fit_expected(residual_m, risk_m, context, 3, kind)
    adaptation = adaptation_of(kind, expected_m=expected)._replace(prior_weight=jnp.float32(1e-6), keep=1.0)
    rows = np.flatnonzero(context == 1)[:400]
    angle = rng.uniform(0, 2 * np.pi, len(rows))  # of the residual, from the estimate's error
    square = residual_m[rows, 2] ** 2 + local_m**2 - 2 * residual_m[rows, 2] * local_m * np.cos(angle)
    learned = nothing_learned(adaptation)
    for risk, one in zip(risk_m[rows, 2], square, strict=True):
        asked = Asked(jnp.int32(1), jnp.int32(2), jnp.float32(local_m), jnp.float32(0.0), jnp.bool_(False))
        learned = _learn(learned, asked, Heard(jnp.float32(risk), jnp.float32(one)), True, adaptation, kind)
    assert float(factors(learned, kind)[1, 2]) == pytest.approx(1.0, abs=0.15)


_learn = jax.jit(learn, static_argnames="adapt")


def test_a_probe_that_succeeds_stays_until_the_mean_of_its_answers_fails():
    adaptation = adaptation_of("reported")
    asked = Asked(jnp.int32(1), jnp.int32(2), jnp.float32(4.0), jnp.float32(3.0), jnp.bool_(True))
    learned = nothing_learned(adaptation)
    steps = ((3.1, True, -1), (2.0, False, -1), (2.0, True, 2), (9.0, False, 2), (4.0, True, 2), (3.1, True, -1))
    for risk, arrived, trial in (*steps, (3.0, True, 2)):  # a new trial begins with nothing held against it
        learned = _learn(learned, asked, Heard(jnp.float32(risk), jnp.float32(0.0)), arrived, adaptation, "reported")
        np.testing.assert_array_equal(learned.trial, [-1, trial, -1])


def test_what_cannot_adapt_is_refused():
    params, route = world("paper"), make_route(0)
    draws = draw_jit(jax.random.key(0), route, params.env, ACTIONS)
    none = jnp.zeros(SLOTS, bool)
    with pytest.raises(InputError, match="periodic"):
        replay_schedule(draws, route, "periodic", none, params._replace(adaptation=1), ACTIONS, "reported")
    with pytest.raises(InputError, match="hearsay"):
        replay_schedule(draws, route, "voi", none, params, ACTIONS, "hearsay")
    with pytest.raises(InputError, match="hearsay"):
        make_adaptation("hearsay", PREDICTED)
    assert ControlParams(*params[:2]).adaptation is None

"""Position estimates, the choice of the mixing weight and error summaries against float64 NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ovibjax.edge import localize
from ovibjax.edge.localize import ETAS, ErrorSummary
from tests.oracles import edge as oracle

errors, mix, select_eta, summarize = (
    jax.jit(f) for f in (localize.errors, localize.mix, localize.select_eta, localize.summarize)
)
metres = st.floats(-500, 500, width=32).map(lambda x: x if abs(x) > 1e-3 else 0.0)
points = arrays(np.float32, (6, 3), elements=metres)


def random_estimates(seed, n=50, reg_m=5.0, ret_m=5.0):
    rng = np.random.default_rng(seed)
    truth = rng.uniform(-200, 200, (n, 3))
    reg, ret = truth + rng.normal(size=(n, 3)) * reg_m, truth + rng.normal(size=(n, 3)) * ret_m
    return tuple(a.astype(np.float32) for a in (reg, ret, truth))


def test_errors_on_a_known_triangle():
    est = jnp.array([[3.0, 4.0, 0.0], [1.0, 1.0, 1.0], [-2.0, 3.0, 6.0]])
    np.testing.assert_array_equal(errors(est, jnp.zeros((3, 3))), np.float32([5.0, 3**0.5, 7.0]))
    np.testing.assert_array_equal(errors(est, est), [0.0, 0.0, 0.0])


@settings(deadline=None, max_examples=50)
@given(points, points, st.floats(0, 1, width=32).map(lambda x: x if x > 1e-6 else 0.0))
def test_errors_and_mix_equal_the_oracle(reg, ret, eta):
    np.testing.assert_allclose(errors(reg, ret), oracle.errors(reg, ret), rtol=1e-5, atol=1e-4)
    mixed = mix(jnp.array(reg), jnp.array(ret), jnp.float32(eta))
    np.testing.assert_allclose(mixed, oracle.mix(reg, ret, float(eta)), rtol=1e-5, atol=1e-4)
    # The error is a convex function of the estimate.
    truth = np.float32([[1.0, -2.0, 3.0]] * 6)
    bound = eta * oracle.errors(reg, truth) + (1 - eta) * oracle.errors(ret, truth)
    assert np.all(np.asarray(errors(mixed, truth)) <= bound + 1e-3)


def test_mix_ends_are_its_arguments_and_leading_axes_are_free():
    reg, ret, _ = random_estimates(0)
    np.testing.assert_array_equal(mix(reg, ret, jnp.float32(1.0)), reg)
    np.testing.assert_array_equal(mix(reg, ret, jnp.float32(0.0)), ret)
    stacked = mix(reg.reshape(5, 10, 3), ret.reshape(5, 10, 3), jnp.float32(0.3))
    np.testing.assert_array_equal(stacked.reshape(50, 3), mix(reg, ret, jnp.float32(0.3)))
    assert errors(stacked, stacked).shape == (5, 10)


def test_the_grid_of_weights_covers_the_unit_interval():
    assert ETAS[0] == 0.0 and ETAS[-1] == 1.0 and len(ETAS) == 21
    np.testing.assert_allclose(np.diff(ETAS), 0.05)


@pytest.mark.parametrize("reg_m", [0.5, 5.0, 10.0, 50.0])
@pytest.mark.parametrize("seed", [0, 1, 3, 4])
def test_select_eta_equals_the_loop(seed, reg_m):
    reg, ret, truth = random_estimates(seed, reg_m=reg_m)
    means = oracle.mean_errors(reg, ret, truth)
    best, second = sorted(mean for _, mean in means)[:2]
    assert second - best > 1e-4, "two weights tie to rounding: choose another seed"
    np.testing.assert_allclose(select_eta(reg, ret, truth), oracle.select_eta(reg, ret, truth), rtol=1e-6)


def test_select_eta_follows_the_better_estimate_and_mixes_opposite_errors():
    reg, ret, truth = random_estimates(9)
    assert float(select_eta(truth, ret, truth)) == 1.0
    assert float(select_eta(reg, truth, truth)) == 0.0
    offset = np.float32([8.0, -4.0, 2.0])
    assert float(select_eta(truth + offset, truth - offset, truth)) == 0.5
    assert float(select_eta(truth + offset, truth - 3 * offset, truth)) == 0.75


def test_ties_go_to_the_smaller_weight():
    def along_x(*values):
        return np.array([[value, 0, 0] for value in values], np.float32)

    # |20 eta - 5| + |20 eta - 15| is flat between 0.25 and 0.75.
    assert float(select_eta(along_x(20, 20), along_x(0, 0), along_x(5, 15))) == 0.25
    # The same from the other side: |5 - 20 eta'| with the roles exchanged is flat there too.
    assert float(select_eta(along_x(0, 0), along_x(20, 20), along_x(5, 15))) == 0.25
    same = along_x(0, 0, 0)
    assert float(select_eta(same, same, along_x(1, 2, 3))) == 0.0


def test_select_eta_is_a_function_of_arrays():
    stacks = [np.stack(parts) for parts in zip(*(random_estimates(s, reg_m=3 * s + 1) for s in range(4)), strict=True)]
    together = jax.vmap(select_eta)(*stacks)
    assert together.shape == (4,) and together.dtype == jnp.float32
    alone = [float(select_eta(*(part[i] for part in stacks))) for i in range(4)]
    np.testing.assert_array_equal(together, np.float32(alone))
    assert len(set(alone)) > 1


@pytest.mark.parametrize("shape", [(1,), (7,), (750,), (4, 31), (2, 3, 20)])
def test_summary_equals_numpy(shape):
    error_m = np.random.default_rng(1).gamma(1.5, 4.0, shape).astype(np.float32)
    summary = summarize(jnp.array(error_m), recall_m=3.0)
    expected = ErrorSummary(
        mean_m=error_m.astype(np.float64).mean(axis=-1),
        median_m=np.percentile(error_m, 50, axis=-1),
        p90_m=np.percentile(error_m, 90, axis=-1),
        p95_m=np.percentile(error_m, 95, axis=-1),
        recall=(error_m <= 3.0).mean(axis=-1),
    )
    for name, ours, theirs in zip(ErrorSummary._fields, summary, expected, strict=True):
        assert ours.shape == shape[:-1], name
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, err_msg=name)


def test_the_default_recall_radius_is_five_metres_and_includes_its_edge():
    error_m = jnp.array([0.0, 4.9, 5.0, 5.0001, 80.0])
    assert float(summarize(error_m).recall) == np.float32(0.6)
    assert float(summarize(error_m, recall_m=100.0).recall) == 1.0
    assert float(summarize(error_m, recall_m=0.0).recall) == np.float32(0.2)


@settings(deadline=None, max_examples=30)
@given(arrays(np.float32, (9,), elements=st.floats(0, 500, width=32).map(lambda x: x if x > 1e-3 else 0.0)))
def test_summary_is_ordered_and_blind_to_the_order_of_frames(error_m):
    summary = summarize(error_m)
    assert summary.median_m <= summary.p90_m + 1e-3 and summary.p90_m <= summary.p95_m + 1e-3
    assert summary.p95_m <= error_m.max() + 1e-3 and 0 <= summary.recall <= 1
    for ours, shuffled in zip(summary, summarize(error_m[::-1].copy()), strict=True):
        np.testing.assert_allclose(ours, shuffled, rtol=1e-5)

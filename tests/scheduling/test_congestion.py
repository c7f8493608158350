"""The congestion table against one replay at a time."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.scheduling.clients import default_trace_params, make_trace
from ovibjax.scheduling.congestion import Case, compare, search, workloads
from ovibjax.scheduling.events import synthetic_events
from ovibjax.scheduling.queue_replay import waits
from ovibjax.scheduling.replay_metrics import metrics
from ovibjax.scheduling.rules import default_params

SEEDS, N_MAX = 3, 6

compiled_trace = jax.jit(make_trace, static_argnames="n_clients")
compiled_metrics = jax.jit(metrics)


@pytest.fixture(scope="module")
def events():
    return synthetic_events(jax.random.key(1), 8)


@pytest.fixture(scope="module")
def cases():
    return Case(jnp.array([2, N_MAX]), jnp.array([12.0, 4.0]), jnp.array([0.3, 0.1]))


@pytest.fixture(scope="module")
def keys():
    # With key 9 two requests at the edge of the top tenth are equal but for rounding, which differs between programs.
    return jax.random.split(jax.random.key(11), SEEDS)


def test_a_case_of_few_clients_is_the_trace_of_those(events, cases, keys):
    made = jax.jit(workloads, static_argnames="n_max")(keys, events, cases, default_trace_params(), n_max=N_MAX)
    assert made.uplink_ms.shape == (2, SEEDS, N_MAX * 8)
    for r, n in enumerate((2, N_MAX)):
        params = default_trace_params()._replace(phase_spread_s=cases.phase_spread_s[r])
        alone = compiled_trace(keys[1], events, n, cases.rate_kb_per_s[r], params)
        valid = np.asarray(made.requests.valid[r, 1])
        np.testing.assert_array_equal(valid, np.arange(N_MAX * 8) < n * 8)
        for found, expected in zip(made.requests, alone.requests, strict=True):
            np.testing.assert_allclose(np.asarray(found)[r, 1][valid], expected, rtol=1e-6)


@pytest.mark.slow
def test_the_table_equals_one_replay_at_a_time(events, cases, keys):
    params = default_params()
    swept = params._replace(V=jnp.array([0.0, 8.0]))
    found = compare(keys, events, cases, default_trace_params(), swept, N_MAX)
    for r, n in enumerate((2, N_MAX)):
        case = default_trace_params()._replace(phase_spread_s=cases.phase_spread_s[r])
        for s in (0, 2):
            alone = compiled_trace(keys[s], events, n, cases.rate_kb_per_s[r], case)
            for policy, got in found.items():
                for p in range(2):
                    one = params._replace(V=swept.V[p])
                    expected = compiled_metrics(alone, waits(alone.requests, policy, one), one)
                    np.testing.assert_allclose(
                        jax.tree.map(lambda leaf, at=(r, s, p): leaf[at], jax.tree.leaves(got)),
                        jax.tree.leaves(expected),
                        rtol=5e-4,  # make_trace rounds float32 times by what it is compiled with
                    )
    tried = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (2,)), params)
    objectives = search(keys, events, cases, default_trace_params(), tried, N_MAX)
    shaped = found["voi_lyapunov"]
    expected = (shaped.top.cost, shaped.top.edge_p95_ms, shaped.every.cost, shaped.every.edge_p95_ms)
    np.testing.assert_allclose(objectives[:, :, 0], np.stack(expected, axis=-1)[:, :, 0], rtol=1e-5)


def test_other_numbers_compile_nothing(events, cases, keys):
    before = compare._cache_size()
    for V in (5.0, 3.0):
        compare(keys, events, cases, default_trace_params(), default_params()._replace(V=jnp.array([0.0, V])), N_MAX)
    assert compare._cache_size() <= before + 1

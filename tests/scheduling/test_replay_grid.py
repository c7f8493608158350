"""Rules in one program against one grid for each."""

import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.scheduling.replay_grid import run_grid, run_rules
from ovibjax.scheduling.rules import POLICIES, default_params
from tests.scheduling.random_requests import KINDS, random_trace, stack

N = 40


def waits_of(context, wait_ms, params):
    return {"wait_ms": wait_ms + context, "V": params.V}


@pytest.mark.parametrize("swept", ["nothing", "V", "value", "ties"])
def test_rules_together_equal_each_alone(swept):
    traces = stack([random_trace(seed, N, KINDS[seed % len(KINDS)]) for seed in range(12)])
    params, shift = default_params(), np.arange(12, dtype=np.float32)
    if swept == "V":
        params = params._replace(V=jnp.array([0.0, 8.0, 64.0]))
    if swept == "value":
        params = params._replace(value=params.value._replace(risk=jnp.array([0.0, 0.22, 5.0])))
    if swept == "ties":
        params = params._replace(ties=jnp.arange(3))
    together = run_rules(traces, POLICIES, params, waits_of, shift)
    assert set(together) == set(POLICIES)
    for rule in POLICIES:
        alone = np.asarray(run_grid(traces, rule, params)) + shift[:, None, None]
        np.testing.assert_array_equal(together[rule]["wait_ms"], alone, err_msg=rule)
    if swept == "V":
        np.testing.assert_array_equal(together["base_dpp"]["V"][5], [0.0, 8.0, 64.0])
        assert np.any(together["base_dpp"]["wait_ms"][:, 0] != together["base_dpp"]["wait_ms"][:, 2])
    if swept == "ties":
        for rule in POLICIES:
            found = together[rule]["wait_ms"]
            assert np.array_equal(found[:, 0], found[:, 2], equal_nan=True) == (rule == "fifo")


def test_a_wrong_rule_or_trace_is_refused_as_by_a_grid():
    traces = stack([random_trace(0, N, "burst")])
    with pytest.raises(InputError, match="lifo"):
        run_rules(traces, ("fifo", "lifo"), default_params(), waits_of, np.zeros(1))
    with pytest.raises(InputError, match="service_ms"):
        run_rules(
            traces._replace(service_ms=-traces.service_ms - 1.0), POLICIES, default_params(), waits_of, np.zeros(1)
        )

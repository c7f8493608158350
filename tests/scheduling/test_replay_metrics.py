"""Metrics of a queue replay against plain Python."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.scheduling.clients import Workload
from ovibjax.scheduling.queue_replay import POLICIES, waits
from ovibjax.scheduling.replay_metrics import metrics
from ovibjax.scheduling.rules import default_params
from tests.oracles import scheduling as oracle
from tests.scheduling.random_requests import random_trace

compiled_metrics = jax.jit(metrics)


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("kind", ["burst", "twins", "empty", "single"])
def test_metrics_equal_the_plain_ones(policy, kind):
    trace = random_trace(8, 40, kind)
    uplink_ms = np.random.default_rng(1).uniform(30, 60, 40).astype(np.float32)
    params = default_params()
    found = compiled_metrics(Workload(trace, uplink_ms), waits(trace, policy, params), params)
    starts, _, _ = oracle.replay(trace, policy)
    requests = oracle.requests_of(trace)
    top = oracle.top_tenth(requests)
    if kind == "twins":  # twins are equal in value, and both belong to the top if one does
        least = min(oracle.scheduling_value(j) for j in top)
        top = [j for j in requests if oracle.scheduling_value(j) >= least]
    for group, members in ((found.top, top), (found.every, requests)):
        np.testing.assert_allclose(np.array(group), oracle.group_metrics(members, starts, uplink_ms), rtol=2e-5)


def test_the_percentile_is_that_of_numpy():
    rng = np.random.default_rng(0)
    for n in (1, 20, 21, 400):
        trace = random_trace(3, n, "spread")._replace(valid=np.ones(n, bool))
        waits_ms = rng.uniform(0, 300, n).astype(np.float32)
        found = compiled_metrics(Workload(trace, np.zeros(n, np.float32)), jnp.asarray(waits_ms), default_params())
        expected = np.percentile(waits_ms + trace.service_ms, 95)
        np.testing.assert_allclose(found.every.edge_p95_ms, expected, rtol=1e-5)

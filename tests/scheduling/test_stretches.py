"""Stretches of a trace: FIFO in closed form, no order of service crosses them; the list of what lanes still need."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.scheduling.lane_list import SLOTS, drop
from ovibjax.scheduling.queue_replay import POLICIES, served_order
from ovibjax.scheduling.requests import NEVER
from ovibjax.scheduling.rules import default_params
from ovibjax.scheduling.stretches import contended, first_come, in_closed_form, one_by_one
from ovibjax.scheduling.ticks import sort_requests, split_times
from tests.scheduling.random_requests import KINDS, expected_waits, random_trace, stack

N = 40
TRACES = [random_trace(seed, N, KINDS[seed % len(KINDS)]) for seed in range(100)]

requests = jax.jit(jax.vmap(sort_requests))(split_times(stack(TRACES)))
start = jax.jit(jax.vmap(first_come))(requests)


@pytest.mark.parametrize("form", [one_by_one, in_closed_form])
def test_first_come_equals_the_event_loop(form):
    start = jax.jit(jax.vmap(form))(requests.ready, requests.service)
    waited_ms = np.asarray((start - requests.ready).astype(jnp.float32) * requests.tick_ms[:, None])
    for row, trace in enumerate(TRACES):
        valid = np.asarray(requests.valid[row])
        expected = expected_waits(trace, "fifo")[np.asarray(requests.position[row])]
        np.testing.assert_array_equal(waited_ms[row][valid], expected[valid])


@pytest.mark.parametrize("policy", POLICIES)
def test_no_rule_serves_across_the_ends_of_a_stretch(policy):
    served = jax.jit(jax.vmap(lambda r: served_order(r, policy, default_params())))(requests)
    found = jax.device_get(jax.jit(jax.vmap(contended))(requests, start))
    longest = 0
    for row in range(len(TRACES)):
        valid = np.asarray(requests.valid[row])
        times, alone = np.asarray(served[row]), valid.copy()
        count = found.number[row]
        for first, length, begin in zip(found.first[row], found.length[row], found.begin[row], strict=True):
            if count == 0:
                break
            count -= 1
            inside = slice(first, first + length)
            assert length > 1 and valid[inside].all() and alone[inside].all()
            alone[inside] = False
            longest = max(longest, length)
            assert times[inside].min() == begin
            rest = times[first + length :][valid[first + length :]]
            assert np.all(times[:first] < begin) and times[inside].max() < rest.min(initial=NEVER)
        np.testing.assert_array_equal(times[alone], np.asarray(start[row])[alone])
    assert longest > 10


@pytest.mark.parametrize("seed", range(8))
def test_a_list_drops_what_all_lanes_have_served(seed):
    rng = np.random.default_rng(seed)
    listed = np.sort(rng.choice(200, SLOTS + 1, replace=False)).astype(np.int32)
    served = rng.random((5, SLOTS)) < 0.6
    bits = (served * 2 ** np.arange(SLOTS, dtype=np.uint64)).sum(axis=1).astype(np.uint32).view(np.int32)
    common = np.flatnonzero(served.all(axis=0))
    if seed == 0:
        bits, served, common = bits * 0, served & False, common[:0]
    after, left = jax.jit(drop)(listed, bits)
    if len(common):
        listed = np.concatenate([np.delete(listed, common[0]), listed[-1:] + 1])
        served = np.concatenate([np.delete(served, common[0], axis=1), np.zeros((5, 1), bool)], axis=1)
    np.testing.assert_array_equal(after, listed)
    np.testing.assert_array_equal((np.asarray(left).view(np.uint32)[:, None] >> np.arange(SLOTS)) & 1, served)

"""The token bucket against a link that is played bit by bit."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.live.shaping import TokenBucket
from tests.live.cases import patient

SLOT_S = 0.5


def played(rates_bps, sends, depth_bytes, step_s=1e-3):
    """Slow and obvious: tokens drip in every millisecond, bytes leave when there are tokens for them."""
    tokens, time_s, queue, left = 8.0 * depth_bytes, 0.0, [], [math.inf] * len(sends)
    for _ in range(int(60 / step_s)):
        queue += [[i, 8.0 * size] for i, (at_s, size) in enumerate(sends) if time_s <= at_s < time_s + step_s]
        tokens += rates_bps[min(int(time_s / SLOT_S + 1e-9), len(rates_bps) - 1)] * step_s
        while queue and tokens > 0:
            used = min(tokens, queue[0][1])
            tokens, queue[0][1] = tokens - used, queue[0][1] - used
            if queue[0][1] <= 1e-9:
                left[queue.pop(0)[0]] = time_s + step_s
        tokens = min(tokens, 8.0 * depth_bytes) if not queue else tokens
        time_s += step_s
    return left


@settings(patient, max_examples=20)
@given(st.integers(0, 1000), st.sampled_from([0.0, 150.0]))
def test_bytes_leave_when_a_link_has_sent_them(seed, depth_bytes):
    rng = np.random.default_rng(seed)
    rates_bps = rng.choice([0.0, 8_000.0, 32_768.0], 12)
    rates_bps[-1] = 16_000.0
    sends = [(float(at_s), int(rng.integers(20, 200))) for at_s in np.sort(rng.uniform(0, 6, 8))]
    bucket = TokenBucket(rates_bps, SLOT_S, depth_bytes)
    found = [bucket.leaves_s(at_s, size) for at_s, size in sends]
    np.testing.assert_allclose(found, played(rates_bps, sends, depth_bytes), atol=0.01)


def test_a_serial_link_takes_size_over_rate():
    bucket = TokenBucket([65_536.0], SLOT_S)
    assert bucket.leaves_s(3.0, 112) == pytest.approx(3.0 + 8 * 112 / 65_536)
    assert bucket.leaves_s(3.0, 112) == pytest.approx(3.0 + 16 * 112 / 65_536)
    assert bucket.leaves_s(100.0, 112) == pytest.approx(100.0 + 8 * 112 / 65_536)


def test_a_deep_bucket_lets_a_burst_pass():
    bucket = TokenBucket([8_000.0], SLOT_S, depth_bytes=100)
    assert bucket.leaves_s(1.0, 60) == 1.0
    assert bucket.leaves_s(1.0, 40) == pytest.approx(1.0)
    assert bucket.leaves_s(1.0, 100) == pytest.approx(1.1)


def test_a_link_that_stays_down_sends_nothing():
    bucket = TokenBucket([8_000.0, 0.0], SLOT_S)
    assert bucket.leaves_s(0.0, 100) == pytest.approx(0.1)
    assert bucket.leaves_s(0.2, 1000) == math.inf

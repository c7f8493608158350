"""Traces as values, and resampling against exact sums."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.errors import InputError
from ovibjax.link.traces import Trace, resample
from tests.oracles import channel as oracle


def test_a_trace_is_a_read_only_copy():
    time_s = np.array([0.0, 1.0])
    trace = Trace(time_s, [1, 2])
    time_s[0] = 9
    assert trace.time_s[0] == 0 and trace.rate_bps.dtype == np.float64
    with pytest.raises(ValueError, match="read-only"):
        trace.rate_bps[0] = 1


@pytest.mark.parametrize(
    ("time_s", "rate", "reason"),
    [
        ([0.0], [1.0], "two or more"),
        ([0.0, 1.0], [1.0], "one rate per time"),
        ([[0.0, 1.0]], [[1.0, 2.0]], "shape"),
        ([0.0, 0.0], [1.0, 1.0], "increase"),
        ([0.0, np.nan], [1.0, 1.0], "increase"),
        ([0.0, np.inf], [1.0, 1.0], "finite"),
        ([0.0, 1.0], [1.0, -1.0], "rates must be"),
        ([0.0, 1.0], [np.nan, 1.0], "rates must be"),
    ],
)
def test_traces_made_by_hand_are_checked(time_s, rate, reason):
    with pytest.raises(InputError, match=f"mine: .*{reason}"):
        Trace(time_s, rate, "mine")


def test_a_rate_holds_over_the_interval_it_ends():
    # As in Pensieve's simulator, which walks the samples from the second one and wraps to time 0.
    trace = Trace([0, 1, 3], [9, 2, 4])
    out = resample(trace, 1.0, 7)
    np.testing.assert_array_equal(out, [2, 4, 4, 2, 4, 4, 2])
    assert out.dtype == np.float32
    np.testing.assert_allclose(resample(trace, 1.5, 2), [(2 + 0.5 * 4) / 1.5, 4], rtol=1e-6)
    np.testing.assert_allclose(resample(trace, 30.0, 1, start_s=0.7), [10 / 3], rtol=1e-6)  # ten rounds
    shifted = Trace(np.array([0, 1, 3]) + 1.7e9, [9, 2, 4])
    np.testing.assert_array_equal(resample(shifted, 1.0, 7), out)


@settings(deadline=None, max_examples=150)
@given(
    st.lists(st.tuples(st.integers(1, 12), st.integers(0, 1000) | st.just(0)), min_size=1, max_size=12),
    st.integers(1, 40),
    st.integers(1, 12),
    st.integers(0, 100),
    st.sampled_from([1 / 8, 0.1, 1e-3, 7.0]),
    st.sampled_from([0.0, 123.456]),
)
def test_resampling_equals_a_fine_grid(pieces, slot_ticks, n_slots, start_ticks, tick_s, origin_s):
    ticks = [0, *np.cumsum([length for length, _ in pieces]).tolist()]
    rates = [777, *(rate for _, rate in pieces)]
    trace = Trace(origin_s + tick_s * np.array(ticks), rates)
    expected = oracle.resample(ticks, rates, slot_ticks, n_slots, start_ticks)
    out = resample(trace, tick_s * slot_ticks, n_slots, tick_s * start_ticks)
    assert out.shape == (n_slots,) and out.dtype == np.float32
    np.testing.assert_allclose(out, expected, rtol=1e-5)
    # A dead slot is exactly dead even where 0.1 s has no exact binary form: its delay is infinite, not years.
    np.testing.assert_array_equal(out == 0, np.array(expected) == 0)
    if (start_ticks + n_slots * slot_ticks) <= ticks[-1]:
        np.testing.assert_array_equal(
            resample(trace, tick_s * slot_ticks, n_slots, tick_s * start_ticks, loop=False), out
        )


@settings(deadline=None, max_examples=100)
@given(st.integers(0, 2**31), st.floats(0.01, 50), st.floats(0, 500))
def test_resampling_conserves_bits_and_stays_in_range(seed, slot_s, start_s):
    rng = np.random.default_rng(seed)
    trace = Trace(np.cumsum(rng.exponential(size=30)), rng.exponential(size=30) * 1e6)
    out = resample(trace, slot_s, 25, start_s).astype(np.float64)
    assert np.all(out <= trace.rate_bps[1:].max() * (1 + 1e-6)) and np.all(out >= trace.rate_bps[1:].min() * (1 - 1e-6))
    whole = resample(trace, 25 * slot_s, 1, start_s)
    np.testing.assert_allclose(out.mean(), whole[0], rtol=2e-5)
    np.testing.assert_allclose(resample(trace, slot_s, 25, start_s + trace.duration_s), out, rtol=2e-4)


def test_a_constant_trace_stays_constant():
    trace = Trace(np.cumsum(np.random.default_rng(3).uniform(0.1, 2, 500)), np.full(500, 65536.0))
    np.testing.assert_allclose(resample(trace, 0.5, 2000), 65536.0, rtol=2e-7)


def test_short_traces_without_looping():
    trace = Trace([0, 1, 2], [1e6, 2e6, 3e6], "bus 7.log")
    np.testing.assert_array_equal(resample(trace, 0.5, 4, loop=False), [2e6, 2e6, 3e6, 3e6])
    message = r"bus 7.log: too short: it lasts 2 s, but 4 slots of 0.5 s from 0.25 s end at 2.25 s; .* let it loop"
    with pytest.raises(InputError, match=message):
        resample(trace, 0.5, 4, start_s=0.25, loop=False)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ((0.0, 3), "slot_s 0.0"),
        ((-1.0, 3), "slot_s -1.0"),
        ((np.nan, 3), "slot_s nan"),
        ((np.inf, 3), "slot_s inf"),
        ((1e300, 3), "positive finite"),
        ((1.0, 0), "n_slots 0"),
        ((1.0, 3, -0.5), "start_s -0.5"),
        ((1.0, 3, np.nan), "start_s nan"),
        ((1e-9, 3, 1e9), "too short to tell slots apart"),
    ],
)
def test_resample_refuses(arguments, reason):
    with pytest.raises(InputError, match=reason):
        resample(Trace([0, 1], [1, 1]), *arguments)


def test_an_instant_is_not_repeated_forever():
    with pytest.raises(InputError, match="burst: too short: it lasts 1e-09 s, but 9 slots of 1 s"):
        resample(Trace([0, 1e-9], [1, 1], "burst"), 1.0, 9)

"""The paper's overhead table, the edges of transmission time, and the host measurement's bookkeeping."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.link.latency import (
    JETSON,
    LatencyProfile,
    compute_ms_at,
    kbytes_per_s,
    measure_host,
    semantic_latency_ms,
    transmit_s,
)


@pytest.mark.parametrize(("k", "expected_ms"), [(32, 50.4), (128, 100.6), (35, 52.0), (16, 42.0)])
def test_overhead_table(k, expected_ms):
    assert float(semantic_latency_ms(JETSON, k, kbytes_per_s(8))) == pytest.approx(expected_ms, abs=0.1)


def test_weak_link_transmission_of_the_replay():
    # Paper, multi-client scheduling: p95 of 8.3, 12.7 and 25.4 ms at 12, 8 and 4 KB/s. These are the largest
    # requests (104 bytes); at 12 KB/s the p95 lies below them, among the 96- to 104-byte mix.
    times_ms = 1e3 * transmit_s(104.0, kbytes_per_s(jnp.array([12.0, 8.0, 4.0])))
    np.testing.assert_allclose(times_ms, [8.46, 12.70, 25.39], atol=0.01)


def test_raw_offloading_upload_time():
    # Paper, retrieval: 891.5 KB at 2 Mbps is 99.3 % of 3.59 s, which holds for a KB of 1,000 bytes only.
    assert float(transmit_s(891.5e3, 2e6)) == pytest.approx(0.993 * 3.59, abs=0.005)


def test_compute_interpolates_and_clamps():
    k = jnp.array([1, 16, 24, 32, 35, 128, 256])
    np.testing.assert_allclose(compute_ms_at(JETSON, k), [31.7, 31.7, 32.0, 32.3, 32.5, 35.7, 35.7], rtol=1e-6)
    grid = np.linspace(1, 200, 57)
    expected = np.interp(grid, [16, 32, 35, 128], [31.7, 32.3, 32.5, 35.7])
    np.testing.assert_allclose(compute_ms_at(JETSON, grid), expected, rtol=1e-6)
    assert compute_ms_at(JETSON, 24).dtype == jnp.float32 and compute_ms_at(JETSON, 24).shape == ()


def test_jit_and_vmap_over_everything():
    k, rate = jnp.array([16, 35, 90]), kbytes_per_s(jnp.array([4.0, 8.0, 12.0]))
    loop = np.array([[semantic_latency_ms(JETSON, int(a), float(b)) for b in rate] for a in k])
    over_rate = jax.vmap(semantic_latency_ms, (None, None, 0))
    grid = jax.jit(jax.vmap(over_rate, (None, 0, None)))(JETSON, k, rate)
    np.testing.assert_allclose(grid, loop, rtol=1e-6)
    np.testing.assert_allclose(semantic_latency_ms(JETSON, k, rate), np.diag(loop), rtol=1e-6)
    doubled = JETSON._replace(compute_ms=2 * JETSON.compute_ms)
    profiles = jax.tree.map(lambda *leaves: jnp.stack(leaves), JETSON, doubled)
    np.testing.assert_allclose(jax.vmap(compute_ms_at, (0, None))(profiles, 32), [32.3, 64.6], rtol=1e-6)


def test_profile_is_an_immutable_pytree():
    assert len(jax.tree.leaves(JETSON)) == 2 and isinstance(JETSON, LatencyProfile)
    with pytest.raises(ValueError, match="read-only"):
        JETSON.compute_ms[0] = 0.0


@pytest.mark.parametrize("transmit", [transmit_s, jax.jit(transmit_s)])
def test_a_dead_link_takes_forever(transmit):
    times = transmit(jnp.array([0.0, 84.0, 84.0, 84.0]), jnp.array([0.0, 0.0, -0.0, -5.0]))
    assert times.dtype == jnp.float32
    np.testing.assert_array_equal(times, np.full(4, np.inf))
    assert transmit(84, 0) == np.inf and transmit(84, 1e-44) == np.inf and transmit(84, np.inf) == 0.0
    assert semantic_latency_ms(JETSON, 16, 0.0) == np.inf
    assert np.isnan(transmit(84.0, np.nan))  # a broken rate stays visible


def test_transmission_time_and_gradient():
    assert float(transmit_s(1024, kbytes_per_s(8))) == 0.125
    np.testing.assert_array_equal(transmit_s(jnp.array([1024, 2048]), 8192), [1.0, 2.0])
    gradient = jax.grad(transmit_s, argnums=(0, 1))
    np.testing.assert_allclose(gradient(100.0, 800.0), [0.01, -1.25e-3], rtol=1e-6)
    np.testing.assert_array_equal(gradient(100.0, 0.0), [0.0, 0.0])


def test_kbytes_per_s():
    assert kbytes_per_s(8) == 65536 and kbytes_per_s(0.5) == 4096.0
    np.testing.assert_array_equal(kbytes_per_s(jnp.array([4, 12])), [32768, 98304])
    np.testing.assert_array_equal(kbytes_per_s(jnp.array([4.0, 12.0])), [32768.0, 98304.0])


def test_measure_host_counts_calls():
    calls = []

    def encode(k):
        calls.append(k)
        return {"z": jnp.ones(k)}

    profile = measure_host(encode, [32, 4, 16, 4], repeats=5)
    assert calls == [4] * 6 + [16] * 6 + [32] * 6  # one warm-up and five timed calls each
    np.testing.assert_array_equal(profile.k, [4, 16, 32])
    assert profile.compute_ms.shape == (3,) and profile.compute_ms.dtype == np.float32
    assert np.all(np.isfinite(profile.compute_ms)) and np.all(profile.compute_ms >= 0)
    assert np.isfinite(semantic_latency_ms(profile, 10, kbytes_per_s(8)))


def test_measure_host_takes_the_median_of_finished_calls(monkeypatch):
    # A clock that only the waiting for results moves: warm-up 9 ms, then 1, 5 and 2 ms.
    clock_ns, waits_ms = [0], iter([9, 1, 5, 2])

    def wait(value):
        clock_ns[0] += next(waits_ms) * 1_000_000
        return value

    monkeypatch.setattr("ovibjax.link.latency.time.perf_counter_ns", lambda: clock_ns[0])
    monkeypatch.setattr("ovibjax.link.latency.jax.block_until_ready", wait)
    np.testing.assert_allclose(measure_host(lambda k: k, [8], repeats=3).compute_ms, [2.0], rtol=1e-6)


@pytest.mark.parametrize(("prefixes", "repeats"), [([], 3), ([0, 4], 3), ([-1], 3), ([4], 0)])
def test_measure_host_refuses(prefixes, repeats):
    with pytest.raises(ValueError, match="at least 1"):
        measure_host(lambda k: jnp.ones(k), prefixes, repeats)

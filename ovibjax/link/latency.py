"""How long a frame takes to be encoded and sent (paper, Section "Communication Model").

Latency counts from the end of feature extraction to the last byte sent: a device profile gives the time to
encode a prefix of length k, the link adds payload over rate. KB is 1,024 bytes.
"""

import time
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax.typing import ArrayLike

from ovibjax.link.payload import representation_bytes

_BITS_PER_BYTE = 8
_BYTES_PER_KB = 1024

Number = TypeVar("Number", float, jax.Array, npt.NDArray[Any])


class LatencyProfile(NamedTuple):
    """Encoding time of one device by prefix length; a pytree, so profiles can be stacked and swept.

    Attributes:
        k: [n] prefix lengths, increasing.
        compute_ms: [n] float32, milliseconds from extracted features to the encoded prefix.
    """

    k: jax.Array | npt.NDArray[Any]
    compute_ms: jax.Array | npt.NDArray[Any]


def _profile(k: Iterable[int], compute_ms: Iterable[float]) -> LatencyProfile:
    # NumPy leaves: a jax array built at import would start the backend before the caller has set its flags.
    points, times_ms = np.array(list(k), np.int32), np.array(list(compute_ms), np.float32)
    points.setflags(write=False)
    times_ms.setflags(write=False)
    return LatencyProfile(points, times_ms)


JETSON = _profile(k=(16, 32, 35, 128), compute_ms=(31.7, 32.3, 32.5, 35.7))
"""Jetson Orin NX, implied by the paper's deployment-overhead table: latency less 4 k + 20 bytes at 8 KB/s."""


def compute_ms_at(profile: LatencyProfile, k: ArrayLike) -> jax.Array:
    """Encoding time at prefix length k: linear between the profile's points, constant outside them.

    Args:
        profile: device profile with leaves [n].
        k: [...] prefix length.

    Returns:
        [...] float32 milliseconds.
    """
    points = jnp.asarray(profile.k, jnp.float32)
    return jnp.interp(jnp.asarray(k, jnp.float32), points, jnp.asarray(profile.compute_ms, jnp.float32))


def transmit_s(payload_bytes: ArrayLike, rate_bps: ArrayLike) -> jax.Array:
    """Transmission delay tau = |Z| / R (paper, Section "Communication Model").

    Args:
        payload_bytes: [...] payload in bytes.
        rate_bps: [...] uplink rate in bits per second.

    Returns:
        [...] float32 seconds; infinite where the rate is zero or negative.
    """
    payload_bits = _BITS_PER_BYTE * jnp.asarray(payload_bytes, jnp.float32)
    rate = jnp.asarray(rate_bps, jnp.float32)
    # Division by one where the link is down keeps 0/0, and the gradient of the branch not taken, free of NaN.
    down = rate <= 0
    return jnp.where(down, jnp.inf, payload_bits / jnp.where(down, 1.0, rate))


def kbytes_per_s(rate_kb_per_s: Number) -> Number:
    """Bits per second of a rate in KB/s of 1,024 bytes, the unit of the paper's link profiles.

    Args:
        rate_kb_per_s: rate in KB/s, a number or an array.

    Returns:
        The rate in bits per second, of the type and shape of the argument; 8 KB/s is 65,536 bit/s.
    """
    return rate_kb_per_s * (_BYTES_PER_KB * _BITS_PER_BYTE)


def semantic_latency_ms(profile: LatencyProfile, k: ArrayLike, rate_bps: ArrayLike) -> jax.Array:
    """Encoding plus transmission of the serialized 4 k + 20 bytes (paper, table "scalable_overhead").

    Args:
        profile: device profile with leaves [n].
        k: [...] prefix length.
        rate_bps: [...] uplink rate in bits per second.

    Returns:
        [...] float32 milliseconds; infinite where the rate is zero.
    """
    payload_bytes = representation_bytes(jnp.asarray(k, jnp.float32))
    return compute_ms_at(profile, k) + 1000.0 * transmit_s(payload_bytes, rate_bps)


def measure_host(encode: Callable[[int], Any], prefixes: Iterable[int], repeats: int = 30) -> LatencyProfile:
    """Time an encoder on this machine: median per prefix, after one untimed call that may compile.

    Args:
        encode: jitted encoder; takes a prefix length, returns a pytree of jax arrays.
        prefixes: prefix lengths to time, in any order; duplicates count once.
        repeats: timed calls per prefix.

    Returns:
        Profile with leaves [n], increasing in k.

    Raises:
        ValueError: no prefix, a prefix below 1, or fewer than one repeat.
    """
    lengths = sorted(set(prefixes))
    if not lengths or lengths[0] < 1:
        raise ValueError(f"prefixes must be one or more lengths of at least 1, not {lengths}")
    if repeats < 1:
        raise ValueError(f"repeats must be at least 1, not {repeats}")
    return _profile(lengths, (_median_ms(encode, k, repeats) for k in lengths))


def _median_ms(encode: Callable[[int], Any], k: int, repeats: int) -> float:
    jax.block_until_ready(encode(k))
    elapsed_ns = []
    for _ in range(repeats):
        start_ns = time.perf_counter_ns()
        jax.block_until_ready(encode(k))
        elapsed_ns.append(time.perf_counter_ns() - start_ns)
    return float(np.median(elapsed_ns)) * 1e-6

"""How long the edge server works on one request (paper, Section "VOI-Weighted Edge Scheduling").

Compute latency that depends on the view mode, fixed times of decoding, retrieval and runtime, and lognormal jitter.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax.typing import ArrayLike

from ovibjax.views import MODES

_FIRST_VIEW_MS, _PER_VIEW_MS = 1.2, 0.4


class ServiceProfile(NamedTuple):
    """Parts of a service time; a pytree, so every number can be stacked and swept.

    Attributes:
        compute_ms: [4] compute latency of each view mode, in the order of `views.MODES`.
        decode_ms: O-VIB decoding.
        retrieve_ms: descriptor retrieval.
        runtime_ms: runtime overhead.
        jitter_median_ms: median of the lognormal jitter.
        jitter_sigma: standard deviation of the jitter's logarithm.
    """

    compute_ms: jax.Array | npt.NDArray[Any]
    decode_ms: ArrayLike
    retrieve_ms: ArrayLike
    runtime_ms: ArrayLike
    jitter_median_ms: ArrayLike
    jitter_sigma: ArrayLike


def _edge() -> ServiceProfile:
    # NumPy leaves: a jax array built at import would start the backend before the caller has set its flags.
    compute_ms = np.array([_FIRST_VIEW_MS + _PER_VIEW_MS * len(views) for views in MODES.values()], np.float32)
    compute_ms.setflags(write=False)
    return ServiceProfile(compute_ms, *(np.float32(number) for number in (3.1, 5.2, 4.0, 2.2, 0.5)))


EDGE = _edge()
"""The paper's edge server. It publishes decoding, retrieval, runtime and the jitter's median, but neither the table of
compute latency nor the jitter's spread: 1.2 ms plus 0.4 ms per view, and a sigma of 0.5, are assumptions."""


def estimate_ms(profile: ServiceProfile, mode: ArrayLike) -> jax.Array:
    """Estimated service time G: the expected parts with the jitter at its median.

    Args:
        profile: leaves as in `ServiceProfile`.
        mode: [...] index of the view mode in `views.MODES`.

    Returns:
        [...] float32 milliseconds.
    """
    return _before_jitter_ms(profile, mode) + jnp.asarray(profile.jitter_median_ms, jnp.float32)


def draw_ms(key: jax.Array, profile: ServiceProfile, mode: ArrayLike) -> jax.Array:
    """One random service time per request.

    Args:
        key: random key.
        profile: leaves as in `ServiceProfile`.
        mode: [...] index of the view mode in `views.MODES`.

    Returns:
        [...] float32 milliseconds, independent draws.
    """
    normal = jax.random.normal(key, jnp.shape(mode), jnp.float32)
    factor = jnp.exp(jnp.asarray(profile.jitter_sigma, jnp.float32) * normal)
    return _before_jitter_ms(profile, mode) + jnp.asarray(profile.jitter_median_ms, jnp.float32) * factor


def _before_jitter_ms(profile: ServiceProfile, mode: ArrayLike) -> jax.Array:
    compute_ms = jnp.asarray(profile.compute_ms, jnp.float32)[jnp.asarray(mode, jnp.int32)]
    fixed = (profile.decode_ms, profile.retrieve_ms, profile.runtime_ms)
    return compute_ms + sum((jnp.asarray(part, jnp.float32) for part in fixed), jnp.float32(0.0))

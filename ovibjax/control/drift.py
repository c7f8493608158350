"""How a client's odometry drifts between corrections (paper, "Local Belief and Predicted Edge Gain").

The paper calls the drift of a request a "fitted drift rate in meters per second". Three models have such a rate r by
route context. With s the metres that r adds up to since the last correction, and G a scale, the root mean square of
what drift has added is D(s) = G (s / G)^p:

- `rate` (p = 1): the error grows linearly, along a direction drawn at each correction;
- `integrated` (p = 1.5): along such a direction too, as a gyroscope's noise, integrated twice, makes it grow;
- `random_walk` (p = 1/2): independent increments, the larger part of them along the heading.

All reach D = G where s = G, so one set of rates serves the three. The covariance grows with the error, so that the
local risk is calibrated: E|e|^2 = tr P.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.errors import InputError

DRIFT_MODELS = {"rate": 1.0, "integrated": 1.5, "random_walk": 0.5}
"""Drift models, and the power p of each."""

WALK_ALONG = 0.8
"""Share of a random walk's growth that lies along the heading; an assumption."""


class Drift(NamedTuple):
    """Numbers of a drift model; leaves.

    Attributes:
        rate_m_per_s: [C] fitted drift rate by context.
        scale_m: G, at which all models agree.
        power: p, one of `DRIFT_MODELS`.
        along_share: share of the covariance's growth along the heading; a half where a direction is drawn.
        walks: whether increments are independent.
    """

    rate_m_per_s: Any
    scale_m: Any
    power: Any
    along_share: Any
    walks: Any


class Odometry(NamedTuple):
    """One realization of what drift brings in each slot; fields [T].

    Attributes:
        advance_m: what the drift rate adds up to in the slot.
        walk_x: increment of a random walk whose mean square is one, x.
        walk_y: the same, y.
        cov_xx: its covariance, element xx; the trace is one.
        cov_xy: element xy.
        toward_x: unit direction in which the error grows after a correction in this slot, x.
        toward_y: the same, y.
    """

    advance_m: jax.Array
    walk_x: jax.Array
    walk_y: jax.Array
    cov_xx: jax.Array
    cov_xy: jax.Array
    toward_x: jax.Array
    toward_y: jax.Array


def make_drift(rate_m_per_s: Any, scale_m: float, model: str = "rate") -> Drift:
    """A drift model by name.

    Args:
        rate_m_per_s: [C] drift rate by context.
        scale_m: G, at which all models agree.
        model: a key of `DRIFT_MODELS`.

    Returns:
        Leaves.

    Raises:
        InputError: an unknown model.
    """
    if model not in DRIFT_MODELS:
        raise InputError(f"drift model {model!r} is unknown; it must be one of {', '.join(DRIFT_MODELS)}")
    walks = model == "random_walk"
    return Drift(
        rate_m_per_s=jnp.asarray(rate_m_per_s, jnp.float32),
        scale_m=jnp.float32(scale_m),
        power=jnp.float32(DRIFT_MODELS[model]),
        along_share=jnp.float32(WALK_ALONG if walks else 0.5),
        walks=jnp.asarray(walks),
    )


def draw_odometry(
    key: jax.Array, context: jax.Array, yaw_rad: jax.Array, slot_s: jax.Array, drift: Drift
) -> tuple[Odometry, jax.Array]:
    """Draw what drift brings along a route.

    Args:
        key: random key.
        context: [T] route context.
        yaw_rad: [T] heading.
        slot_s: length of a slot.
        drift: the model.

    Returns:
        The realization, and a unit direction [2] of the drift before the first correction.
    """
    walk_key, toward_key = jax.random.split(key)
    slots = context.shape[0]
    normal = jax.random.normal(walk_key, (slots, 2))
    angle = 2.0 * jnp.pi * jax.random.uniform(toward_key, (slots + 1,))
    cos, sin, share = jnp.cos(yaw_rad), jnp.sin(yaw_rad), drift.along_share
    ahead, side = jnp.sqrt(share) * normal[:, 0], jnp.sqrt(1.0 - share) * normal[:, 1]
    odometry = Odometry(
        advance_m=drift.rate_m_per_s[context] * slot_s,
        walk_x=cos * ahead - sin * side,
        walk_y=sin * ahead + cos * side,
        cov_xx=share * cos**2 + (1.0 - share) * sin**2,
        cov_xy=(2.0 * share - 1.0) * cos * sin,
        toward_x=jnp.cos(angle[1:]),
        toward_y=jnp.sin(angle[1:]),
    )
    return odometry, jnp.stack([jnp.cos(angle[0]), jnp.sin(angle[0])])


def added_m2(accumulated_m: jax.Array, drift: Drift) -> jax.Array:
    """D(s)^2, the mean square of what drift has added since a correction.

    Args:
        accumulated_m: [...] s, the drift rate added up since then.
        drift: the model; p is a half, one or one and a half.

    Returns:
        [...] m^2, as a product: a power whose exponent is data is slow.
    """
    # G^(2 - 2p) s^(2p): G s, s^2 or s^3 / G.
    second = jnp.where(drift.power > 0.75, accumulated_m, drift.scale_m)
    third = jnp.where(drift.power > 1.25, accumulated_m * (1.0 / drift.scale_m), 1.0)
    return accumulated_m * second * third

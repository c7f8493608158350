"""A belief in four numbers, for replays whose corrections replace the estimate or are dropped.

After such a correction the covariance is isotropic, so that its trace is all that decides: what the correction brings,
and the D(s)^2 that drift has added since. The error along a direction is two such numbers: with the residual e of the
correction and the direction u of the drift after it, |e + D u|^2 = |e|^2 + D (2 e u + D). A random walk's error is its
two coordinates. A gate and a Kalman update need the whole matrix, see `belief`.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.control.belief import Belief, noise_m2
from ovibjax.control.drift import Drift, Odometry, added_m2


class Isotropic(NamedTuple):
    """A belief as far as its risk and its error are concerned; each field [...].

    Attributes:
        fixed_m2: tr P without what drift has added.
        error_a: |e|^2 without drift, m^2; of a random walk the error's x, m.
        accumulated_m: the drift rate added up since the last correction.
        error_b: e u without drift, m; of a random walk the error's y, m.
    """

    fixed_m2: jax.Array
    error_a: jax.Array
    accumulated_m: jax.Array
    error_b: jax.Array


def isotropic(belief: Belief, drift: Drift) -> Isotropic:
    """A belief in four numbers.

    Args:
        belief: any belief, fields [...].
        drift: the model.

    Returns:
        What its risk and its error depend on.
    """
    # Of a belief that has drifted already, what it was before that.
    drifted_m2 = added_m2(belief.accumulated_m, drift)
    back_m = jnp.where(drift.walks, 0.0, jnp.sqrt(drifted_m2))
    x_m, y_m = belief.error_x_m - back_m * belief.toward_x, belief.error_y_m - back_m * belief.toward_y
    return Isotropic(
        belief.cov_xx_m2 + belief.cov_yy_m2 - drifted_m2,
        jnp.where(drift.walks, x_m, x_m**2 + y_m**2),
        belief.accumulated_m,
        jnp.where(drift.walks, y_m, x_m * belief.toward_x + y_m * belief.toward_y),
    )


def after_fix(
    fix_risk_m: jax.Array, residual_x_m: jax.Array, residual_y_m: jax.Array, drift: Drift, odometry: Odometry
) -> Isotropic:
    """The belief that a position from the edge makes where it replaces the estimate.

    Args:
        fix_risk_m: [...] calibrated risk of the position.
        residual_x_m: [...] its realised error, x.
        residual_y_m: [...] the same, y.
        drift: the model.
        odometry: of the slot, fields [...]; its direction is that of the drift that follows.

    Returns:
        The belief.
    """
    noise = noise_m2(fix_risk_m)
    zero = jnp.zeros_like(noise)
    toward = (odometry.toward_x, odometry.toward_y)
    return isotropic(Belief(residual_x_m, residual_y_m, noise, zero, noise, zero, *toward), drift)


def added(odometry: Odometry, drift: Drift) -> Isotropic:
    """What a slot of odometry adds to each number.

    Args:
        odometry: fields [...].
        drift: the model; where increments are independent, p is a half.

    Returns:
        Numbers to add.
    """
    # A random walk's D(s)^2 = G s grows by as much wherever it is.
    wander_m = jnp.where(drift.walks, jnp.sqrt(drift.scale_m * odometry.advance_m), 0.0)
    zero = jnp.zeros_like(wander_m)
    return Isotropic(zero, wander_m * odometry.walk_x, odometry.advance_m, wander_m * odometry.walk_y)


def risk_m(belief: Isotropic, drift: Drift) -> jax.Array:
    """Local risk L = sqrt(tr P) in metres (paper, eq. "local_risk")."""
    return jnp.sqrt(belief.fixed_m2 + added_m2(belief.accumulated_m, drift))


def error_m(belief: Isotropic, drift: Drift) -> jax.Array:
    """Distance between estimate and truth in metres."""
    drifted_m2 = added_m2(belief.accumulated_m, drift)
    along_m2 = belief.error_a + drifted_m2 + 2.0 * belief.error_b * jnp.sqrt(drifted_m2)
    square_m2 = jnp.where(drift.walks, belief.error_a**2 + belief.error_b**2, along_m2)
    return jnp.sqrt(jnp.maximum(square_m2, 0.0))  # a difference of squares may fall below zero by its rounding

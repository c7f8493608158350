"""What a client believes of its position, and what is true (paper, "Local Belief and Predicted Edge Gain").

The client dead-reckons; its error is a random walk whose rate depends on the route context and whose larger part lies
along the direction of travel. The covariance follows the same model, so that the local risk is calibrated: the mean
squared error equals tr P. An edge correction is a position measurement whose covariance is the predicted residual.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp


class Belief(NamedTuple):
    """Horizontal error of a position estimate and its covariance; each field [...].

    Attributes:
        error_x_m: estimate minus truth, x.
        error_y_m: the same, y.
        cov_xx_m2: covariance that the client holds, element xx.
        cov_xy_m2: element xy.
        cov_yy_m2: element yy.
    """

    error_x_m: jax.Array
    error_y_m: jax.Array
    cov_xx_m2: jax.Array
    cov_xy_m2: jax.Array
    cov_yy_m2: jax.Array


def initial(risk_m: jax.Array, normal: jax.Array) -> Belief:
    """A belief of a given risk, and an error drawn from it.

    Args:
        risk_m: local risk sqrt(tr P).
        normal: [2] standard normal numbers.

    Returns:
        The belief, isotropic.
    """
    variance = 0.5 * risk_m**2
    error = jnp.sqrt(variance) * normal
    return Belief(error[0], error[1], variance, jnp.zeros_like(variance), variance)


def drift(variance_m2: jax.Array, along_share: jax.Array, yaw_rad: jax.Array, normal: jax.Array) -> Belief:
    """Increment of error and covariance over one slot of odometry.

    Args:
        variance_m2: [...] growth of tr P over the slot.
        along_share: share of it along the heading.
        yaw_rad: [...] heading.
        normal: [..., 2] standard normal numbers, along and across.

    Returns:
        Increments, to be added with `propagate`; each field [...].
    """
    along, across = variance_m2 * along_share, variance_m2 * (1.0 - along_share)
    cos, sin = jnp.cos(yaw_rad), jnp.sin(yaw_rad)
    ahead, side = jnp.sqrt(along) * normal[..., 0], jnp.sqrt(across) * normal[..., 1]
    return Belief(
        error_x_m=cos * ahead - sin * side,
        error_y_m=sin * ahead + cos * side,
        cov_xx_m2=cos**2 * along + sin**2 * across,
        cov_xy_m2=cos * sin * (along - across),
        cov_yy_m2=sin**2 * along + cos**2 * across,
    )


def propagate(belief: Belief, increment: Belief) -> Belief:
    """Belief after an increment of `drift`."""
    return jax.tree.map(jnp.add, belief, increment)


def local_risk_m(belief: Belief) -> jax.Array:
    """Local risk L = sqrt(tr P) in metres (paper, eq. "local_risk")."""
    return jnp.sqrt(belief.cov_xx_m2 + belief.cov_yy_m2)


def error_m(belief: Belief) -> jax.Array:
    """Distance between estimate and truth in metres."""
    return jnp.sqrt(belief.error_x_m**2 + belief.error_y_m**2)


def correct(
    belief: Belief, residual_x_m: jax.Array, residual_y_m: jax.Array, predicted_m: jax.Array, gate_sigma: jax.Array
) -> Belief:
    """Fuse a position from the edge: Kalman update with measurement covariance (predicted^2 / 2) I.

    A measurement whose innovation lies outside the gate is discarded: retrieval that fell for a look-alike is tens of
    metres off, and a filter that knows its own covariance sees that without knowing the truth.

    Args:
        belief: before the correction.
        residual_x_m: realised error of the edge's position, x.
        residual_y_m: the same, y.
        predicted_m: predicted residual g_psi; the root of the measurement covariance's trace.
        gate_sigma: Mahalanobis distance of the innovation above which the measurement is discarded; infinity
            accepts everything.

    Returns:
        The belief after it.
    """
    noise = 0.5 * predicted_m**2 + 1e-6  # a predicted residual of zero is a measurement within a millimetre
    s_xx, s_xy, s_yy = belief.cov_xx_m2 + noise, belief.cov_xy_m2, belief.cov_yy_m2 + noise
    inverse = 1.0 / (s_xx * s_yy - s_xy**2)
    # Measurement minus estimate: the truth drops out.
    dx, dy = residual_x_m - belief.error_x_m, residual_y_m - belief.error_y_m
    wx, wy = (s_yy * dx - s_xy * dy) * inverse, (s_xx * dy - s_xy * dx) * inverse
    accept = dx * wx + dy * wy <= gate_sigma**2
    # With isotropic noise R = n I the updated covariance P - P (P + R)^-1 P equals n P (P + R)^-1, which has no
    # difference of nearly equal numbers even where the noise is a million times the covariance.
    determinant = belief.cov_xx_m2 * belief.cov_yy_m2 - s_xy**2
    scale = noise * inverse
    updated = Belief(
        error_x_m=belief.error_x_m + belief.cov_xx_m2 * wx + belief.cov_xy_m2 * wy,
        error_y_m=belief.error_y_m + belief.cov_xy_m2 * wx + belief.cov_yy_m2 * wy,
        cov_xx_m2=scale * (determinant + noise * belief.cov_xx_m2),
        cov_xy_m2=scale * noise * s_xy,
        cov_yy_m2=scale * (determinant + noise * belief.cov_yy_m2),
    )
    return select(accept, updated, belief)


def select(condition: jax.Array, yes: Belief, no: Belief) -> Belief:
    """One belief or the other."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)

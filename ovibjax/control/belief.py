"""What a client believes of its position, and what is true (paper, "Local Belief and Predicted Edge Gain").

The client dead-reckons, and its error grows as a model of `drift` has it. The covariance follows the same model, so
the mean squared error equals tr P. A position from the edge, which comes with its calibrated risk, becomes the estimate
or is fused with it as a Kalman filter does.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.control.drift import Drift, Odometry, added_m2

CORRECTIONS = ("replace", "always", "kalman")
"""What a correction does: the edge's position becomes the estimate, and its risk the local one, where that is the lower
of the two; it does so always; or it is fused with the estimate. The first is how we read the paper: "these requests
reduce local risk" (Section "View-Rate Selection"), and the positive part of the gross VOI (eq. "gross_voi") makes
nothing of an answer that would raise it."""


class Belief(NamedTuple):
    """Horizontal error of a position estimate and its covariance; each field [...].

    Attributes:
        error_x_m: estimate minus truth, x.
        error_y_m: the same, y.
        cov_xx_m2: covariance that the client holds, element xx.
        cov_xy_m2: element xy.
        cov_yy_m2: element yy.
        accumulated_m: the drift rate added up since the last correction.
        toward_x: unit direction in which the error grows, x; for models that have one.
        toward_y: the same, y.
    """

    error_x_m: jax.Array
    error_y_m: jax.Array
    cov_xx_m2: jax.Array
    cov_xy_m2: jax.Array
    cov_yy_m2: jax.Array
    accumulated_m: jax.Array
    toward_x: jax.Array
    toward_y: jax.Array


class Fix(NamedTuple):
    """A position from the edge, and where drift turns after it.

    Attributes:
        residual_x_m: realised error of the position, x.
        residual_y_m: the same, y.
        risk_m: risk of the position as calibrated on training routes, the root of its mean squared error.
        toward_x: unit direction of the drift that follows, x.
        toward_y: the same, y.
    """

    residual_x_m: jax.Array
    residual_y_m: jax.Array
    risk_m: jax.Array
    toward_x: jax.Array
    toward_y: jax.Array


def initial(risk_m: jax.Array, normal: jax.Array, toward: jax.Array) -> Belief:
    """A belief of a given risk, and an error drawn from it.

    Args:
        risk_m: local risk sqrt(tr P).
        normal: [2] standard normal numbers.
        toward: [2] unit direction of the drift that follows.

    Returns:
        The belief, isotropic.
    """
    variance = 0.5 * risk_m**2
    error = jnp.sqrt(variance) * normal
    zero = jnp.zeros_like(variance)
    return Belief(error[0], error[1], variance, zero, variance, zero, toward[0], toward[1])


def propagate(belief: Belief, odometry: Odometry, drift: Drift) -> Belief:
    """A belief after one slot of odometry.

    Args:
        belief: before it.
        odometry: what drift brings in the slot, fields [...].
        drift: the model.

    Returns:
        The belief after it.
    """
    accumulated_m = belief.accumulated_m + odometry.advance_m
    before_m2, after_m2 = added_m2(belief.accumulated_m, drift), added_m2(accumulated_m, drift)
    growth_m2 = jnp.maximum(after_m2 - before_m2, 0.0)  # a product need not be monotone to the last bit
    wander_m, straight_m = jnp.sqrt(growth_m2), jnp.sqrt(after_m2) - jnp.sqrt(before_m2)

    def moved(walk: jax.Array, toward: jax.Array) -> jax.Array:
        return jnp.where(drift.walks, wander_m * walk, straight_m * toward)

    return belief._replace(
        error_x_m=belief.error_x_m + moved(odometry.walk_x, belief.toward_x),
        error_y_m=belief.error_y_m + moved(odometry.walk_y, belief.toward_y),
        cov_xx_m2=belief.cov_xx_m2 + growth_m2 * odometry.cov_xx,
        cov_xy_m2=belief.cov_xy_m2 + growth_m2 * odometry.cov_xy,
        cov_yy_m2=belief.cov_yy_m2 + growth_m2 * (1.0 - odometry.cov_xx),
        accumulated_m=accumulated_m,
    )


def local_risk_m(belief: Belief) -> jax.Array:
    """Local risk L = sqrt(tr P) in metres (paper, eq. "local_risk")."""
    return jnp.sqrt(belief.cov_xx_m2 + belief.cov_yy_m2)


def error_m(belief: Belief) -> jax.Array:
    """Distance between estimate and truth in metres."""
    return jnp.sqrt(belief.error_x_m**2 + belief.error_y_m**2)


def noise_m2(fix_risk_m: jax.Array) -> jax.Array:
    """Variance per axis of a position from the edge; a risk of zero is a measurement within a millimetre."""
    return 0.5 * fix_risk_m**2 + 1e-6


def correct(belief: Belief, fix: Fix, correction: jax.Array, gate_sigma: jax.Array) -> Belief:
    """Use a position from the edge: in place of the estimate, or by a Kalman update.

    The covariance of the position is isotropic, and its trace the square of the risk that comes with it. Without a gate
    the local risk after a replacement is that risk, the calibrated residual.

    Args:
        belief: before the correction.
        fix: the position.
        correction: int32, which of `CORRECTIONS`.
        gate_sigma: Mahalanobis distance of the innovation above which the position is discarded; infinity accepts
            everything.

    Returns:
        The belief after it; drift starts anew, in the fix's direction.
    """
    noise = noise_m2(fix.risk_m)
    s_xx, s_xy, s_yy = belief.cov_xx_m2 + noise, belief.cov_xy_m2, belief.cov_yy_m2 + noise
    inverse = 1.0 / (s_xx * s_yy - s_xy**2)
    # Measurement minus estimate: the truth drops out.
    dx, dy = fix.residual_x_m - belief.error_x_m, fix.residual_y_m - belief.error_y_m
    wx, wy = (s_yy * dx - s_xy * dy) * inverse, (s_xx * dy - s_xy * dx) * inverse
    lower = fix.risk_m < local_risk_m(belief)
    accept = (dx * wx + dy * wy <= gate_sigma**2) & (lower | (correction != CORRECTIONS.index("replace")))
    # With isotropic noise R = n I the updated covariance P - P (P + R)^-1 P equals n P (P + R)^-1, which has no
    # difference of nearly equal numbers even where the noise is a million times the covariance.
    determinant = belief.cov_xx_m2 * belief.cov_yy_m2 - s_xy**2
    scale = noise * inverse
    fused = Belief(
        error_x_m=belief.error_x_m + belief.cov_xx_m2 * wx + belief.cov_xy_m2 * wy,
        error_y_m=belief.error_y_m + belief.cov_xy_m2 * wx + belief.cov_yy_m2 * wy,
        cov_xx_m2=scale * (determinant + noise * belief.cov_xx_m2),
        cov_xy_m2=scale * noise * s_xy,
        cov_yy_m2=scale * (determinant + noise * belief.cov_yy_m2),
        accumulated_m=jnp.zeros_like(belief.accumulated_m),
        toward_x=fix.toward_x,
        toward_y=fix.toward_y,
    )
    taken = fused._replace(
        error_x_m=fix.residual_x_m,
        error_y_m=fix.residual_y_m,
        cov_xx_m2=noise,
        cov_xy_m2=jnp.zeros_like(s_xy),
        cov_yy_m2=noise,
    )
    fuses = correction == CORRECTIONS.index("kalman")
    return select(accept, select(fuses, fused, taken), belief)


def select(condition: jax.Array, yes: Belief, no: Belief) -> Belief:
    """One belief or the other."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)

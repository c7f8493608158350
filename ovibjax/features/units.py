"""Units that cannot be right: latitude and longitude for metres, radians for degrees and the other way round.

Numbers alone do not say what they are; together with each other they often do. A position that stays within a
thousandth of its distance from zero is one of a globe; a heading that follows the movement as radians, and not as
degrees, is in radians, whether or not it goes on beyond a full turn.
"""

import math

import numpy as np
from numpy.typing import NDArray

from ovibjax.features.sequence import sequence_of

Array = NDArray[np.float64]

_FEW = 8  # frames that say nothing
_FAR = 20.0  # times the extent: no scene lies so far from the origin of its own coordinates
_TURN = 2 * math.pi
_EARTH_M = 2.1e7  # no grid of a place on Earth goes further, but for those that write their zone before the easting
_STRIDE_M = 50.0  # nobody localizes between frames so far apart
_SPECK_M = 0.01


def seem_geographic(position: Array) -> bool:
    """Whether positions look like degrees of latitude and longitude.

    Args:
        position: [N, 2 or 3], finite.

    Returns:
        True for a patch of less than a degree, far from zero, where a globe has places.
    """
    if len(position) < _FEW:
        return False
    size, extent = np.abs(position[:, :2]).max(axis=0), np.ptp(position[:, :2], axis=0).max()
    on_globe = (size <= (90, 180)).all() or (size <= (180, 90)).all()
    return bool(on_globe and 0 < extent < 1 and size.max() > max(1.0, _FAR * extent))


def seem_beyond_earth(position: Array) -> bool:
    """Whether positions lie where no place on Earth does in metres, such as degrees times 1e7 of a GPS receiver."""
    return bool((np.abs(position) > _EARTH_M).any())


def scale_doubt(position: Array) -> str:
    """What is odd about the size of a drive said to be in metres.

    Args:
        position: [N, 2 or 3], in the order of the frames; places in no order raise no doubt.

    Returns:
        The doubt in words; "" if there is none.
    """
    if len(position) < _FEW or seem_beyond_earth(position):
        return ""
    flat = position[:, :2]  # altitude is in metres where the rest is in degrees
    order, extent = (
        sequence_of(np.pad(flat, ((0, 0), (0, 1))), np.zeros(len(flat), np.int32)),
        np.ptp(flat, axis=0).max(),
    )
    if order.is_drive and order.step_m > _STRIDE_M:
        return f"{order.step_m:.4g} from frame to frame (median): positions may be in centimetres, not metres"
    # Written with five decimals or more, as degrees are and a robot that stands still is not.
    fine = (np.abs(flat - np.round(flat, 4)) > 1e-9).any()
    if order.is_drive and 0 < extent < _SPECK_M and fine:
        return f"all of it lies within {extent:.2g}: positions may be degrees of latitude and longitude, not metres"
    return ""


def seem_radians(position: Array, yaw_deg: Array) -> bool:
    """Whether headings said to be degrees look like radians.

    Args:
        position: [N, 2 or 3], in the order of the frames.
        yaw_deg: [N], from x towards y.

    Returns:
        True where they follow a turning route as radians only, or fill the circle as radians do.
    """
    peak = np.abs(yaw_deg).max(initial=0.0)
    if len(yaw_deg) < _FEW:
        return False
    as_radians, as_degrees = _follows(position, yaw_deg), _follows(position, np.radians(yaw_deg))
    if peak > _TURN + 0.01:  # several laps, unwrapped as odometry leaves them; or degrees, which rarely agree by chance
        # A compass turns the other way: in which unit is another question than which way round.
        as_radians = max(as_radians, _follows(position, -yaw_deg))
        return as_radians > 0.95 and max(as_degrees, _follows(position, -np.radians(yaw_deg))) < 0.8
    if as_radians > 0.9 > as_degrees:
        return True
    # Headings in every direction end at a half or a full turn, where a jitter of degrees thins out.
    full = any(
        0.95 * end <= peak <= end + 0.01 and (np.abs(yaw_deg) > end / 2).mean() > 0.25 for end in (math.pi, _TURN)
    )
    return bool(full and len(yaw_deg) >= 2 * _FEW and _concentration(yaw_deg) < 0.5)


def seem_degrees(position: Array, yaw_rad: Array) -> bool:
    """Whether headings said to be radians look like degrees.

    Args:
        position: [N, 2 or 3], in the order of the frames.
        yaw_rad: [N], from x towards y; may go on beyond a full turn.

    Returns:
        True where they go beyond a full turn, and follow a turning route as degrees only, or fill 360 degrees.
    """
    peak = np.abs(yaw_rad).max(initial=0.0)
    if len(yaw_rad) < _FEW or not _TURN < peak <= 720:
        return False
    as_given = _follows(position, yaw_rad)
    return _follows(position, np.radians(yaw_rad)) > 0.9 > as_given or bool(170 < peak <= 360 and as_given < 0.8)


def _follows(position: Array, yaw_rad: Array) -> float:
    """How closely headings keep one angle to the movement, 0 to 1; 0 where the movement does not turn."""
    step = np.diff(position[:, :2], axis=0)
    length = np.linalg.norm(step, axis=1)
    moving = length > 0.5 * np.median(length[length > 0]) if (length > 0).any() else length > 0
    heading = np.arctan2(step[moving, 1], step[moving, 0])
    # Between two frames the camera looks as in the first, or as in the second; either will do.
    if len(heading) < _FEW - 1 or _concentration(heading) > 0.95:
        return 0.0
    return max(_concentration(part[moving] - heading) for part in (yaw_rad[:-1], yaw_rad[1:]))


def _concentration(angle_rad: Array) -> float:
    """Length of the mean direction: 1 where all angles are one, 0 where they fill the circle."""
    return float(np.abs(np.exp(1j * angle_rad).mean()))

"""Axes of other people's poses: which way x, y and z point, and the heading that a rotation has in them.

A code names the directions of x, y and z by their letters: f(orward) b(ack) l(eft) r(ight) u(p) d(own), or for the
world e(ast) w(est) n(orth) s(outh) u(p) d(own). `WORLD/BODY` gives both, `rdf/rdf` for KITTI; one code alone stands for
both, `ned` for `ned/frd` and `enu` for `enu/flu`. What is read comes out with x forward (or east), y left (or north)
and z up, right-handed. `lat-lon-alt` and `lon-lat-alt` are degrees and metres, laid out in metres east, north and up of
the middle of the data: good to a thousandth within ten kilometres.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ovibjax.errors import InputError

EXAMPLES = "flu (x forward, y left, z up), ned, enu/rdf (a camera looking along z), rdf (KITTI) or lat-lon-alt"

_LOCAL = {"f": (1, 0, 0), "b": (-1, 0, 0), "l": (0, 1, 0), "r": (0, -1, 0), "u": (0, 0, 1), "d": (0, 0, -1)}
_EARTH = {"e": (1, 0, 0), "w": (-1, 0, 0), "n": (0, 1, 0), "s": (0, -1, 0), "u": (0, 0, 1), "d": (0, 0, -1)}
_DEGREES = {"lat-lon-alt": "neu", "lon-lat-alt": "enu"}
_EQUATOR_M, _ECCENTRICITY2 = 6378137.0, 6.69437999014e-3  # WGS84
_UPRIGHT = 0.6  # mean cosine between a body's up and the world's; the wrong axes give 0 or less


@dataclass(frozen=True)
class Axes:
    """Directions of a world's and a body's x, y and z.

    Attributes:
        code: as it is typed.
        world: [3, 3] rows of what is wanted (forward, left, up), columns of what the file has.
        body: the same for the body.
        degrees: column of latitude and of longitude among x and y; None for metres.
        stated: whether somebody said so, instead of it being usual for the form of the file.
    """

    code: str
    world: tuple[tuple[int, ...], ...]
    body: tuple[tuple[int, ...], ...]
    degrees: tuple[int, int] | None = None
    stated: bool = False

    def place(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """Positions [N, 3] of a file, complete ones, in metres forward (or east), left (or north) and up."""
        found: NDArray[np.float64] = position @ np.array(self.world, np.float64).T
        if self.degrees is None or not len(position):
            return found
        latitude, longitude = (position[:, at] for at in self.degrees)
        if np.abs(latitude).max() > 90 or np.abs(longitude).max() > 360:
            raise InputError(f"--axes {self.code}: latitude is beyond 90 or longitude beyond 360 degrees")
        middle = np.radians((latitude.min() + latitude.max()) / 2)
        bend = 1 - _ECCENTRICITY2 * np.sin(middle) ** 2
        east_m = _EQUATOR_M / np.sqrt(bend) * np.cos(middle)
        north_m = _EQUATOR_M * (1 - _ECCENTRICITY2) / bend**1.5
        # A route over the date line goes on beyond 180 degrees.
        for at, degrees, radius_m in ((0, np.unwrap(longitude, period=360), east_m), (1, latitude, north_m)):
            found[:, at] = radius_m * np.radians(degrees - (degrees.min() + degrees.max()) / 2)
        return found

    def yaw_of_angle(self, yaw_rad: NDArray[np.float64]) -> NDArray[np.float64]:
        """Yaw of headings [N] that a file measures from its x towards its y.

        Raises:
            InputError: z does not point up or down, so that such an angle is no heading.
        """
        if self.world[2][2] == 0:
            raise InputError(f"--axes {self.code}: yaw turns about z, which is level there; give quaternions")
        flat = np.array(self.world, np.float64)[:2, :2]
        x, y = flat @ np.stack([np.cos(yaw_rad), np.sin(yaw_rad)])
        turned: NDArray[np.float64] = np.arctan2(y, x)
        return np.where(np.abs(flat - np.eye(2)).sum() == 0, yaw_rad, turned)

    def yaw_of_rotation(self, turn: Rotation) -> NDArray[np.float64]:
        """Yaw of headings [N] from rotations of the body into the world."""
        ahead = turn.apply(np.array(self.body[0], np.float64)) @ np.array(self.world, np.float64).T
        yaw_rad: NDArray[np.float64] = np.arctan2(ahead[:, 1], ahead[:, 0])
        return yaw_rad

    def upright(self, turn: Rotation) -> bool:
        """Whether bodies stand upright on average; they do not where the axes are others than these."""
        up = turn.apply(np.array(self.body[2], np.float64)) @ np.array(self.world, np.float64).T
        return bool(up[:, 2].mean() > _UPRIGHT)

    def describe(self) -> str:
        """What became of the axes, for the user."""
        if self.degrees is not None:
            return f"degrees ({self.code}) laid out in metres east, north and up"
        if self.world == _AS_GIVEN.world:
            return "as given, yaw from x towards y"
        earth = any(letter in "ewns" for letter in self.code)
        return f"{self.code} turned to x {'east' if earth else 'forward'}, y {'north' if earth else 'left'}, z up"


def axes_of(code: str, stated: bool = False) -> Axes:
    """Axes from their code.

    Args:
        code: see the module.
        stated: whether the user typed it.

    Returns:
        The axes.

    Raises:
        InputError: not three directions at right angles.
    """
    if code in _DEGREES:
        letters = _DEGREES[code]
        degrees = (letters.index("n"), letters.index("e"))
        return Axes(code, _matrix(code, letters, _EARTH), _matrix(code, "flu", _LOCAL), degrees, stated)
    world, slash, body = code.lower().partition("/")
    if any(letter in "ewns" for letter in world):
        body = body if slash else "frd" if world == "ned" else "flu"
        return Axes(code, _matrix(code, world, _EARTH), _matrix(code, body, _LOCAL), None, stated)
    return Axes(code, _matrix(code, world, _LOCAL), _matrix(code, body if slash else world, _LOCAL), None, stated)


def _matrix(code: str, letters: str, directions: dict[str, tuple[int, int, int]]) -> tuple[tuple[int, ...], ...]:
    """Columns are the directions of x, y and z."""
    columns = [directions.get(letter) for letter in letters]
    found = np.array([column for column in columns if column is not None])
    if found.shape != (3, 3) or len(columns) != 3 or abs(np.linalg.det(found)) < 0.5:
        raise InputError(f"--axes {code}: no three directions at right angles; give {EXAMPLES}")
    return tuple(tuple(int(value) for value in row) for row in found.T)


_AS_GIVEN = axes_of("flu")
